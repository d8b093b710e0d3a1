"""Arms fitted onto hands over a clip: shoulder, elbow and wrist of one or two arms of one person.

With w the wrist, f and u the unit directions of forearm and upper arm, both towards the hand, and the
lengths l, which are equal in all frames,

    elbow e = w - l_f f      shoulder s = e - l_u u

An arm has seven unknowns in each frame: w, and two increments of each direction. Every term gives residuals,
divided by their expected errors, and their derivatives by (w, f, u). As in `clips`, acceleration couples a
frame with the two before and the two after, so that the whole clip is one banded system. How much longer a
person's upper arms and forearms are than most people's is its border. Both are solved directly until they
hold still.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.fit.settings import SOLVER
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import turn_from_axis

FREE: Final = 7
"""Unknowns of an arm in a frame: the wrist's place, and two of each direction"""
WRIST, FOREARM, UPPER = slice(0, 3), slice(3, 6), slice(6, 9)
"""Columns of derivatives by w, f and u"""


@dataclass(frozen=True)
class ArmSettings:
    """What arms are expected to be like, and what they are seen with."""

    upper_arm: float = 1.56
    forearm: float = 1.49
    """Lengths in hand lengths: means of both sexes' between joint centres (de Leva, "Adjustments to
    Zatsiorsky-Seluyanov's segment inertia parameters", 1996)"""
    length_sigma: float = 0.06
    """Relative deviation of people's lengths"""
    correlated_seconds: float = 0.5
    """seconds over which what is seen errs alike, so that it tells only once how long the arms are"""
    shoulders: float = 1.8
    """Distance of the shoulder joints in hand lengths"""
    wrist_sigma: float = 2e-4
    """metres across the line of sight: the hand lies on the picture, and the arm hangs on it"""
    distance_sigma: float = 0.1
    """Relative deviation of the wrist's distance from the hand's, whose size in the picture tells it"""
    joint_sigma: float = 0.12
    """hand lengths by which the body network's points are off in the picture"""
    direction_sigma: float = 0.2
    """The body network's directions, radians"""
    flexion_sigma: float = math.radians(30.0)
    deviation_sigma: float = math.radians(13.0)
    """radians by which wrists are bent up or down, and to either side, as a rule"""
    max_bend: float = math.radians(75.0)
    """radians between hand and forearm that a wrist allows"""
    bend_sigma: float = math.radians(3.0)
    width_sigma: float = 0.02
    """metres"""
    huber: float = 1.5
    """sigmas from which on points and directions of the network count as outliers, and less"""
    wrist_acceleration: float = 3.0
    elbow_acceleration: float = 2.0
    shoulder_acceleration: float = 0.3
    """metres per second squared that are expected. The wrist's matters in depth only"""
    resting_speed: float = 0.015
    """metres per second at which the arm of a resting hand is expected to move"""
    speed_share: float = 1.0
    """The share of the hand's speed at which the arm of a moving one is expected to move beside that"""
    overlap_seconds: float = 4.0
    """seconds that two windows of a long clip share"""
    iterations: int = 30
    tolerance: float = 1e-4
    """Relative decrease of the cost at which to stop"""


ARMS: Final = ArmSettings()


@dataclass(frozen=True, eq=False)
class ArmsSeen(Batch):
    """What is seen of A arms of one person in T frames, camera frame."""

    wrist: np.ndarray
    """(T, A, 3) metres: the fitted hand's wrist joint; NaN without a hand"""
    hand: np.ndarray
    """(T, A, 3, 3) unit rows: along the hand, across its palm, towards the thumb; NaN without a hand"""
    pixels: np.ndarray
    """(T, A, 3, 2) the body network's shoulder, elbow and wrist"""
    visibility: np.ndarray
    """(T, A, 3) of these, 0..1; 0 in frames without a body"""
    directions: np.ndarray
    """(T, A, 2, 3) unit vectors of the body network's upper arm and forearm, towards the hand"""
    lengths: np.ndarray
    """(T, A, 2) metres of the upper arm and the forearm as expected, equal in all frames"""
    hand_length: float
    """metres"""
    camera: Intrinsics

    @property
    def with_hand(self) -> np.ndarray:
        """(T, A) bool"""
        return np.isfinite(self.wrist[..., 0])

    def longer(self, by: np.ndarray) -> ArmsSeen:
        """With upper arms and forearms that are longer by logarithms (2,)."""
        return replace(self, lengths=self.lengths * np.exp(by))


