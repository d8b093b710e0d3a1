"""A clip solved as a whole: all frames at once, under a motion prior on accelerations.

Each frame's residuals are taken at second order (Gauss-Newton: a 51 x 51 matrix of the root's turn, 45 angles
and the wrist's place), acceleration couples a frame with the two before and the two after, so that the matrix
of the whole clip is banded, and is solved directly. Nothing is filtered: past and future weigh alike, and
there is no lag. Frames without a detection have no residuals and follow from their neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from handfit_core.common.batch import slices
from handfit_core.common.threads import in_threads
from handfit_core.fit.blocks import Blocks
from handfit_core.fit.problem import MotionPrior, Problem
from handfit_core.fit.settings import SOLVER
from handfit_core.fit.terms.motion import place_acceleration, rotation_acceleration
from handfit_core.geometry.rotations import euler_to_rotmat
from handfit_core.hand_model.chain import State, turns_by_angles

FRAME_VARIABLES = 51
"""Root (3), 15 joints (45), place (3)"""
_BAND = 2 * FRAME_VARIABLES + 2
"""Subdiagonals, down to a rotation's third component two frames on"""
_HAND = np.r_[0:3, 48:51]
"""Where the root's rotation and the place stand among a frame's variables. The hand's seventh variable, the
zero of depth, is none of these: it is eliminated in each frame"""


def smooth_clip(problem: Problem, start: State, before_each: Callable[[], None] = lambda: None) -> State:
    """Solve the T frames of a clip, whose `problem.motion` is given, window by window.

    In frames that are not observed, `start` holds a guess. `before_each` is called before each window and
    each of its iterations, and may raise to stop.
    """
    assert problem.motion is not None
    count, overlap = len(start), problem.motion.overlap
    if count <= SOLVER.window_frames + overlap:
        return _window(problem, start, before_each)
    state, first = State(*(getattr(start, name).copy() for name in State.__dataclass_fields__)), 0
    while True:
        last = min(first + SOLVER.window_frames + overlap, count)
        window = slice(first, last)
        found = _window(problem.select(window), start.select(window), before_each)
        # Of the frames that two windows share, the first half is the earlier one's.
        keep = 0 if first == 0 else overlap // 2
        for name in State.__dataclass_fields__:
            getattr(state, name)[first + keep : last] = getattr(found, name)[keep:]
        if last == count:
            return state
        first += SOLVER.window_frames


@np.errstate(all="ignore")
def _window(problem: Problem, start: State, before_each: Callable[[], None]) -> State:
    if len(start) < 3:
        return start
    before_each()
    state = start
    blocks = _data(problem, state)
    total = float(blocks.cost.sum()) + _motion_cost(problem, state)
    damping = 1e-4
    for _ in range(SOLVER.clip_iterations):
        before_each()
        step = _step(problem, state, blocks, damping)
        candidate = state.moved(*step)
        tried = _data(problem, candidate)
        after = float(tried.cost.sum()) + _motion_cost(problem, candidate)
        if not after < total:
            damping *= 30.0
            continue
        gain, total = (total - after) / max(total, 1e-12), after
        state, blocks, damping = candidate, tried, damping * 0.1
        if gain < SOLVER.clip_tolerance:
            break
    return state


def _data(problem: Problem, state: State) -> Blocks:
    """The frames' own systems; zero in frames that are not observed."""
    free = replace(problem, held=None)

    @np.errstate(all="ignore")
    def systems(rows: slice) -> Blocks:
        return free.select(rows).blocks(state.select(rows))

    batches = list(slices(len(state), SOLVER.solve_batch))
    blocks = Blocks.collect(len(state), in_threads(systems, batches))
    if problem.observed is None:
        return blocks
    nothing = ~problem.observed
    for name in Blocks.__dataclass_fields__:
        if (values := getattr(blocks, name)) is not None:
            values[nothing] = 0.0
    return blocks


