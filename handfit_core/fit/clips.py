"""A clip solved as a whole: all frames at once, under a motion prior on accelerations.

Each frame's residuals are taken at second order (Gauss-Newton: a 51 x 51 matrix of the root's turn, 45 angles
and the wrist's place), acceleration couples a frame with the two before and the two after, so that the matrix
of the whole clip is banded, and is solved directly. Nothing is filtered: past and future weigh alike, and
there is no lag. Frames without a detection have no residuals and follow from their neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from handfit_core.common.batch import slices
from handfit_core.fit.banded import put_lower, solve_band, solve_windows
from handfit_core.fit.blocks import Blocks
from handfit_core.fit.levenberg import CoupledFrames, solve
from handfit_core.fit.problem import Problem
from handfit_core.fit.settings import SOLVER
from handfit_core.fit.terms.motion import place_acceleration, rotation_acceleration
from handfit_core.geometry.rotations import euler_to_rotmat
from handfit_core.hand_model.chain import State, turns_by_angles

FRAME_VARIABLES = 51
"""Number of variables of a frame: the root's turn (3), the angles of 15 joints (45), the wrist's place (3)"""
_BAND = 2 * FRAME_VARIABLES + 2
"""Number of the band matrix's subdiagonals, which reach to a rotation's third component two frames on"""
_HAND = np.r_[0:3, 48:51]
"""Indices of the root's rotation and of the place among a frame's variables. The hand's seventh variable, the
zero of depth, is none of these: it is eliminated in each frame"""


@dataclass(frozen=True)
class MotionPrior:
    """Standard deviations of a hand's accelerations, per frame of the clip."""

    rotation: float
    """radians per frame squared: the standard deviation of a joint's rotational acceleration"""
    place: float
    """metres per frame squared: the standard deviation of the wrist's acceleration"""
    overlap: int = 60
    """Number of frames that two windows share: frames farther apart hardly influence each other"""