@dataclass(frozen=True, eq=False)
class Arms(Batch):
    """A arms in T frames: w, f and u, each (T, A, 3)."""

    wrist: np.ndarray
    forearm: np.ndarray
    upper: np.ndarray

    def points(self, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Shoulder, elbow and wrist, each (T, A, 3), of arms of those lengths (T, A, 2)."""
        elbow = self.wrist - lengths[..., 1:] * self.forearm
        return elbow - lengths[..., :1] * self.upper, elbow, self.wrist

    def tangents(self) -> np.ndarray:
        """(T, A, 9, 7) derivatives of (w, f, u) by the unknowns."""
        matrix = np.zeros((*self.wrist.shape[:2], 9, FREE))
        matrix[..., WRIST, 0:3] = np.eye(3)
        matrix[..., FOREARM, 3:5] = _across(self.forearm)
        matrix[..., UPPER, 5:7] = _across(self.upper)
        return matrix

    def moved(self, step: np.ndarray) -> Arms:
        """By increments (T, A, 7)."""
        raw = (self.tangents() @ step[..., None])[..., 0]
        return Arms(
            self.wrist + raw[..., WRIST],
            _unit(self.forearm + raw[..., FOREARM]),
            _unit(self.upper + raw[..., UPPER]),
        )


Rows = tuple[np.ndarray, np.ndarray]
"""Residuals (T, A, K) and their derivatives (T, A, K, 9) by w, f and u"""


def at_hand(arms: Arms, seen: ArmsSeen) -> Rows:
    """The wrist less the hand's: across the line of sight, and along it."""
    there = seen.with_hand
    place = np.where(there[..., None], seen.wrist, [0.0, 0.0, 1.0])
    distance = np.linalg.norm(place, axis=-1, keepdims=True)
    ray = turn_from_axis(place / distance)
    sigma = np.concatenate([np.full((*there.shape, 2), ARMS.wrist_sigma), ARMS.distance_sigma * distance], -1)
    weighted = np.where(there[..., None, None], ray.swapaxes(-1, -2) / sigma[..., None], 0.0)
    jacobian = np.zeros((*there.shape, 3, 9))
    jacobian[..., WRIST] = weighted
    return (weighted @ (arms.wrist - place)[..., None])[..., 0], jacobian


def in_picture(arms: Arms, seen: ArmsSeen) -> Rows:
    """How far shoulder, elbow and, where there is no hand, wrist are beside the rays of the body network's
    points, metres."""
    points = np.stack(arms.points(seen.lengths), axis=-2)  # (T, A, 3, 3)
    weight = seen.visibility / (ARMS.joint_sigma * seen.hand_length)
    weight[..., 2] *= ~seen.with_hand
    rays = np.where(weight[..., None] > 0.0, seen.camera.rays(seen.pixels), 0.0)[..., :2]
    residual = (points[..., :2] - rays * points[..., 2:]) * weight[..., None]
    by_point = np.concatenate([np.broadcast_to(np.eye(2), (*weight.shape, 2, 2)), -rays[..., None]], axis=-1)
    by_point *= weight[..., None, None]
    jacobian = np.zeros((*weight.shape, 2, 9))
    jacobian[..., WRIST] = by_point
    jacobian[..., :2, :, FOREARM] = -seen.lengths[..., 1, None, None, None] * by_point[..., :2, :, :]
    jacobian[..., 0, :, UPPER] = -seen.lengths[..., 0, None, None] * by_point[..., 0, :, :]
    return _robust(residual, jacobian)


def along_network(arms: Arms, seen: ArmsSeen) -> Rows:
    """Both directions against the body network's."""
    found = np.stack([arms.upper, arms.forearm], axis=-2)
    # A bone is seen as well as its worse end.
    weight = np.minimum(seen.visibility[..., :2], seen.visibility[..., 1:])[..., None] / ARMS.direction_sigma
    residual = np.where(weight > 0.0, found - seen.directions, 0.0) * weight
    jacobian = np.zeros((*weight.shape[:-1], 3, 9))
    jacobian[..., 0, :, UPPER] = jacobian[..., 1, :, FOREARM] = np.eye(3)
    return _robust(residual, jacobian * weight[..., None])


def within_wrist(arms: Arms, seen: ArmsSeen) -> Rows:
    """The forearm in the hand's axes: hardly bent as a rule, and no farther than a wrist allows."""
    there = seen.with_hand[..., None, None]
    axes = np.where(there, seen.hand, 0.0)
    along = (axes @ arms.forearm[..., None])[..., 0]
    beyond = (along[..., 0] < math.cos(ARMS.max_bend)) & there[..., 0, 0]
    sigma = np.array([ARMS.bend_sigma, ARMS.flexion_sigma, ARMS.deviation_sigma])
    residual = along / sigma
    residual[..., 0] -= math.cos(ARMS.max_bend) / ARMS.bend_sigma
    residual[..., 0] *= beyond
    jacobian = np.zeros((*beyond.shape, 3, 9))
    jacobian[..., FOREARM] = axes / sigma[:, None]
    jacobian[..., 0, :] *= beyond[..., None]
    return residual, jacobian


POINT_TERMS: Final[tuple[Callable[[Arms, ArmsSeen], Rows], ...]] = (at_hand, in_picture)
DIRECTION_TERMS: Final[tuple[Callable[[Arms, ArmsSeen], Rows], ...]] = (along_network, within_wrist)


def shoulder_width(arms: Arms, seen: ArmsSeen) -> Rows:
    """Of two arms: how far the shoulders are from their distance. (T, 1) and (T, 1, 2, 9)."""
    shoulder = arms.points(seen.lengths)[0]
    between = shoulder[:, 1] - shoulder[:, 0]
    distance = np.maximum(np.linalg.norm(between, axis=-1, keepdims=True), 1e-6)
    along = between / distance / ARMS.width_sigma
    by_shoulder = np.stack([-along, along], axis=1)[:, None]  # (T, 1, 2, 3)
    lengths = seen.lengths[:, None, :, :, None]
    by_arm = [by_shoulder, -lengths[..., 1, :] * by_shoulder, -lengths[..., 0, :] * by_shoulder]
    residual = (distance - ARMS.shoulders * seen.hand_length) / ARMS.width_sigma
    return residual, np.concatenate(by_arm, axis=-1)


def fit_arms(seen: ArmsSeen, fps: float) -> tuple[Arms, np.ndarray]:
    """The arms of T consecutive frames, at `fps` frames per second, window by window, and their lengths
    (T, A, 2), metres, which the first window tells. Frames in which nothing is seen follow from their
    neighbours; each arm must have a hand, and a body, in one frame at least."""
    arms, count, first, overlap = _start(seen), len(seen.wrist), 0, int(ARMS.overlap_seconds * fps)
    while True:
        last = min(first + SOLVER.window_frames + overlap, count)
        window = slice(first, last)
        # Of the frames that two windows share, the first half is the earlier one's.
        keep = 0 if first == 0 else overlap // 2
        found, longer = _window(seen.select(window), arms.select(window), fps, learn=first == 0)
        seen = seen.longer(longer)
        arms = arms.replaced(np.arange(first + keep, last), found.select(slice(keep, None)))
        if last == count:
            return arms, seen.lengths
        first += SOLVER.window_frames


@np.errstate(all="ignore")
def _window(seen: ArmsSeen, arms: Arms, fps: float, *, learn: bool = True) -> tuple[Arms, np.ndarray]:
    """The arms, and logarithms (2,) of how much longer upper arms and forearms are; 0 unless `learn`."""
    longer = np.zeros(2)
    system = _system(arms, seen, longer, fps)
    damping = 1e-6
    for _ in range(ARMS.iterations):
        step, by_length = system.step(damping, learn=learn)
        moved, stretched = arms.moved(step.reshape(*arms.wrist.shape[:2], FREE)), longer + by_length
        after = _system(moved, seen, stretched, fps)
        if not after.cost < system.cost:
            damping *= 10.0
            continue
        gain = (system.cost - after.cost) / system.cost
        arms, longer, system, damping = moved, stretched, after, damping * 0.2
        if gain < ARMS.tolerance:
            break
    return arms, longer


def _start(seen: ArmsSeen) -> Arms:
    """The hand's wrist and the body network's directions, interpolated where there is none."""
    count = len(seen.wrist)
    values = [seen.wrist.copy(), seen.directions[..., 1, :].copy(), seen.directions[..., 0, :].copy()]
    bodies = seen.visibility[..., 0] > 0.0
    known = [seen.with_hand, bodies, bodies]
    for value, there in zip(values, known, strict=True):
        for arm in range(value.shape[1]):
            rows = np.flatnonzero(there[:, arm])
            for axis in range(3):
                value[:, arm, axis] = np.interp(np.arange(count), rows, value[rows, arm, axis])
    return Arms(values[0], _unit(values[1]), _unit(values[2]))


@dataclass(frozen=True, eq=False)
class _System:
    """The normal equations of P = 7 A unknowns in each of T frames, and of both lengths' logarithms."""

    cost: float
    band: np.ndarray
    """(3 P, P T) in LAPACK's lower form"""
    border: np.ndarray
    """(P T, 2)"""
    corner: np.ndarray
    """(2, 2)"""
    gradient: np.ndarray
    """(P T,)"""
    by_length: np.ndarray
    """(2,) the gradient by the lengths"""

    def step(self, damping: float, *, learn: bool) -> tuple[np.ndarray, np.ndarray]:
        """Increments of the unknowns (P T,) and of the lengths' logarithms (2,), 0 unless `learn`."""
        from scipy.linalg import solveh_banded  # slow to load

        damped = self.band.copy(order="F")
        damped[0] += damping * damped[0] + 1e-9
        sides = np.column_stack([self.gradient, self.border])
        own, border = np.split(solveh_banded(damped, sides, lower=True, check_finite=False), [1], axis=1)
        longer = np.zeros(2)
        if learn:
            corner = self.corner - self.border.T @ border
            longer = np.linalg.solve(corner, self.border.T @ own[:, 0] - self.by_length)
        return -own[:, 0] - border @ longer, longer


def _system(arms: Arms, seen: ArmsSeen, longer: np.ndarray, fps: float) -> _System:
    seen = seen.longer(longer)
    count, number = arms.wrist.shape[:2]
    size = number * FREE
    # Columns of an arm's unknowns, then of the lengths. Points depend on the products of lengths and
    # directions alone.
    tangents = np.zeros((count, number, 9, FREE + 2))
    tangents[..., :FREE] = arms.tangents()
    of_directions = tangents.copy()
    tangents[..., UPPER, FREE], tangents[..., FOREARM, FREE + 1] = arms.upper, arms.forearm
    rows = [(*term(arms, seen), tangents) for term in POINT_TERMS]
    rows += [(*term(arms, seen), of_directions) for term in DIRECTION_TERMS]
    residual = np.concatenate([each for each, _, _ in rows], axis=-1)
    jacobian = np.concatenate([each @ by for _, each, by in rows], axis=-2)
    prior = min(count, max(ARMS.correlated_seconds * fps, 1.0)) / ARMS.length_sigma**2
    cost = float(np.square(residual).sum() + prior * np.square(longer).sum())
    gradients = (jacobian.swapaxes(-1, -2) @ residual[..., None])[..., 0]
    squared = jacobian.swapaxes(-1, -2) @ jacobian
    own = np.zeros((count, 3 * size, size))
    """Columns of the matrix: a frame with itself, the next one and the one after"""
    gradient = gradients[..., :FREE].reshape(count, size)
    by_length = gradients[..., FREE:].sum(axis=(0, 1)) + prior * longer
    border = squared[..., :FREE, FREE:].reshape(count, size, 2)
    corner = squared[..., FREE:, FREE:].sum(axis=(0, 1)) + prior * np.eye(2)
    for arm in range(number):
        at = slice(arm * FREE, (arm + 1) * FREE)
        own[:, at, at] = squared[:, arm, :FREE, :FREE]
    if number == 2:
        apart, by_arms = shoulder_width(arms, seen)
        by_each = np.einsum("tkar,tarv->tkav", by_arms, tangents)
        along, by_both = by_each[..., FREE:].sum(axis=2), by_each[..., :FREE].reshape(count, -1, size)
        turned = by_both.swapaxes(1, 2)
        own[:, :size] += turned @ by_both
        gradient += (turned @ apart[..., None])[..., 0]
        border += turned @ along
        corner += np.einsum("tkv,tkw->vw", along, along)
        by_length += np.einsum("tkv,tk->v", along, apart)
        cost += float(np.square(apart).sum())
    # Differences of the points over two and three frames, by the unknowns of each
    points = np.stack(arms.points(seen.lengths), axis=2).reshape(count, number, 9)
    by_points = np.zeros((count, number, 3, 3, 9))
    by_points[..., WRIST] = np.eye(3)
    by_points[:, :, :2, :, FOREARM] = -seen.lengths[:, :, 1, None, None, None] * np.eye(3)
    by_points[:, :, 0, :, UPPER] = -seen.lengths[:, :, 0, None, None] * np.eye(3)
    moving = by_points.reshape(count, number, 9, 9) @ tangents
    for coefficients, weight in (
        ((-1.0, 1.0), _of_speed(seen, fps)),
        ((1.0, -2.0, 1.0), _of_acceleration(fps)),
    ):
        last = max(count - len(coefficients) + 1, 0)
        change = sum(c * points[a : last + a] for a, c in enumerate(coefficients)) * weight
        along = sum(c * moving[a : last + a, ..., FREE:] for a, c in enumerate(coefficients))
        along = along * weight[..., None]
        cost += float(np.square(change).sum())
        corner += np.einsum("taiv,taiw->vw", along, along)
        by_length += np.einsum("taiv,tai->v", along, change)
        for a, ca in enumerate(coefficients):
            of_a = (ca * weight[..., None] * moving[a : last + a, ..., :FREE]).swapaxes(-1, -2)
            gradient[a : last + a] += (of_a @ change[..., None])[..., 0].reshape(-1, size)
            border[a : last + a] += (of_a @ along).reshape(-1, size, 2)
            for b, cb in enumerate(coefficients[: a + 1]):
                block = of_a @ (cb * weight[..., None] * moving[b : last + b, ..., :FREE])
                for arm in range(number):
                    at = arm * FREE
                    row = (a - b) * size + at
                    own[b : last + b, row : row + FREE, at : at + FREE] += block[:, arm]
    band = np.zeros((count, size, 3 * size))
    for column in range(size):
        band[:, column, : 3 * size - column] = own[:, column:, column]
    band = band.reshape(count * size, 3 * size).T
    return _System(cost, band, border.reshape(-1, 2), corner, gradient.reshape(-1), by_length)


def _of_acceleration(fps: float) -> np.ndarray:
    """(9,) one over the expected second differences of shoulder, elbow and wrist."""
    sigma = np.array([ARMS.shoulder_acceleration, ARMS.elbow_acceleration, ARMS.wrist_acceleration])
    return np.repeat(fps**2 / sigma, 3)


def _of_speed(seen: ArmsSeen, fps: float) -> np.ndarray:
    """(T - 1, A, 9) one over the expected first differences: an arm whose hand rests hardly moves. Nothing is
    expected of arms without a hand."""
    rows = np.arange(len(seen.wrist))
    # Over so long that the hand's own tremor is none.
    lag = max(round(0.2 * fps), 1)
    before, after = np.maximum(rows[:-1] - lag, 0), np.minimum(rows[1:] + lag, rows[-1])
    way = np.linalg.norm(seen.wrist[after] - seen.wrist[before], axis=-1, keepdims=True)
    speed = way * fps / (after - before)[:, None, None]
    weight = np.repeat(fps / (ARMS.resting_speed + ARMS.speed_share * np.nan_to_num(speed)), 9, axis=-1)
    return np.where(np.isfinite(speed), weight, 0.0)


def _robust(residual: np.ndarray, jacobian: np.ndarray) -> Rows:
    """Huber's kernel over the last axis of residuals (T, A, N, K): rows (T, A, N K) whose squares are its
    cost, with derivatives that lead downhill."""
    size = np.linalg.norm(residual, axis=-1, keepdims=True)
    safe = np.maximum(size, ARMS.huber)
    cost = np.sqrt(ARMS.huber * (2.0 * safe - ARMS.huber)) / safe
    outside = size > ARMS.huber
    residual = np.where(outside, cost, 1.0) * residual
    jacobian = np.where(outside, ARMS.huber / safe / cost, 1.0)[..., None] * jacobian
    shape = residual.shape[:2]
    return residual.reshape(*shape, -1), jacobian.reshape(*shape, -1, 9)


def _across(direction: np.ndarray) -> np.ndarray:
    """(..., 3) unit vectors -> (..., 3, 2) two axes across each."""
    facing = np.where(direction[..., 2:] < 0.0, -1.0, 1.0)
    return turn_from_axis(direction * facing)[..., :2]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
