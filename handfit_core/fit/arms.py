"""Arms fitted onto hands over a clip: shoulder, elbow and wrist of one or two arms of one person.

With w the wrist, f and u the unit directions of forearm and upper arm, both towards the hand, and the
lengths l, which are equal in all frames,

    elbow e = w - l_f f      shoulder s = e - l_u u

An arm has seven unknowns in each frame: w, and two increments of each direction. Every term gives residuals,
divided by their expected errors, and their derivatives by (s, e, w, u, f). As in `clips`, acceleration
couples a frame with the two before and the two after, so that the whole clip is one banded system. How much
longer a person's upper arms and forearms are than most people's is its border.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.fit.banded import put_lower, solve_bordered, solve_windows
from handfit_core.fit.levenberg import CoupledFrames, solve
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import turn_from_axis, units

FREE: Final = 7
"""Number of an arm's unknowns in a frame: three for the wrist's place, then two increments each for the
directions of forearm and upper arm"""
SHOULDER, ELBOW, WRIST, UPPER, FOREARM = (slice(3 * i, 3 * i + 3) for i in range(5))
"""Columns, among the 15 of a residual's derivatives, by the shoulder s, the elbow e, the wrist w, and the
directions u of the upper arm and f of the forearm"""


@dataclass(frozen=True)
class ArmSettings:
    """Expected lengths, bends and motion of arms, and expected errors of what is seen of them."""

    upper_arm: float = 1.56
    forearm: float = 1.49
    """Usual lengths of the upper arm and of the forearm in hand lengths: means of both sexes' between joint
    centres (de Leva, "Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters", 1996)"""
    length_sigma: float = 0.06
    """Standard deviation, among people, of an arm's lengths relative to the usual ones"""
    correlated_seconds: float = 0.5
    """seconds over which what is seen errs alike, so that it tells only once how long the arms are"""
    shoulders: float = 1.8
    """Usual distance of a person's shoulder joints in hand lengths"""
    wrist_sigma: float = 2e-4
    """metres, across the line of sight, by which the arm's wrist may miss the hand's: the hand lies on the
    picture, and the arm hangs on it"""
    distance_sigma: float = 0.1
    """Relative deviation of the wrist's distance from the hand's, whose size in the picture tells it"""
    joint_sigma: float = 0.12
    """hand lengths by which the body network's points are off in the picture"""
    direction_sigma: float = 0.2
    """radians by which the body network's directions of upper arm and forearm are expected to err"""
    flexion_sigma: float = math.radians(30.0)
    deviation_sigma: float = math.radians(13.0)
    """radians by which wrists are bent up or down, and to either side, as a rule"""
    max_bend: float = math.radians(75.0)
    """radians between hand and forearm that a wrist allows"""
    bend_sigma: float = math.radians(3.0)
    width_sigma: float = 0.02
    """metres by which the distance of both shoulders is expected to differ from the usual one"""
    huber: float = 1.5
    """sigmas of a residual beyond which a point or a direction of the body network counts as an outlier,
    whose cost grows no faster than linearly"""
    wrist_acceleration: float = 3.0
    elbow_acceleration: float = 2.0
    shoulder_acceleration: float = 0.3
    """metres per second squared: accelerations that are expected of wrist, elbow and shoulder. The wrist's
    matters in depth only"""
    resting_speed: float = 0.015
    """metres per second at which the arm of a resting hand is expected to move"""
    speed_share: float = 1.0
    """Share of the hand's speed that is added to `resting_speed` as the speed at which the arm of a moving
    hand is expected to move"""
    overlap_seconds: float = 4.0
    """seconds that two windows of a long clip share"""
    iterations: int = 30
    tolerance: float = 1e-6
    """Relative decrease of the cost at which to stop"""
    first_damping: float = 1e-6


ARMS: Final = ArmSettings()


@dataclass(frozen=True, eq=False)
class ArmsSeen(Batch):
    """Observations of A arms of one person in T frames, camera frame."""

    wrist: np.ndarray
    """(T, A, 3) metres: the fitted hand's wrist joint; NaN without a hand"""
    hand: np.ndarray
    """(T, A, 3, 3) unit rows: along the hand, across its palm, towards the thumb; NaN without a hand"""
    pixels: np.ndarray
    """(T, A, 3, 2) pixels: shoulder, elbow and wrist as the body network sees them"""
    visibility: np.ndarray
    """(T, A, 3) how visible shoulder, elbow and wrist are, 0..1; 0 in frames without a body"""
    directions: np.ndarray
    """(T, A, 2, 3) unit vectors of the body network's upper arm and forearm, towards the hand"""
    lengths: np.ndarray
    """(T, A, 2) metres: the expected lengths of the upper arm and the forearm, equal in all frames"""
    hand_length: float
    """metres: the length of the fitted hand, in which the settings tell the lengths of arms"""
    camera: Intrinsics

    @property
    def with_hand(self) -> np.ndarray:
        """(T, A) bool: true in frames in which an arm has a fitted hand."""
        return np.isfinite(self.wrist[..., 0])