@dataclass(frozen=True, eq=False)
class ClipProblem(CoupledFrames):
    """The least-squares problem of fitting T consecutive frames at once, which motion couples."""

    frames: Problem
    """The problem of fitting each frame by itself, with the shape given"""
    motion: MotionPrior
    motion_scale: np.ndarray | None = None
    """(T,) factors of the palm's expected rotational acceleration; None: 1 in all frames"""
    observed: np.ndarray | None = None
    """(T,) bool: true for frames whose observation counts; the others follow from their neighbours. None: all
    count"""
    before_each: Callable[[], None] = lambda: None
    """A function that is called before each window and each of its iterations, and may raise to stop"""

    def blocks(self, state: State) -> Blocks:
        """Return the systems of the single frames, zero in frames that are not observed, and each frame's
        cost with that of the accelerations about it."""
        self.before_each()
        free = replace(self.frames, fixed=None)
        batches = slices(len(state), SOLVER.solve_batch)
        blocks = Blocks.collect(
            len(state), (free.select(rows).blocks(state.select(rows)) for rows in batches)
        )
        if self.observed is not None:
            for _, values in blocks._rows():
                values[~self.observed] = 0.0
        turning, _ = rotation_acceleration(_rotations(state))
        turning /= self._rotation_sigma
        moving = place_acceleration(state.wrist) / self.motion.place
        blocks.cost[1:-1] += np.square(turning).sum(axis=(1, 2)) + np.square(moving).sum(axis=1)
        return blocks

    def step(
        self, state: State, blocks: Blocks, damping: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
        """Solve for increments (T, 7) of the hands' variables and (T, 5, 9) of the angles; also return the
        predicted decrease (T,). The variable that says where depth is zero is eliminated first, and follows
        from the others."""
        along = np.concatenate([blocks.hand[:, 6], blocks.finger[..., 15].reshape(-1, 45)], axis=1)
        # (T, 51) coupling of depth's zero with the others, (T,) its own square, (T,) its gradient
        mixed, square, slope = np.empty((len(state), FRAME_VARIABLES)), along[:, 6] + 1e-9, along[:, 7]
        mixed[:, _HAND], mixed[:, 3:48] = along[:, :6], along[:, 8:]
        # Frames that are not observed have no residual of it.
        square = np.where(square < 1e-6, 1.0, square)
        band = _banded(blocks, mixed, square)
        of_motion = self._add_motion(band, state)
        gradient = of_motion - mixed * (slope / square)[:, None]
        gradient[:, _HAND] += blocks.hand[:, :6, -1]
        gradient[:, 3:48] += blocks.finger[..., -1].reshape(-1, 45)
        if self.frames.fixed is not None:
            _fix(band, gradient, self.frames.fixed.variables)
        band[0] += damping[0] * band[0] + 1e-6
        step = -solve_band(band, gradient.reshape(-1)).reshape(-1, FRAME_VARIABLES)
        of_depth = -(slope + (mixed * step).sum(axis=1)) / square
        steps = np.concatenate([step[:, _HAND], of_depth[:, None]], axis=1), step[:, 3:48].reshape(-1, 5, 9)
        return steps, blocks.predicted_decrease(*steps) - (of_motion * step).sum(axis=1)

    @property
    def _rotation_sigma(self) -> np.ndarray:
        """(T - 2, 16, 1) the accelerations that are expected of the 16 joints' rotations, in radians per
        frame squared."""
        sigma = np.full((len(self.frames), 16, 1), self.motion.rotation)
        if self.motion_scale is not None:
            sigma[:, 0, 0] *= self.motion_scale
        return sigma[1:-1]

    def _add_motion(self, band: np.ndarray, state: State) -> np.ndarray:
        """Add the matrices of the acceleration terms to `band` in place, and return their gradients
        (T, 51)."""
        count = len(state)
        gradient = np.zeros((count, FRAME_VARIABLES))
        view = band.T.reshape(count, FRAME_VARIABLES, _BAND + 1).transpose(2, 0, 1)
        rotations = _rotations(state)
        turning, jacobian = rotation_acceleration(rotations)
        sigma = self._rotation_sigma
        turning /= sigma  # (T-2, 16, 3)
        jacobian /= sigma[:, None, ..., None]  # (T-2, 3, 16, 3, 3)
        by_angles = turns_by_angles(state.angles.reshape(-1, 15, 3), rotations[:, 1:])
        for a in range(3):
            jacobian[:, a, 1:] = jacobian[:, a, 1:] @ by_angles[a : count - 2 + a]
        of_rotation = gradient[:, :48].reshape(count, 16, 3)
        firsts = 3 * np.arange(16)
        for a in range(3):
            transposed = jacobian[:, a].swapaxes(-1, -2)
            of_rotation[a : count - 2 + a] += (transposed @ turning[..., None])[..., 0]
            for b in range(a + 1):
                block = transposed @ jacobian[:, b]  # (T-2, 16, 3, 3): row a, column b
                for i in range(3):
                    for j in range(3):
                        below = (a - b) * FRAME_VARIABLES + i - j
                        if below >= 0:
                            view[below, b : count - 2 + b, firsts + j] += block[:, :, i, j].T
        per_place = 1.0 / self.motion.place**2
        moving = place_acceleration(state.wrist) * per_place
        coefficients = (1.0, -2.0, 1.0)
        for a, ca in enumerate(coefficients):
            gradient[a : count - 2 + a, 48:] += ca * moving
            for b, cb in enumerate(coefficients[: a + 1]):
                view[(a - b) * FRAME_VARIABLES, b : count - 2 + b, 48:] += ca * cb * per_place
        return gradient


def smooth_clip(clip: ClipProblem, start: State) -> State:
    """Solve the T frames of a clip window by window. In frames that are not observed, `start` holds a
    guess."""
    if len(start) < 3:
        return start

    def window(rows: slice, guess: State) -> State:
        return solve(
            clip.select(rows),
            guess,
            max_iterations=SOLVER.clip_iterations,
            min_gain=SOLVER.clip_min_gain,
            first_damping=SOLVER.clip_damping,
        ).state

    return solve_windows(start, clip.motion.overlap, window)


def _banded(blocks: Blocks, mixed: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Write the frames' own matrices as one band (_BAND + 1, 51 T) in LAPACK's lower form, in Fortran's
    order, so that the system is solved in place."""
    count = len(mixed)
    band = np.zeros((count, FRAME_VARIABLES, _BAND + 1))
    for rows in slices(count, SOLVER.solve_batch):
        own, beside = blocks.select(rows), mixed[rows]
        dense = beside[:, :, None] * (beside / -square[rows, None])[:, None]  # (T, 51, 51)
        dense[:, _HAND[:, None], _HAND] += own.hand[:, :6, :6]
        for f in range(5):
            finger = slice(3 + 9 * f, 12 + 9 * f)
            dense[:, finger, finger] += own.finger[:, f, :, :9]
            dense[:, finger, :3] += own.finger[:, f, :, 9:12]
            dense[:, 48:, finger] += own.finger[:, f, :, 12:15].swapaxes(1, 2)
        if own.between is not None:
            dense[:, 3:48, 3:48] += own.between
        put_lower(band, rows, dense)
    return band.reshape(count * FRAME_VARIABLES, _BAND + 1).T


def _rotations(state: State) -> np.ndarray:
    """(T, 16, 3, 3) the rotation of the root and of the 15 finger joints in each frame, as matrices."""
    return np.concatenate([state.root[:, None], euler_to_rotmat(state.angles.reshape(-1, 15, 3))], axis=1)


def _fix(band: np.ndarray, gradient: np.ndarray, fixed: np.ndarray) -> None:
    """Take the variables that `fixed` (T, 51) marks out of the matrix and the gradient in place, so that
    their increments are zero."""
    at = np.flatnonzero(fixed)
    gradient[fixed] = 0.0
    band[:, at] = 0.0
    for below in range(1, len(band)):
        rows = at[at >= below]
        band[below, rows - below] = 0.0
    band[0, at] = 1.0
