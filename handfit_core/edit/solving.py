"""The heavy half of re-fitting: what is fitted to, and the fast solver over it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.batch import Batch
from handfit_core.detect.correction.corrected import landmarked
from handfit_core.detect.keypoints import HandDetection, Landmarked
from handfit_core.edit import pins as pinning
from handfit_core.edit.free import freely_posed, is_free
from handfit_core.edit.hand import START_ARRAYS, RefineHand, RefineResult
from handfit_core.edit.handles import landmark_points
from handfit_core.errors import Cancelled
from handfit_core.fit.fast import CHUNK, FastFitter, fitter_of, over_time
from handfit_core.fit.gaps import Times, jumps, missing_between
from handfit_core.fit.observation import Kept, Observation, kept_at_distance, observation_of
from handfit_core.fit.problem import Held
from handfit_core.fit.solution import Solution
from handfit_core.fit.terms.reprojection import NEAREST
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.anatomy import joint_limits
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.data import HandModel
from handfit_core.skeleton import JOINTS_BY_FINGER, NUM_JOINTS, NUM_KEYPOINTS, PALM_KEYPOINTS, Side
from handfit_core.solvers import ShouldStop

LOOSE: Final = 4.0
"""times the expected errors of a pose's points, where they stand in for a detection among others"""
MAX_ITERATIONS: Final = 50
"""More than captures take. Where they are too few, a drag's result does still not depend on the way there:
from the frame's own pose the steps are the same every time."""
DRAFT_ITERATIONS: Final = 6
"""While a point is dragged, each answer goes on where the one before ended"""
FREE_DRAFT_ITERATIONS: Final = 10
"""of hands that begin anew each time, from all sides"""
CHEAPER: Final = 0.9
"""of the cost from the first start: where another leads to less, its result counts"""
OTHER_BENDS: Final = ((0.0, 0.1, 0.1), (0.5, 0.5, 0.5), (0.9, 0.2, 0.2), (0.2, 0.9, 0.7))
"""of what a finger's three joints can do: where a finger that cannot reach its pin begins again"""


def load() -> None:
    """What is else imported with the first range."""
    import scipy.linalg  # noqa: F401


def each(
    hand: RefineHand, model: HandModel, guess: RefineResult | None, *, draft: bool = False
) -> dict[str, np.ndarray]:
    """Poses (T rows) of all frames, each by itself. `draft`: a few steps from the guess, or from the frame's
    own pose where there is none."""
    pose = {name: np.array(getattr(hand, name), dtype=np.float64) for name in START_ARRAYS}
    posed, points = _posed(hand, model)
    for values in pose.values():
        values[~posed] = np.nan
    fitter, held = fitter_of(model), posed[:, None] & np.asarray(hand.locked, dtype=bool)
    free = posed & is_free(hand.pins) & hand.added
    for row in np.flatnonzero(free):
        own = _poses(fitter, hand, hand, posed[[row]], np.array([row]))
        most = FREE_DRAFT_ITERATIONS if draft else MAX_ITERATIONS
        state = freely_posed(fitter, hand.intrinsics, hand.pins[row], own, held[row], most)
        for name, values in zip(START_ARRAYS, fitter.chain.parameters(state)[1:], strict=True):
            pose[name][row] = values[0]
    if free[hand.touching].any():
        # Where their pins put them, they are hands like others.
        hand = replace(hand, **pose)
        posed, points = _posed(hand, model)
    corrected = (hand.pinned.any(axis=1) & ~free) | hand.touching
    rows = np.flatnonzero(np.where(posed, corrected, hand.detected))
    if not len(rows):
        return _with_held(hand, held, pose)
    detected = _detected(hand, rows)
    seen = pinning.kept(points[rows], hand.intrinsics).where(posed[rows], detected)
    for at, part in _chunks(rows):
        observed = observation_of(seen.select(part), hand.intrinsics)
        own = _start(fitter, hand, hand, posed[at], observed, at)
        near = own if draft else None
        if draft and guess is not None:
            there = guess.present[at]
            near = _start(fitter, hand, guess, there, observed, at).where(there, own)
        frames = _Frames(
            fitter, hand.intrinsics, hand.pins[at], posed[at], held[at],
            seen.select(part), detected.select(part), own, near, _touches(hand, at),
        )  # fmt: skip
        state, held[at] = frames.corrected()
        for name, values in zip(START_ARRAYS, fitter.chain.parameters(state)[1:], strict=True):
            pose[name][at] = values
    return _with_held(hand, held, pose)