@dataclass(frozen=True, eq=False)
class Arms(Batch):
    """The pose of A arms of one person in T frames, in metres, camera frame."""

    wrist: np.ndarray
    """(T, A, 3) metres: the wrist joint of each arm"""
    forearm: np.ndarray
    """(T, A, 3) unit vectors along the forearm, from the elbow to the wrist"""
    upper: np.ndarray
    """(T, A, 3) unit vectors along the upper arm, from the shoulder to the elbow"""
    lengths: np.ndarray
    """(T, A, 2) metres: the lengths of the upper arm and the forearm, equal in all frames"""

    @property
    def points(self) -> np.ndarray:
        """(T, A, 3, 3) the places of shoulder, elbow and wrist, in metres, camera frame."""
        elbow = self.wrist - self.lengths[..., 1:] * self.forearm
        return np.stack([elbow - self.lengths[..., :1] * self.upper, elbow, self.wrist], axis=-2)

    def derivatives(self) -> np.ndarray:
        """(T, A, 15, 9) derivatives of shoulder, elbow, wrist, upper arm's and forearm's direction, three
        rows each, by the arm's seven unknowns and by the logarithms of both lengths."""
        matrix = np.zeros((*self.wrist.shape[:2], 15, FREE + 2))
        upper, forearm = self.lengths[..., :1], self.lengths[..., 1:]
        matrix[..., UPPER, 5:7], matrix[..., FOREARM, 3:5] = _across(self.upper), _across(self.forearm)
        matrix[..., WRIST, 0:3] = np.eye(3)
        matrix[..., ELBOW, :] = matrix[..., WRIST, :] - forearm[..., None] * matrix[..., FOREARM, :]
        matrix[..., ELBOW, 8] = -forearm * self.forearm
        matrix[..., SHOULDER, :] = matrix[..., ELBOW, :] - upper[..., None] * matrix[..., UPPER, :]
        matrix[..., SHOULDER, 7] = -upper * self.upper
        return matrix

    def moved(self, step: np.ndarray, longer: np.ndarray) -> Arms:
        """Return the arms moved by increments (T, A, 7) of their unknowns, with lengths that grow by
        logarithms (T, 2)."""
        turned = (self.derivatives()[..., :FREE] @ step[..., None])[..., 0]
        return Arms(
            self.wrist + step[..., :3],
            units(self.forearm + turned[..., FOREARM]),
            units(self.upper + turned[..., UPPER]),
            self.lengths * np.exp(longer)[:, None],
        )


Rows = tuple[np.ndarray, np.ndarray]
"""Residuals (T, A, K) of A arms in T frames, in sigmas, and their derivatives (T, A, K, 15) by shoulder,
elbow, wrist, upper arm's and forearm's direction"""


def at_hand(arms: Arms, seen: ArmsSeen) -> Rows:
    """Residuals of the arm's wrist against the fitted hand's, across the line of sight and along it."""
    there = seen.with_hand
    place = np.where(there[..., None], seen.wrist, [0.0, 0.0, 1.0])
    distance = np.linalg.norm(place, axis=-1, keepdims=True)
    ray = turn_from_axis(place / distance)
    sigma = np.concatenate([np.full((*there.shape, 2), ARMS.wrist_sigma), ARMS.distance_sigma * distance], -1)
    weighted = np.where(there[..., None, None], ray.swapaxes(-1, -2) / sigma[..., None], 0.0)
    jacobian = np.zeros((*there.shape, 3, 15))
    jacobian[..., WRIST] = weighted
    return (weighted @ (arms.wrist - place)[..., None])[..., 0], jacobian


