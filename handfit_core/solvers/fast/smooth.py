"""A clip solved as a whole: all frames at once, with small accelerations preferred.

Each frame's residuals are taken at second order (Gauss-Newton: a 51 x 51 matrix of 16 rotations and the
wrist's place), acceleration couples a frame with the two before and the two after, so that the matrix of
the whole clip is banded, and is solved directly. Nothing is filtered: past and future weigh alike, and
there is no lag. Frames without a detection have no residuals and follow from their neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from handfit_core.residuals.temporal import place_acceleration, rotation_acceleration
from handfit_core.solvers.fast.blocks import Blocks
from handfit_core.solvers.fast.chain import Chain, State
from handfit_core.solvers.fast.energy import Energy
from handfit_core.solvers.fast.observation import Observation

SIZE = 51
"""Variables of a frame: root (3), 15 joints (45), place (3)"""
_BAND = 2 * SIZE + 2
"""Subdiagonals: a rotation's three components two frames on"""
ITERATIONS = 4
TOLERANCE = 1e-3
"""Relative decrease of the total cost at which to stop"""


@dataclass(frozen=True)
class Motion:
    """How smooth a hand moves, per frame of the clip: standard deviations of accelerations."""

    rotation: float
    """radians per frame squared"""
    place: float
    """metres per frame squared"""
    overlap: int = 60
    """Frames that two windows share: what happens so many frames on has hardly an influence"""


WINDOW = 600
"""Frames that each window adds"""


def smoothed(
    chain: Chain,
    energy: Energy,
    seen: Observation,
    has_data: np.ndarray,
    start: State,
    motion: Motion,
    held: np.ndarray | None = None,
    before_each: Callable[[], None] = lambda: None,
) -> State:
    """Smooth T frames, window by window.

    `seen` and `start` have T rows; rows where `has_data` (T,) is False are not looked at in `seen`, and in
    `start` hold a guess. `held` (T, 51) bool: variables (root, joints finger by finger, place) that stay as
    they are in `start`; None: none does. `before_each` window, and each of its iterations, may raise to stop.
    """
    count = len(start)
    held = np.zeros((count, SIZE), dtype=bool) if held is None else held
    if count <= WINDOW + motion.overlap:
        return _window(chain, energy, seen, has_data, start, motion, held, before_each)
    state, first = start, 0
    while True:
        last = min(first + WINDOW + motion.overlap, count)
        part = slice(first, last)
        found = _window(
            chain,
            energy,
            seen.select(part),
            has_data[part],
            start.select(part),
            motion,
            held[part],
            before_each,
        )
        # In the shared part the first half is the earlier window's, the second the later's.
        keep = 0 if first == 0 else motion.overlap // 2
        state = _put(state, found, first, keep)
        if last == count:
            return state
        first += WINDOW


def _put(whole: State, part: State, first: int, keep: int) -> State:
    def put(name: str) -> np.ndarray:
        target = getattr(whole, name).copy()
        target[first + keep : first + len(part)] = getattr(part, name)[keep:]
        return target

    return State(*(put(name) for name in State.__dataclass_fields__))


def _window(
    chain: Chain,
    energy: Energy,
    seen: Observation,
    has_data: np.ndarray,
    start: State,
    motion: Motion,
    held: np.ndarray,
    before_each: Callable[[], None],
) -> State:
    if len(start) < 3:
        return start
    before_each()
    state = start
    blocks = _data(chain, energy, seen, has_data, state)
    total = float(blocks.cost.sum()) + _motion_cost(state, motion)
    damping = 1e-4
    for _ in range(ITERATIONS):
        before_each()
        matrix, gradient = _banded(blocks, has_data)
        _add_motion(matrix, gradient, state, motion)
        _hold(matrix, gradient, held)
        matrix[0] += damping * matrix[0] + 1e-6
        step = _solve(matrix, gradient)
        candidate = _moved(chain, state, step, blocks)
        tried = _data(chain, energy, seen, has_data, candidate)
        after = float(tried.cost.sum()) + _motion_cost(candidate, motion)
        if not after < total:
            damping *= 30.0
            continue
        gain, total = (total - after) / max(total, 1e-12), after
        state, blocks, damping = candidate, tried, damping * 0.1
        if gain < TOLERANCE:
            break
    return state


def _data(chain: Chain, energy: Energy, seen: Observation, has_data: np.ndarray, state: State) -> Blocks:
    """The frames' own matrices; zero where there is no data."""
    blocks = energy.of(chain.pose(state), seen, shape=False)
    weight = has_data.astype(np.float64)
    return Blocks(
        *(
            getattr(blocks, name) * weight.reshape(-1, *[1] * (getattr(blocks, name).ndim - 1))
            for name in Blocks.__dataclass_fields__
        )
    )