def _step(problem: Problem, state: State, blocks: Blocks, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """Increments (T, 7) and (T, 5, 9). Where depth is zero is eliminated first, and follows from the
    others."""
    along = np.concatenate([blocks.hand[:, 6], blocks.finger[..., 15].reshape(-1, 45)], axis=1)
    # (T, 51) coupling of depth's zero with the others, (T,) its own square, (T,) its gradient
    mixed, square, slope = np.empty((len(state), FRAME_VARIABLES)), along[:, 6] + 1e-9, along[:, 7]
    mixed[:, _HAND], mixed[:, 3:48] = along[:, :6], along[:, 8:]
    # Frames that are not observed have no residual of it.
    square = np.where(square < 1e-6, 1.0, square)
    gradient = np.empty_like(mixed)
    gradient[:, _HAND], gradient[:, 3:48] = blocks.hand[:, :6, -1], blocks.finger[..., -1].reshape(-1, 45)
    gradient -= mixed * (slope / square)[:, None]
    band = _banded(blocks, mixed, square)
    _add_motion(problem, band, gradient, state)
    if problem.held is not None:
        _fix(band, gradient, problem.held.variables)
    band[0] += damping * band[0] + 1e-6
    step = _solve(band, gradient)
    of_depth = -(slope + (mixed * step).sum(axis=1)) / square
    return np.concatenate([step[:, _HAND], of_depth[:, None]], axis=1), step[:, 3:48].reshape(-1, 5, 9)


def _banded(blocks: Blocks, mixed: np.ndarray, square: np.ndarray) -> np.ndarray:
    """(_BAND + 1, 51 T) the frames' own matrices in LAPACK's lower band form, in Fortran's order, so that
    they are solved in place."""
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
        for column in range(FRAME_VARIABLES):
            band[rows, column, : FRAME_VARIABLES - column] = dense[:, column:, column]
    return band.reshape(count * FRAME_VARIABLES, _BAND + 1).T


def _rotations(state: State) -> np.ndarray:
    """(T, 16, 3, 3)"""
    return np.concatenate([state.root[:, None], euler_to_rotmat(state.angles.reshape(-1, 15, 3))], axis=1)


def _rotation_sigma(problem: Problem, motion: MotionPrior) -> np.ndarray:
    """(T - 2, 16, 1) expected accelerations, radians per frame squared."""
    sigma = np.full((len(problem.seen), 16, 1), motion.rotation)
    if problem.motion_scale is not None:
        sigma[:, 0, 0] *= problem.motion_scale
    return sigma[1:-1]


def _motion_cost(problem: Problem, state: State) -> float:
    assert problem.motion is not None
    turning, _ = rotation_acceleration(_rotations(state))
    moving = place_acceleration(state.wrist)
    rotation, place = _rotation_sigma(problem, problem.motion), problem.motion.place
    return float(np.square(turning / rotation).sum() + np.square(moving / place).sum())


def _add_motion(problem: Problem, band: np.ndarray, gradient: np.ndarray, state: State) -> None:
    """Add the acceleration terms' matrices and gradients in place."""
    assert problem.motion is not None
    count = len(gradient)
    view = band.T.reshape(count, FRAME_VARIABLES, _BAND + 1).transpose(2, 0, 1)
    rotations = _rotations(state)
    turning, jacobian = rotation_acceleration(rotations)
    sigma = _rotation_sigma(problem, problem.motion)
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
    per_place = 1.0 / problem.motion.place**2
    moving = place_acceleration(state.wrist) * per_place
    coefficients = (1.0, -2.0, 1.0)
    for a, ca in enumerate(coefficients):
        gradient[a : count - 2 + a, 48:] += ca * moving
        for b, cb in enumerate(coefficients[: a + 1]):
            view[(a - b) * FRAME_VARIABLES, b : count - 2 + b, 48:] += ca * cb * per_place


def _fix(band: np.ndarray, gradient: np.ndarray, held: np.ndarray) -> None:
    """Take held variables (T, 51) out of the matrix and the gradient in place: their increments are zero."""
    at = np.flatnonzero(held)
    gradient[held] = 0.0
    band[:, at] = 0.0
    for below in range(1, len(band)):
        rows = at[at >= below]
        band[below, rows - below] = 0.0
    band[0, at] = 1.0


def _solve(band: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """(T, 51) increments. Overwrites both arguments."""
    from scipy.linalg import solveh_banded  # slow to load

    right = gradient.reshape(-1)
    found = solveh_banded(band, right, overwrite_ab=True, overwrite_b=True, lower=True, check_finite=False)
    return -found.reshape(-1, FRAME_VARIABLES)