def in_picture(arms: Arms, seen: ArmsSeen) -> Rows:
    """Residuals of shoulder, elbow and, where there is no hand, wrist against the body network's points: the
    metres by which each lies beside the ray through its point, in sigmas."""
    points = arms.points
    weight = seen.visibility / (ARMS.joint_sigma * seen.hand_length)
    weight[..., 2] *= ~seen.with_hand
    rays = np.where(weight[..., None] > 0.0, seen.camera.rays(seen.pixels), 0.0)[..., :2]
    residual = (points[..., :2] - rays * points[..., 2:]) * weight[..., None]
    by_point = np.concatenate([np.broadcast_to(np.eye(2), (*weight.shape, 2, 2)), -rays[..., None]], axis=-1)
    by_point *= weight[..., None, None]
    jacobian = np.zeros((*weight.shape, 2, 15))
    for k, columns in enumerate((SHOULDER, ELBOW, WRIST)):
        jacobian[..., k, :, columns] = by_point[..., k, :, :]
    return _robust(residual, jacobian)


def along_network(arms: Arms, seen: ArmsSeen) -> Rows:
    """Residuals of the directions of upper arm and forearm against those that the body network sees."""
    found = np.stack([arms.upper, arms.forearm], axis=-2)
    # A bone is seen as well as its worse end.
    weight = np.minimum(seen.visibility[..., :2], seen.visibility[..., 1:])[..., None] / ARMS.direction_sigma
    residual = np.where(weight > 0.0, found - seen.directions, 0.0) * weight
    jacobian = np.zeros((*weight.shape[:-1], 3, 15))
    jacobian[..., 0, :, UPPER] = jacobian[..., 1, :, FOREARM] = np.eye(3)
    return _robust(residual, jacobian * weight[..., None])


def within_wrist(arms: Arms, seen: ArmsSeen) -> Rows:
    """Residuals of the forearm in the hand's axes, as wrists are hardly bent as a rule, and never farther
    than they allow."""
    there = seen.with_hand[..., None, None]
    axes = np.where(there, seen.hand, 0.0)
    along = (axes @ arms.forearm[..., None])[..., 0]
    beyond = (along[..., 0] < math.cos(ARMS.max_bend)) & there[..., 0, 0]
    sigma = np.array([ARMS.bend_sigma, ARMS.flexion_sigma, ARMS.deviation_sigma])
    residual = along / sigma
    residual[..., 0] -= math.cos(ARMS.max_bend) / ARMS.bend_sigma
    residual[..., 0] *= beyond
    jacobian = np.zeros((*beyond.shape, 3, 15))
    jacobian[..., FOREARM] = axes / sigma[:, None]
    jacobian[..., 0, :] *= beyond[..., None]
    return residual, jacobian


TERMS: Final[tuple[Callable[[Arms, ArmsSeen], Rows], ...]] = (
    at_hand,
    in_picture,
    along_network,
    within_wrist,
)


def shoulder_width(arms: Arms, seen: ArmsSeen) -> Rows:
    """Residuals (T, 1) of the distance between the shoulders of two arms against the usual one, and their
    derivatives (T, 1, 2, 15) by both arms."""
    shoulder = arms.points[..., 0, :]
    between = shoulder[:, 1] - shoulder[:, 0]
    distance = np.maximum(np.linalg.norm(between, axis=-1, keepdims=True), 1e-6)
    along = between / distance / ARMS.width_sigma
    jacobian = np.zeros((len(between), 1, 2, 15))
    jacobian[..., SHOULDER] = np.stack([-along, along], axis=1)[:, None]
    return (distance - ARMS.shoulders * seen.hand_length) / ARMS.width_sigma, jacobian


def fit_arms(seen: ArmsSeen, fps: float) -> Arms:
    """Fit the arms of T consecutive frames, at `fps` frames per second, window by window; the first window
    tells their lengths. Frames in which nothing is seen follow from their neighbours; each arm must have a
    hand, and a body, in one frame at least."""
    lengths: np.ndarray | None = None

    def window(rows: slice, start: Arms) -> Arms:
        nonlocal lengths
        if lengths is not None:
            start = replace(start, lengths=np.broadcast_to(lengths, start.lengths.shape))
        found = solve_arms(ArmFit(seen.select(rows), fps, learn=lengths is None), start)
        lengths = found.lengths[:1]
        return found

    return solve_windows(first_guess(seen), int(ARMS.overlap_seconds * fps), window)


def solve_arms(fit: ArmFit, start: Arms) -> Arms:
    """Solve all T frames of a fit at once, starting from the arms `start`."""
    return solve(
        fit,
        start,
        max_iterations=ARMS.iterations,
        tolerance=ARMS.tolerance,
        first_damping=ARMS.first_damping,
    ).state