def _dense(blocks: Blocks, has_data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, 51, 51) and (T, 51): root, joints, place; the terms' offsets eliminated."""
    count, n = blocks.hand_gradient.shape
    offsets = n - 6
    size = 45 + n
    matrix, gradient = np.zeros((count, size, size)), np.zeros((count, size))
    order = [0, 1, 2, *range(48, 51), *range(51, 51 + offsets)]  # where the hand's variables go
    hand = blocks.hand
    mixed, finger = blocks.mixed, blocks.finger
    matrix[np.ix_(range(count), order, order)] = hand
    gradient[:, order] = blocks.hand_gradient
    gradient[:, 3:48] = blocks.finger_gradient.reshape(count, 45)
    for f in range(5):
        part = slice(3 + 9 * f, 12 + 9 * f)
        matrix[:, part, part] = finger[:, f]
        matrix[np.ix_(range(count), range(part.start, part.stop), order)] = mixed[:, f]
        matrix[np.ix_(range(count), order, range(part.start, part.stop))] = np.swapaxes(mixed[:, f], -1, -2)
    corner = matrix[:, SIZE:, SIZE:] + np.where(has_data, 1e-9, 1.0)[:, None, None] * np.eye(offsets)
    side = matrix[:, :SIZE, SIZE:]
    solved = np.linalg.solve(
        corner, np.concatenate([np.swapaxes(side, -1, -2), gradient[:, SIZE:, None]], -1)
    )
    matrix = matrix[:, :SIZE, :SIZE] - side @ solved[..., :SIZE]
    return matrix, gradient[:, :SIZE] - (side @ solved[..., SIZE:])[..., 0]


def _banded(blocks: Blocks, has_data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """LAPACK's lower band form (_BAND + 1, 51 T) and the gradient (T, 51)."""
    dense, gradient = _dense(blocks, has_data)
    count = len(dense)
    band = np.zeros((_BAND + 1, count, SIZE))
    for below in range(SIZE):
        band[below, :, : SIZE - below] = dense[:, np.arange(below, SIZE), np.arange(SIZE - below)]
    return band.reshape(_BAND + 1, count * SIZE), gradient


def _rotations(state: State) -> np.ndarray:
    """(T, 16, 3, 3)"""
    root = state.root[:, None]
    return np.concatenate([root, state.local.reshape(len(root), 15, 3, 3)], axis=1)


def _motion_cost(state: State, motion: Motion) -> float:
    turning, _ = rotation_acceleration(_rotations(state))
    moving = place_acceleration(state.wrist)
    return float(np.square(turning / motion.rotation).sum() + np.square(moving / motion.place).sum())


def _add_motion(band: np.ndarray, gradient: np.ndarray, state: State, motion: Motion) -> None:
    """Add the acceleration terms' matrices and gradients in place."""
    count = len(gradient)
    view = band.reshape(_BAND + 1, count, SIZE)
    turning, jacobian = rotation_acceleration(_rotations(state))
    turning, jacobian = (
        turning / motion.rotation,
        jacobian / motion.rotation,
    )  # (T-2, 16, 3), (T-2, 3, 16, 3, 3)
    of_rotation = gradient[:, :48].reshape(count, 16, 3)
    firsts = 3 * np.arange(16)
    for a in range(3):
        of_rotation[a : count - 2 + a] += np.einsum("tjki,tjk->tji", jacobian[:, a], turning)
        for b in range(a + 1):
            block = np.swapaxes(jacobian[:, a], -1, -2) @ jacobian[:, b]  # (T-2, 16, 3, 3): row a, column b
            for i in range(3):
                for j in range(3):
                    below = (a - b) * SIZE + i - j
                    if below >= 0:
                        view[below, b : count - 2 + b, firsts + j] += block[:, :, i, j].T
    gradient[:, :48] = of_rotation.reshape(count, 48)
    moving = place_acceleration(state.wrist) / motion.place**2
    coefficients = (1.0, -2.0, 1.0)
    for a, ca in enumerate(coefficients):
        gradient[a : count - 2 + a, 48:] += ca * moving
        for b, cb in enumerate(coefficients[: a + 1]):
            view[(a - b) * SIZE, b : count - 2 + b, 48:] += ca * cb / motion.place**2


def _hold(band: np.ndarray, gradient: np.ndarray, held: np.ndarray) -> None:
    """Take held variables (T, 51) out of the matrix and the gradient in place: their increments are zero."""
    at = np.flatnonzero(held)
    gradient[held] = 0.0
    band[:, at] = 0.0
    for below in range(1, len(band)):
        rows = at[at >= below]
        band[below, rows - below] = 0.0
    band[0, at] = 1.0


def _solve(band: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """(T, 51) increments."""
    from scipy.linalg import solveh_banded

    return -solveh_banded(band, gradient.reshape(-1), lower=True, check_finite=False).reshape(-1, SIZE)


def _moved(chain: Chain, state: State, step: np.ndarray, blocks: Blocks) -> State:
    """Apply increments; the terms' offsets follow the wrist along the way."""
    of_fingers = step[:, 3:48].reshape(-1, 5, 9)
    of_hand = np.concatenate([step[:, :3], step[:, 48:], np.zeros_like(state.offsets)], axis=1)
    moved = chain.moved(state, of_hand, of_fingers)
    # The offsets were eliminated: their own best increments, given the others'.
    offsets = state.offsets.shape[1]
    corner = blocks.hand[:, 6:, 6:] + 1e-9 * np.eye(offsets)
    corner = corner + (np.trace(corner, axis1=1, axis2=2) < 1e-6)[:, None, None]
    pulled = blocks.hand_gradient[:, 6:] + (blocks.hand[:, 6:, :6] @ of_hand[:, :6, None])[..., 0]
    pulled = pulled + (np.swapaxes(blocks.mixed[..., 6:], 2, 3) @ of_fingers[..., None]).sum(axis=1)[..., 0]
    best = np.linalg.solve(corner, -pulled[..., None])[..., 0]
    return replace(moved, offsets=state.offsets + best)