@dataclass(frozen=True, eq=False)
class _Frames(Batch):
    """B frames that are corrected, each by itself."""

    fitter: FastFitter
    intrinsics: Intrinsics
    pins: np.ndarray
    """(B, 21, 2) pixels"""
    posed: np.ndarray
    """(B,) bool: frames that have a pose, which is corrected"""
    locked: np.ndarray
    """(B, 16) bool: joints of those that stay as they are"""
    seen: Landmarked
    """That pose's landmarks, or the detected ones where there is none"""
    detected: Landmarked
    """NaN where nothing is detected"""
    own: State
    """That pose, or a relaxed hand"""
    near: State | None
    """Where a draft begins; None: this is no draft"""
    touches: np.ndarray | None
    """(B, 21) as in `RefineHand`"""

    def corrected(self) -> tuple[State, np.ndarray]:
        """Their poses, and which joints (B, 16) bool have not moved."""
        state, held = self.own, self.locked | self.posed[:, None]
        alone = np.flatnonzero(self.posed & ~self._idle.all(axis=1))
        if len(alone):
            some = self.select(alone)
            found, held[alone] = some._fingers_alone()
            state = _put(state, alone, found)
        seen = pinning.kept(_points(self.fitter, state), self.intrinsics).where(self.posed, self.seen)
        left = pinning.displacement(self.pins, seen.pixels)
        fall_short = (left.max(axis=1) > pinning.REACHED) & ~self.locked[:, 0]
        palm = np.flatnonzero(fall_short | ~self.posed)
        if len(palm):
            some = self.select(palm)
            found, held[palm] = some._palm_follows(state.select(palm), seen.select(palm), left[palm])
            state = _put(state, palm, found)
        return state, held

    @property
    def _touching(self) -> np.ndarray:
        """(B, 5) bool: fingers with points beyond the palm that touch or are touched."""
        fingers = np.zeros((len(self), 5), dtype=bool)
        if self.touches is not None:
            row, point = np.nonzero(np.isfinite(self.touches))
            for points in (point, self.touches[row, point].astype(int)):
                at = ~np.isin(points, PALM_KEYPOINTS)
                fingers[row[at], (points[at] - 1) // 4] = True
        return fingers

    @property
    def _idle(self) -> np.ndarray:
        """(B, 5) bool: fingers that neither pins nor touches move by themselves."""
        return pinning.unpinned(self.pins) & ~self._touching

    def _fingers_alone(self) -> tuple[State, np.ndarray]:
        """Fingers with pins beyond their knuckles go for these, and those that touch for each other; all else
        is held."""
        pins = pinning.of_fingers(self.pins)
        displaced = pinning.displacement(pins, self.seen.pixels)
        seen = pinning.forgetting(self.seen, self.detected, pinning.followed(displaced))
        doubt = pinning.followed(
            _drawn_together(self.fitter, self.intrinsics, self.own, self.touches, displaced)
        )
        seen = pinning.pinned(seen, pins, doubt)
        held = self.locked | _joints(np.ones(len(pins), dtype=bool), self._idle)
        anywhere = np.full(len(pins), np.inf)
        # A pin that a finger cannot reach must not pull it beyond what joints can do.
        seen = replace(seen, pinned=None)
        start = self.own if self.near is None else replace(self.own, angles=self.near.angles)
        found = self._solved(seen, self.own, anywhere, doubt, held, [start])
        if self.near is None:
            if self.touches is not None:
                # Frames in which the same points touch do so in the same way.
                _, reason = np.unique(np.nan_to_num(self.touches, nan=-1.0), axis=0, return_inverse=True)
                bends = np.zeros_like(found.angles)
                for one in np.unique(reason):
                    same = (reason.reshape(-1) == one) & np.isfinite(self.touches).any(axis=1)
                    if same.any():
                        bends[same] = np.median((found.angles - self.own.angles)[same], axis=0)
                start = replace(self.own, angles=self.own.angles + bends)
                found = self._solved(seen, self.own, anywhere, doubt, held, [start])
            left = pinning.displacement(pins, self.intrinsics.project(_points(self.fitter, found)))
            short = np.flatnonzero(left.max(axis=1) > pinning.REACHED)
            if len(short):
                some, kept = self.select(short), self.own.select(short)
                starts = [found.select(short), *some._other_bends()]
                others = seen.select(short), kept, anywhere[short], doubt[short], held[short], starts
                found = _put(found, short, some._solved(*others))
        return found, held

    def _other_bends(self) -> list[State]:
        """The same hands with fingers bent anew: one may find no way from its pose to what it can reach."""
        model = self.fitter.model
        upper = joint_limits(model.side, model.name).upper[JOINTS_BY_FINGER - 1]  # (5, 3, 3)
        states = []
        for bends in OTHER_BENDS:
            angles = np.zeros((1, 5, 3, 3))
            angles[0, ..., 2] = np.array(bends) * upper[..., 2]
            states.append(
                replace(self.own, angles=np.broadcast_to(angles.reshape(1, 5, 9), self.own.angles.shape))
            )
        return states

    def _palm_follows(self, reached: State, seen: Landmarked, left: np.ndarray) -> tuple[State, np.ndarray]:
        """From where fingers alone lead, and what is seen of that: palm and fingers go for what is `left`
        (B, 21) pixels."""
        size = pinning.sizes(seen.pixels)
        doubt = pinning.followed(_drawn_together(self.fitter, self.intrinsics, reached, self.touches, left))
        forget = pinning.followed(pinning.of_palm(left))
        far = np.where(self.posed, pinning.distance_sigma(left, size), np.inf)
        aim = pinning.pinned(pinning.forgetting(seen, self.detected, forget), self.pins, doubt)
        still = pinning.untouched(doubt) & self._idle
        held = self.locked | _joints(np.zeros(len(doubt), dtype=bool), self.posed[:, None] & still)
        # A finger draws the hand along as it is; wrist and knuckles rather turn it.
        starts = [self._shifted(reached, seen.pixels)]
        turns = pinning.of_palm(left).any(axis=1)
        if self.near is not None:
            starts.insert(0, replace(self.near, angles=reached.angles))
        elif turns.any():
            starts.insert(0, reached.where(np.asarray(turns), starts[0]))
        return self._solved(aim, reached, far, doubt, held, starts), held

    def _shifted(self, state: State, pixels: np.ndarray) -> State:
        """Hands, seen at pixels (B, 21, 2), moved along the picture by what points are off their pins on
        average."""
        at = np.asarray(np.isfinite(self.pins).all(axis=-1))
        off = (
            np.where(at[..., None], self.pins - pixels, 0.0).sum(axis=1)
            / np.maximum(at.sum(axis=1), 1)[:, None]
        )
        focal = np.array([self.intrinsics.fx, self.intrinsics.fy])
        moved = state.wrist.copy()
        moved[:, :2] += state.wrist[:, 2:] * (off / focal)
        return replace(state, wrist=moved)

    def _solved(
        self,
        seen: Landmarked,
        kept: State,
        far: np.ndarray,
        doubt: np.ndarray,
        held: np.ndarray,
        starts: list[State],
    ) -> State:
        observed = observation_of(seen, self.intrinsics)
        # A frame without a pose has nothing to keep.
        turned = pinning.angle_sigma(doubt, pinning.sizes(seen.pixels), self._idle)
        turned = np.where(self.posed[:, None], turned, np.inf)
        limits = np.where(self.posed, pinning.LIMITS_SIGMA, np.nan)
        near = Kept(kept.wrist, far, kept.angles, turned, limits)
        most = MAX_ITERATIONS if self.near is None else DRAFT_ITERATIONS
        observed = replace(observed, kept=near, touches=self.touches)
        return _cheapest(self.fitter, observed, starts, _held(held, kept), most, solid=True).state


def over_range(hand: RefineHand, model: HandModel, should_stop: ShouldStop) -> dict[str, np.ndarray]:
    """Poses (T rows) of all frames, over time. Those with pins or touches are found twice: without, which
    tells how far away the wrist is, and with them."""
    pose = {name: np.full(np.shape(getattr(hand, name)), np.nan) for name in START_ARRAYS}
    posed, points = _posed(hand, model)
    told = hand.pinned.any(axis=1) | hand.touching
    rows = np.flatnonzero(hand.detected | (posed & told))
    if not len(rows):
        return pose
    keep = pinning.kept(points[rows], hand.intrinsics)
    seen = _detected(hand, rows).where(hand.detected[rows], _loosely(keep))
    # Before the pins, of which one may lie far away.
    cuts = jumps(seen.pixels) | missing_between(rows, hand.holes)
    locked = posed[:, None] & np.asarray(hand.locked, dtype=bool)
    fitter = fitter_of(model)
    everywhere = _held(locked, _poses(fitter, hand, hand, posed, np.arange(len(hand))))

    def smoothly(observed: Observation, state: State) -> tuple[np.ndarray, State]:
        return over_time(
            fitter, observed, state, rows, cuts, hand.smoothing, hand.fps, everywhere,
            lambda: _check(should_stop),
        )  # fmt: skip

    observed = observation_of(seen, hand.intrinsics)
    parts = []
    for at, part in _chunks(rows):
        _check(should_stop)
        here = observed.select(part)
        own = _start(fitter, hand, hand, posed[at], here, at)
        parts.append(_cheapest(fitter, here, [own], _held(locked[at], own)))
    held = None if everywhere is None else everywhere.select(rows)
    times = Times.between(rows, cuts, hand.fps)
    observed, solution = fitter.solve_solid(observed, Solution.joined(parts), times, held)
    alone = solution.state
    frames, state = smoothly(observed, alone)
    if told[rows].any():
        plain = state.select(np.searchsorted(frames, rows))
        pinned, touched = _corrected(fitter, hand, seen, rows, plain)
        observed = replace(pinned, meeting=observed.meeting)
        corrected = [alone]
        for at, _ in _chunks(touched):
            _check(should_stop)
            held = None if everywhere is None else everywhere.select(rows[at])
            start = [plain.select(at)]
            found = _cheapest(fitter, observed.select(at), start, held, MAX_ITERATIONS, solid=True)
            corrected.append(found.state)
        latest = np.arange(len(rows))
        latest[touched] = len(rows) + np.arange(len(touched))
        frames, state = smoothly(observed, State.joined(corrected).select(latest))
    for name, values in zip(START_ARRAYS, fitter.chain.parameters(state)[1:], strict=True):
        pose[name][frames] = values
    pose = _with_held(hand, locked, pose)
    if not hand.touching.any():
        return pose
    _check(should_stop)
    # What smoothness leaves open between points that touch, their fingers close.
    pins = np.where(hand.touching[:, None, None], hand.pins, np.nan)
    return each(replace(hand, pins=pins, **pose), model, None)


def _corrected(
    fitter: FastFitter, hand: RefineHand, seen: Landmarked, rows: np.ndarray, plain: State
) -> tuple[Observation, np.ndarray]:
    """What is seen of those frames with their pins and touches, and which of them that changes. Distances are
    kept as they are without these, in `plain`."""
    pins, size, touches = hand.pins[rows], pinning.sizes(seen.pixels), _touches(hand, rows)
    displaced = pinning.displacement(pins, seen.pixels)
    displaced = _drawn_together(fitter, hand.intrinsics, plain, touches, displaced)
    displaced = pinning.over_time(displaced, rows, hand.fps)
    doubt = pinning.followed(displaced)
    touched = doubt.any(axis=1) | hand.pinned[rows].any(axis=1) | hand.touching[rows]
    kept = kept_at_distance(plain, pinning.distance_sigma(displaced, size))
    observed = observation_of(pinning.pinned(seen, pins, doubt), hand.intrinsics)
    return replace(observed, kept=kept, touches=touches), np.flatnonzero(touched)


def _touches(hand: RefineHand, rows: np.ndarray) -> np.ndarray | None:
    """(N, 21) those frames' touches; None where there are none, as most often."""
    return None if hand.touches is None or not hand.touching[rows].any() else np.asarray(hand.touches)[rows]


def _drawn_together(
    fitter: FastFitter,
    intrinsics: Intrinsics,
    state: State,
    touches: np.ndarray | None,
    displaced: np.ndarray,
) -> np.ndarray:
    """(B, 21) pixels by which pins displace points, with those by which touches (B, 21) do: a finger goes by
    as much as they are apart, or the other finger has to. The palm does not."""
    if touches is None:
        return displaced
    row, point = np.nonzero(np.isfinite(touches))
    other = touches[row, point].astype(int)
    capsules = fitter.surface.capsules(fitter.chain.pose(state))
    gap = np.abs(fitter.surface.gaps_at(capsules, row, np.stack([point, other], axis=1)).gap)
    gap *= 0.5 * (intrinsics.fx + intrinsics.fy) / state.wrist[row, 2]
    most = pinning.followed(displaced)
    most = gap + np.maximum(most[row, point], np.where(other > 0, most[row, other], 0.0))
    drawn = displaced.copy()
    for points in (point, other):
        at = ~np.isin(points, PALM_KEYPOINTS)
        np.maximum.at(drawn, (row[at], points[at]), most[at])
    return drawn


def _with_held(hand: RefineHand, held: np.ndarray, pose: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The solver's poses with the joints that are held, (T, 16) bool, as they came, to the last bit."""
    wrist, fingers = held[:, :1].repeat(3, axis=1), held[:, 1:].repeat(3, axis=1)
    parts = {"global_orient": wrist, "hand_pose": fingers, "transl": wrist}
    return {
        name: np.where(np.isfinite(rows) & parts[name], getattr(hand, name), rows)
        for name, rows in pose.items()
    }


def _joints(wrist: np.ndarray, fingers: np.ndarray) -> np.ndarray:
    """(N,) of wrists and (N, 5) of fingers -> (N, 16) of their joints, in MANO's order."""
    joints = np.empty((len(fingers), NUM_JOINTS), dtype=fingers.dtype)
    joints[:, 0] = wrist
    joints[:, JOINTS_BY_FINGER] = fingers[..., None]
    return joints


def _points(fitter: FastFitter, state: State) -> np.ndarray:
    """(B, 21, 3) landmarks, metres, camera frame."""
    return fitter.chain.points(state)


def _put(state: State, rows: np.ndarray, found: State) -> State:
    """`state` with other poses in those rows."""
    order = np.arange(len(state))
    order[rows] = len(state) + np.arange(len(rows))
    return State.joined([state, found]).select(order)


def _check(should_stop: ShouldStop) -> None:
    if should_stop():
        raise Cancelled("re-fitting was stopped; nothing was changed")


def _posed(hand: RefineHand, model: HandModel) -> tuple[np.ndarray, np.ndarray]:
    """(T,) bool: frames whose pose can be seen, which is before the camera; and the landmarks (T, 21, 3) of
    those poses, of others some that harm nothing."""
    posed = hand.posed
    points = np.ones((len(hand), NUM_KEYPOINTS, 3))
    points[posed] = landmark_points(model, hand.betas, *(getattr(hand, n)[posed] for n in START_ARRAYS))
    behind = points[..., 2].min(axis=1) <= NEAREST
    points[behind] = 1.0
    return posed & ~behind, points


def _detected(hand: RefineHand, rows: np.ndarray) -> Landmarked:
    """Corrected landmarks of those frames; NaN where nothing is detected."""
    detections = [d for row in rows if (d := hand.detections[row]) is not None]
    there = hand.detected[rows]
    count = len(rows)
    points = (count, NUM_KEYPOINTS)
    whole = Landmarked(*(np.full(shape, np.nan) for shape in ((*points, 2), (*points, 2), points, points)))
    if detections:
        found = _corrected_once(hand.side, detections)
        order = np.where(there, np.cumsum(there) - 1, 0)
        whole = found.select(order).where(there, whole)
    return whole


_LAST: dict[str, tuple[tuple[object, ...], Landmarked]] = {}
"""The landmarks of the last single detection: a drag asks for the same ones again and again"""


def _corrected_once(side: Side, detections: list[HandDetection]) -> Landmarked:
    if len(detections) > 1:
        return landmarked(detections, side)
    (one,) = detections
    others = [None if a is None else a.tobytes() for a in (one.keypoints_2020, one.overlapped)]
    key = (side, one.side, one.score, one.keypoints.tobytes(), one.world.tobytes(), *others)
    if "one" not in _LAST or _LAST["one"][0] != key:
        _LAST["one"] = key, landmarked(detections, side)
    return _LAST["one"][1]


def _loosely(seen: Landmarked) -> Landmarked:
    return Landmarked(seen.pixels, LOOSE * seen.pixel_sigma, seen.depth, LOOSE * seen.depth_sigma)


def _chunks(rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(frames, which of `rows` they are), as many as are solved at once."""
    for first in range(0, len(rows), CHUNK):
        part = np.arange(first, min(first + CHUNK, len(rows)))
        yield rows[part], part


def _poses(
    fitter: FastFitter,
    hand: RefineHand,
    source: RefineHand | RefineResult,
    known: np.ndarray,
    rows: np.ndarray,
) -> State:
    """Those frames' poses as `source` has them; where they are not `known`, a flat hand at the camera."""
    orient, fingers, place = (
        np.where(known[:, None], np.asarray(getattr(source, name), dtype=np.float64)[rows], 0.0)
        for name in START_ARRAYS
    )
    betas = np.broadcast_to(np.asarray(hand.betas, dtype=np.float64), (len(rows), len(hand.betas)))
    return fitter.chain.state(betas, orient, fingers, place, np.zeros(len(rows)))


def _start(
    fitter: FastFitter,
    hand: RefineHand,
    source: RefineHand | RefineResult,
    known: np.ndarray,
    observed: Observation,
    rows: np.ndarray,
) -> State:
    """Where the solver begins: those poses with the depth's zero, and a relaxed hand where none is known."""
    state = _poses(fitter, hand, source, known, rows)
    along = (fitter.chain.points(state) * observed.ray[:, None]).sum(axis=2).mean(axis=1)
    state = replace(state, depth_zero=along)
    if known.all():
        return state
    return state.where(known, fitter.start(observed, np.asarray(hand.betas, dtype=np.float64)))


def _cheapest(
    fitter: FastFitter,
    observed: Observation,
    starts: Sequence[State],
    held: Held | None,
    max_iterations: int | None = None,
    *,
    solid: bool = False,
) -> Solution:
    """Those frames, each by itself and from the start that leads to the lowest cost; where it makes little
    difference, from the first. `max_iterations`: None for those of captures."""
    count = len(observed)
    index = np.tile(np.arange(count), len(starts))
    held = held if held is None or len(starts) == 1 else held.select(index)
    start = State.joined(starts)
    observed = observed if len(starts) == 1 else observed.select(index)
    problem = fitter.problem(observed, held=held, solid=solid)
    solution = fitter.solve_each(problem, start if held is None else held.put(start), max_iterations)
    if len(starts) == 1:
        return solution
    cost = np.nan_to_num(solution.cost, nan=np.inf, posinf=np.inf).reshape(len(starts), count)
    cost[0] *= CHEAPER
    return solution.select(cost.argmin(axis=0) * count + np.arange(count))


def _held(joints: np.ndarray, state: State) -> Held | None:
    """Joints (B, 16) of B hands that stay as they are in `state`."""
    return Held(joints, state) if joints.any() else None