def first_guess(seen: ArmsSeen) -> Arms:
    """Return the arms to start from: the hand's wrist and the body network's directions, interpolated over
    frames that lack them."""
    count = len(seen.wrist)
    values = [seen.wrist.copy(), seen.directions[..., 1, :].copy(), seen.directions[..., 0, :].copy()]
    bodies = seen.visibility[..., 0] > 0.0
    known = [seen.with_hand, bodies, bodies]
    for value, there in zip(values, known, strict=True):
        for arm in range(value.shape[1]):
            rows = np.flatnonzero(there[:, arm])
            for axis in range(3):
                value[:, arm, axis] = np.interp(np.arange(count), rows, value[rows, arm, axis])
    return Arms(values[0], units(values[1]), units(values[2]), seen.lengths)


@dataclass(frozen=True, eq=False)
class _System:
    """The normal equations of P = 7 A unknowns in each of T frames, and of both lengths' logarithms."""

    cost: np.ndarray
    """(T,) the cost of each frame, in squared sigmas"""
    blocks: np.ndarray
    """(T, 3 P, P) columns of the matrix, in which each frame is coupled with itself, the next frame and the
    one after"""
    gradient: np.ndarray
    """(T, P) the gradient of the cost by each frame's unknowns"""
    border: np.ndarray
    """(T, P, 2) the part of the matrix that couples each frame's unknowns with both lengths"""
    corner: np.ndarray
    """(2, 2) the part of the matrix that couples the two lengths with each other"""
    by_length: np.ndarray
    """(2,) the gradient of the cost by the logarithms of both lengths"""

    def add(self, residual: np.ndarray, jacobian: np.ndarray) -> None:
        """Add R residuals (T', R) of s consecutive frames each, T' = T - s + 1, with their derivatives
        (s, T', R, P + 2)."""
        count, size = len(residual), self.gradient.shape[1]
        by_length = jacobian[..., size:].sum(axis=0)
        self.cost[:count] += np.square(residual).sum(axis=1)
        self.corner[...] += np.einsum("trv,trw->vw", by_length, by_length)
        self.by_length[...] += np.einsum("trv,tr->v", by_length, residual)
        for a, of_a in enumerate(jacobian[..., :size].swapaxes(-1, -2)):
            self.gradient[a : a + count] += (of_a @ residual[..., None])[..., 0]
            self.border[a : a + count] += of_a @ by_length
            for b in range(a + 1):
                rows = slice((a - b) * size, (a - b + 1) * size)
                self.blocks[b : b + count, rows] += of_a @ jacobian[b, ..., :size]


@dataclass(frozen=True, eq=False)
class ArmFit(CoupledFrames):
    """The fit of arms to what is seen of them in T consecutive frames at once."""

    seen: ArmsSeen
    fps: float
    learn: bool = True
    """True if the lengths of the arms are solved for, too; else they stay as they are"""

    def blocks(self, state: Arms) -> _System:
        """Return the normal equations of the whole clip, and each frame's cost."""
        arms, seen, (count, number) = state, self.seen, state.wrist.shape[:2]
        size, derivatives = number * FREE, arms.derivatives()
        system = _System(*(np.zeros(shape) for shape in (
            (count,), (count, 3 * size, size), (count, size), (count, size, 2), (2, 2), (2,)
        )))  # fmt: skip
        rows = [term(arms, seen) for term in TERMS]
        jacobian = np.concatenate([of_term for _, of_term in rows], axis=2) @ derivatives
        residual = np.concatenate([of_term for of_term, _ in rows], axis=2).reshape(count, -1)
        system.add(residual, _of_all(jacobian)[None])
        if number == 2:
            apart, by_arms = shoulder_width(arms, seen)
            by_each = np.einsum("tkar,tarv->tkav", by_arms, derivatives)
            own = by_each[..., :FREE].reshape(count, 1, size)
            system.add(apart, np.concatenate([own, by_each[..., FREE:].sum(axis=2)], axis=-1)[None])
        # Differences of the points over two and three frames
        points, moving = arms.points.reshape(count, -1), _of_all(derivatives[..., :9, :])
        for steps, weight in (
            ((-1.0, 1.0), _of_speed(seen, self.fps)),
            ((1.0, -2.0, 1.0), np.tile(_of_acceleration(self.fps), (max(count - 2, 0), number))),
        ):
            rows = [slice(a, max(count - len(steps) + 1 + a, a)) for a in range(len(steps))]
            change = sum(c * points[at] for c, at in zip(steps, rows, strict=True)) * weight
            by_frames = [c * weight[..., None] * moving[at] for c, at in zip(steps, rows, strict=True)]
            system.add(change, np.stack(by_frames))
        prior = min(count, max(ARMS.correlated_seconds * self.fps, 1.0)) / ARMS.length_sigma**2
        longer = np.log(arms.lengths / seen.lengths)[0, 0]
        system.cost[0] += prior * np.square(longer).sum()
        system.corner[...] += prior * np.eye(2)
        system.by_length[...] += prior * longer
        return system

    def step(
        self, state: Arms, blocks: _System, damping: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
        """Solve for increments (T, A, 7) of the arms' unknowns and (T, 2) of both lengths' logarithms, which
        are 0 unless `learn`; also return the predicted decrease (T,) of each frame's cost."""
        count, size = blocks.gradient.shape
        band = np.zeros((count, size, 3 * size))
        put_lower(band, slice(None), blocks.blocks)
        band = band.reshape(count * size, 3 * size).T
        band[0] += damping[0] * band[0] + 1e-9
        known = 1.0 if self.learn else 0.0
        border, by_length = known * blocks.border.reshape(-1, 2), known * blocks.by_length
        step, longer = solve_bordered(band, -blocks.gradient.reshape(-1), border, blocks.corner, -by_length)
        decrease = -(blocks.gradient * step.reshape(count, size)).sum(axis=1) - by_length @ longer / count
        return (step.reshape(*state.wrist.shape[:2], FREE), np.tile(longer, (count, 1))), decrease


def _of_all(jacobian: np.ndarray) -> np.ndarray:
    """Turn derivatives (T, A, K, 9) of each arm's rows by its own unknowns into (T, A K, 7 A + 2) by the
    unknowns of all arms and by the two lengths."""
    count, number, rows, _ = jacobian.shape
    own = np.zeros((count, number, rows, number, FREE))
    for arm in range(number):
        own[:, arm, :, arm] = jacobian[:, arm, :, :FREE]
    own = own.reshape(count, number * rows, number * FREE)
    return np.concatenate([own, jacobian[..., FREE:].reshape(count, -1, 2)], axis=-1)


def _of_acceleration(fps: float) -> np.ndarray:
    """(9,) the factors that turn second differences of shoulder, elbow and wrist from frame to frame, in
    metres, into sigmas."""
    sigma = np.array([ARMS.shoulder_acceleration, ARMS.elbow_acceleration, ARMS.wrist_acceleration])
    return np.repeat(fps**2 / sigma, 3)


def _of_speed(seen: ArmsSeen, fps: float) -> np.ndarray:
    """(T - 1, 9 A) the factors that turn first differences of shoulder, elbow and wrist, in metres, into
    sigmas: an arm whose hand rests hardly moves. They are 0 for arms without a hand."""
    rows = np.arange(len(seen.wrist))
    # Over so long that the hand's own tremor is none.
    lag = max(round(0.2 * fps), 1)
    before, after = np.maximum(rows[:-1] - lag, 0), np.minimum(rows[1:] + lag, rows[-1])
    way = np.linalg.norm(seen.wrist[after] - seen.wrist[before], axis=-1, keepdims=True)
    speed = way * fps / (after - before)[:, None, None]
    weight = np.repeat(fps / (ARMS.resting_speed + ARMS.speed_share * np.nan_to_num(speed)), 9, axis=-1)
    return np.where(np.isfinite(speed), weight, 0.0).reshape(len(rows) - 1, 9 * seen.wrist.shape[1])


def _robust(residual: np.ndarray, jacobian: np.ndarray) -> Rows:
    """Apply Huber's kernel over the last axis of residuals (T, A, N, K): return rows (T, A, N K) whose
    squares are its cost, with derivatives that lead downhill."""
    size = np.linalg.norm(residual, axis=-1, keepdims=True)
    safe = np.maximum(size, ARMS.huber)
    cost = np.sqrt(ARMS.huber * (2.0 * safe - ARMS.huber)) / safe
    outside = size > ARMS.huber
    residual = np.where(outside, cost, 1.0) * residual
    jacobian = np.where(outside, ARMS.huber / safe / cost, 1.0)[..., None] * jacobian
    shape = residual.shape[:2]
    return residual.reshape(*shape, -1), jacobian.reshape(*shape, -1, 15)


def _across(direction: np.ndarray) -> np.ndarray:
    """Return for each unit vector (..., 3) two unit axes across it, as columns (..., 3, 2)."""
    facing = np.where(direction[..., 2:] < 0.0, -1.0, 1.0)
    return turn_from_axis(direction * facing)[..., :2]
