"""The part of re-fitting that needs the solver: observations made from pins and touches, and their fits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from handfit_core.common.arrays import arrays_of
from handfit_core.common.batch import Batch, scatter
from handfit_core.common.errors import Cancelled
from handfit_core.common.skeleton import JOINTS_BY_FINGER, NUM_JOINTS, NUM_KEYPOINTS, PALM_KEYPOINTS, Side
from handfit_core.detect.correction.corrected import landmarked
from handfit_core.detect.keypoints import Detections, Landmarked
from handfit_core.edit import pins as pinning
from handfit_core.edit.free import is_free, pose_from_pins
from handfit_core.edit.hand import RefineHand
from handfit_core.edit.handles import landmark_points
from handfit_core.edit.settings import EDITS
from handfit_core.fit.fast import FastFitter, fitter_of, smooth_track
from handfit_core.fit.gaps import Times, detect_cuts, missing_between
from handfit_core.fit.observation import (
    Observation,
    PoseAnchor,
    SecondView,
    observation_of,
)
from handfit_core.fit.problem import FixedJoints
from handfit_core.fit.seen_over_time import SeenOverTime
from handfit_core.fit.settings import SOLVER, TERMS
from handfit_core.fit.solution import Solution
from handfit_core.fit.solvers import ShouldStop
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.anatomy import joint_limits
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import HandMotion


def load() -> None:
    """Import SciPy now, so that the first range does not wait for it."""
    import scipy.linalg  # noqa: F401 (slow to load)


def solve_each(
    hand: RefineHand, model: HandModel, guess: HandMotion | None, *, draft: bool = False
) -> HandMotion:
    """Fit all T frames, each by itself.

    `draft`: a few steps from `guess`, or from the frame's own pose where there is none.
    """
    posed, points = posed_in_front(hand, model)
    pose = [np.where(posed[:, None], np.asarray(rows, dtype=np.float64), np.nan) for rows in hand.pose]
    fitter, fixed = fitter_of(model), posed[:, None] & np.asarray(hand.locked, dtype=bool)
    free = posed & is_free(hand.pins) & hand.added
    for row in np.flatnonzero(free):
        own = states_of(fitter, hand, hand, posed[[row]], np.array([row]))
        most = EDITS.free_draft_iterations if draft else EDITS.max_iterations
        state = pose_from_pins(fitter, hand.intrinsics, hand.pins[row], own, fixed[row], most)
        for all_rows, found in zip(pose, fitter.chain.parameters(state)[1:], strict=True):
            all_rows[row] = found[0]
    if free[hand.touching].any():
        # Once its pins have posed an added hand, it is corrected like others.
        hand = hand.with_pose(*pose)
        posed, points = posed_in_front(hand, model)
    corrected = (hand.pinned.any(axis=1) & ~free) | hand.touching
    rows = np.flatnonzero(np.where(posed, corrected, hand.detected))
    if not len(rows):
        return with_fixed(hand, fixed, pose)
    detected = _landmarks(hand, rows)
    seen = pinning.landmarks_of_pose(points[rows], hand.intrinsics).where(posed[rows], detected)
    for at, part in chunks_of(rows):
        observed = observation_of(seen.select(part), hand.intrinsics)
        own = _start(fitter, hand, hand, posed[at], observed, at)
        near = own if draft else None
        if draft and guess is not None:
            there = guess.present[at]
            near = _start(fitter, hand, guess, there, observed, at).where(there, own)
        frames = _Frames(
            fitter, hand.intrinsics, hand.pins[at], posed[at], fixed[at],
            seen.select(part), detected.select(part), own, near, _touches(hand, at),
        )  # fmt: skip
        state, fixed[at] = frames.corrected()
        for all_rows, found in zip(pose, fitter.chain.parameters(state)[1:], strict=True):
            all_rows[at] = found
    return with_fixed(hand, fixed, pose)


@dataclass(frozen=True, eq=False)
class _Frames(Batch):
    """B frames that are corrected, each by itself, with all that their fits need."""

    fitter: FastFitter
    intrinsics: Intrinsics
    pins: np.ndarray
    """(B, 21, 2) pixels of the pins; NaN where a point is not pinned"""
    posed: np.ndarray
    """(B,) bool: true for frames that have a pose, which is then corrected"""
    locked: np.ndarray
    """(B, 16) bool: joints that stay as they are, in frames that have a pose"""
    seen: Landmarked
    """The landmarks of each frame's pose, or the detected ones where there is no pose"""
    detected: Landmarked
    """The detected landmarks; NaN where nothing is detected"""
    own: State
    """The pose of each frame, or a relaxed hand where there is none"""
    near: State | None
    """The states that a draft starts from; None where this is no draft"""
    touches: np.ndarray | None
    """(B, 21) the keypoint that each keypoint touches, as in `RefineHand.touches`; None where nothing
    touches"""

    def corrected(self) -> tuple[State, np.ndarray]:
        """Fit the frames; return their poses, and the joints (B, 16) bool that have not moved."""
        state, fixed = self.own, self.locked | self.posed[:, None]
        alone = np.flatnonzero(self.posed & ~self._idle.all(axis=1))
        if len(alone):
            some = self.select(alone)
            found, fixed[alone] = some._solve_fingers()
            state = state.replaced(alone, found)
        points = self.fitter.chain.points(state)
        seen = pinning.landmarks_of_pose(points, self.intrinsics).where(self.posed, self.seen)
        left = pinning.displacement(self.pins, seen.pixels)
        fall_short = (left.max(axis=1) > pinning.PINS.reached_pixels) & ~self.locked[:, 0]
        palm = np.flatnonzero(fall_short | ~self.posed)
        if len(palm):
            some = self.select(palm)
            found, fixed[palm] = some._solve_palm(state.select(palm), seen.select(palm), left[palm])
            state = state.replaced(palm, found)
        return state, fixed

    @property
    def _touching(self) -> np.ndarray:
        """(B, 5) bool: true for fingers with points beyond the palm that touch or are touched."""
        fingers = np.zeros((len(self), 5), dtype=bool)
        if self.touches is not None:
            row, point = np.nonzero(np.isfinite(self.touches))
            for points in (point, np.abs(self.touches[row, point]).astype(int)):
                at = ~np.isin(points, PALM_KEYPOINTS)
                fingers[row[at], (points[at] - 1) // 4] = True
        return fingers

    @property
    def _idle(self) -> np.ndarray:
        """(B, 5) bool: true for fingers that neither pins nor touches move by themselves."""
        return pinning.unpinned_fingers(self.pins) & ~self._touching

    def _solve_fingers(self) -> tuple[State, np.ndarray]:
        """Fit the fingers with pins beyond their knuckles, and those that touch; all else is fixed.

        Returns the poses, and the joints (B, 16) bool that were fixed.
        """
        pins = pinning.finger_pins(self.pins)
        displaced = pinning.displacement(pins, self.seen.pixels)
        forget = pinning.propagate(displaced)
        seen = pinning.blend_to_detection(self.seen, self.detected, forget)
        touched = self.fitter, self.intrinsics, self.own, self.touches, displaced
        uncertainty = pinning.propagate(_with_touches(*touched))
        seen = pinning.apply_pins(seen, pins, pinning.propagate(_with_touches(*touched, seen=True)))
        fixed = self.locked | _joints(np.ones(len(pins), dtype=bool), self._idle)
        free_distance = np.full(len(pins), np.inf)
        # A pin that a finger cannot reach must not pull it beyond what joints can do.
        seen = replace(seen, pinned=None)
        start = self.own if self.near is None else replace(self.own, angles=self.near.angles)
        found = self._solved(seen, self.own, free_distance, uncertainty, fixed, [start])
        if self.near is None:
            if self.touches is not None:
                # Frames in which the same points touch do so in the same way, and one between two others as
                # they do.
                touching = np.isfinite(self.touches).any(axis=1)
                _, reason = np.unique(np.nan_to_num(self.touches, nan=-1.0), axis=0, return_inverse=True)
                groups = [np.flatnonzero((reason.reshape(-1) == one) & touching) for one in np.unique(reason)]
                bends = np.zeros_like(found.angles)
                for rows in filter(len, groups):
                    bends[rows] = np.median((found.angles - self.own.angles)[rows], axis=0)
                start = replace(self.own, angles=self.own.angles + bends)
                found = self._solved(seen, self.own, free_distance, uncertainty, fixed, [start])
                bends = found.angles - self.own.angles
                for rows in filter(len, groups):
                    beside = bends[[rows[0], *rows[:-1]]], bends[[*rows[1:], rows[-1]]]
                    bends[rows] = np.median([*beside, bends[rows]], axis=0)
                start = replace(self.own, angles=self.own.angles + bends)
                found = self._solved(seen, start, free_distance, uncertainty, fixed, [start])
            points = self.fitter.chain.points(found)
            left = pinning.displacement(pins, self.intrinsics.project(points))
            short = np.flatnonzero(left.max(axis=1) > pinning.PINS.reached_pixels)
            if len(short):
                some, kept = self.select(short), self.own.select(short)
                starts = [found.select(short), *some._restart_poses()]
                own = uncertainty[short], fixed[short], starts
                found = found.replaced(
                    short, some._solved(seen.select(short), kept, free_distance[short], *own)
                )
        return found, fixed

    def _restart_poses(self) -> list[State]:
        """Return the hands with their fingers bent as in `restart_bends`, to start again with fingers that
        are stuck on their way."""
        model = self.fitter.model
        upper = joint_limits(model.side, model.name).upper[JOINTS_BY_FINGER - 1]  # (5, 3, 3)
        states = []
        for bends in EDITS.restart_bends:
            angles = np.zeros((1, 5, 3, 3))
            angles[0, ..., 2] = np.array(bends) * upper[..., 2]
            states.append(
                replace(self.own, angles=np.broadcast_to(angles.reshape(1, 5, 9), self.own.angles.shape))
            )
        return states

    def _solve_palm(self, reached: State, seen: Landmarked, left: np.ndarray) -> tuple[State, np.ndarray]:
        """Fit palm and fingers from the pose `reached` by the fingers alone, whose landmarks are `seen`;
        `left` are the pixels (B, 21) from there to the pins.

        Returns the poses, and the joints (B, 16) bool that were fixed.
        """
        size = pinning.hand_sizes(seen.pixels)
        uncertainty = pinning.propagate(
            _with_touches(self.fitter, self.intrinsics, reached, self.touches, left)
        )
        forget = pinning.propagate(pinning.palm_displacement(left))
        distance_sigma = np.where(self.posed, pinning.distance_sigma(left, size), np.inf)
        aim = pinning.apply_pins(
            pinning.blend_to_detection(seen, self.detected, forget), self.pins, uncertainty
        )
        still = pinning.unmoved_fingers(uncertainty) & self._idle
        fixed = self.locked | _joints(np.zeros(len(uncertainty), dtype=bool), self.posed[:, None] & still)
        # A finger draws the hand along as it is; wrist and knuckles rather turn it.
        starts = [self._shifted(reached, seen.pixels)]
        turns = pinning.palm_displacement(left).any(axis=1)
        if self.near is not None:
            starts.insert(0, replace(self.near, angles=reached.angles))
        elif turns.any():
            starts.insert(0, reached.where(np.asarray(turns), starts[0]))
        return self._solved(aim, reached, distance_sigma, uncertainty, fixed, starts), fixed

    def _shifted(self, state: State, pixels: np.ndarray) -> State:
        """Return the hands, whose landmarks are at `pixels` (B, 21, 2), moved across the pictures by the mean
        displacement of their pins; hands without pins stay."""
        off = self.pins - pixels
        at = np.asarray(np.isfinite(off).all(axis=-1))
        mean = np.where(at[..., None], off, 0.0).sum(axis=1) / np.maximum(at.sum(axis=1), 1)[:, None]
        lens, moved = self.intrinsics, state.wrist.copy()
        moved[:, :2] += state.wrist[:, 2:] * (mean / (lens.fx, lens.fy))
        return replace(state, wrist=moved)

    def _solved(
        self,
        seen: Landmarked,
        kept: State,
        distance_sigma: np.ndarray,
        uncertainty: np.ndarray,
        fixed: np.ndarray,
        starts: list[State],
    ) -> State:
        observed = observation_of(seen, self.intrinsics)
        # A frame without a pose has nothing to keep.
        turned = pinning.angle_sigma(uncertainty, pinning.hand_sizes(seen.pixels), self._idle)
        turned = np.where(self.posed[:, None], turned, np.inf)
        limits = np.where(self.posed, pinning.PINS.limits_sigma, np.nan)
        near = PoseAnchor.at(kept, distance_sigma, turned, limits)
        most = EDITS.max_iterations if self.near is None else EDITS.draft_iterations
        observed = replace(observed, anchor=near, touches=self.touches)
        return cheapest(self.fitter, observed, starts, fixed_at(fixed, kept), most, solid=True).state


def solve_range(hand: RefineHand, model: HandModel, should_stop: ShouldStop) -> HandMotion:
    """Fit all T frames over time. Frames with pins or touches are fitted twice: without these, which gives
    the wrist's distance, and with them."""
    posed, points = posed_in_front(hand, model)
    edited = hand.pinned.any(axis=1) | hand.touching
    rows = np.flatnonzero(hand.detected | (posed & edited))
    if not len(rows):
        return HandMotion(hand.side, hand.betas, *(np.full(np.shape(each), np.nan) for each in hand.pose))
    keep = pinning.landmarks_of_pose(points[rows], hand.intrinsics)
    stand_in = EDITS.stand_in_factor * keep.pixel_sigma, keep.depth, EDITS.stand_in_factor * keep.depth_sigma
    detected, second = _two_view_landmarks(hand, rows)
    seen = detected.where(hand.detected[rows], Landmarked(keep.pixels, *stand_in))
    # Cuts are found before pins are applied, as one of these may lie far away.
    cuts = detect_cuts(seen.pixels) | missing_between(rows, hand.holes)
    locked = posed[:, None] & np.asarray(hand.locked, dtype=bool)
    fitter = fitter_of(model)
    everywhere = fixed_at(locked, states_of(fitter, hand, hand, posed, np.arange(len(hand))))

    def smoothly(observed: Observation, state: State) -> tuple[np.ndarray, State]:
        return smooth_track(
            fitter, observed, state, rows, cuts, hand.smoothing, hand.fps, everywhere,
            lambda: check_stop(should_stop),
        )  # fmt: skip

    observed = replace(observation_of(seen, hand.intrinsics), second=second)
    parts = []
    for at, part in chunks_of(rows):
        check_stop(should_stop)
        here = observed.select(part)
        own = _start(fitter, hand, hand, posed[at], here, at)
        parts.append(cheapest(fitter, here, [own], fixed_at(locked[at], own)))
    fixed = None if everywhere is None else everywhere.select(rows)
    times = Times.between(rows, cuts, hand.fps)
    observed, solution = fitter.solve_solid(observed, Solution.concatenate(parts), times, fixed)
    alone = solution.state
    frames, state = smoothly(observed, alone)
    if edited[rows].any():
        plain = state.select(np.searchsorted(frames, rows))
        pinned, touched = _corrected(fitter, hand, seen, second, rows, plain)
        observed = replace(pinned, self_contact=observed.self_contact)
        corrected = [alone]
        for at, _ in chunks_of(touched):
            check_stop(should_stop)
            fixed = None if everywhere is None else everywhere.select(rows[at])
            start = [plain.select(at)]
            found = cheapest(fitter, observed.select(at), start, fixed, EDITS.max_iterations, solid=True)
            corrected.append(found.state)
        latest = np.arange(len(rows))
        latest[touched] = len(rows) + np.arange(len(touched))
        frames, state = smoothly(observed, State.concatenate(corrected).select(latest))
    pose = [scatter(found, frames, len(hand)) for found in fitter.chain.parameters(state)[1:]]
    motion = with_fixed(hand, locked, pose)
    if not hand.touching.any():
        return motion
    check_stop(should_stop)
    # Smoothing leaves gaps between points that touch; their fingers close them.
    pins = np.where(hand.touching[:, None, None], hand.pins, np.nan)
    return solve_each(replace(hand.with_pose(*motion.pose), pins=pins), model, None)


def _corrected(
    fitter: FastFitter,
    hand: RefineHand,
    seen: Landmarked,
    second: SecondView | None,
    rows: np.ndarray,
    plain: State,
) -> tuple[Observation, np.ndarray]:
    """Make the observation of the frames `rows` with their pins and touches; return it with the indices of
    the frames that these change.

    Distances are kept at those of `plain`, the fit without pins and touches.
    """
    pins, size, touches = hand.pins[rows], pinning.hand_sizes(seen.pixels), _touches(hand, rows)
    displaced = pinning.displacement(pins, seen.pixels)
    displaced = _with_touches(fitter, hand.intrinsics, plain, touches, displaced)
    displaced = pinning.propagate_in_time(displaced, rows, hand.fps)
    uncertainty = pinning.propagate(displaced)
    touched = uncertainty.any(axis=1) | hand.pinned[rows].any(axis=1) | hand.touching[rows]
    anchor = PoseAnchor.at(plain, pinning.distance_sigma(displaced, size))
    observed = observation_of(pinning.apply_pins(seen, pins, uncertainty), hand.intrinsics)
    if second is not None:
        there = uncertainty * (pinning.hand_sizes(second.pixels) / size)[:, None]
        sigma = np.hypot(second.pixel_sigma, pinning.PINS.sigma_per_pixel * there[..., None])
        second = replace(second, pixel_sigma=sigma)
    return replace(observed, anchor=anchor, touches=touches, second=second), np.flatnonzero(touched)


def _touches(hand: RefineHand, rows: np.ndarray) -> np.ndarray | None:
    """Return the touches (N, 21) of the frames `rows`; None where there are none."""
    return None if hand.touches is None or not hand.touching[rows].any() else np.asarray(hand.touches)[rows]


def _with_touches(
    fitter: FastFitter,
    intrinsics: Intrinsics,
    state: State,
    touches: np.ndarray | None,
    displaced: np.ndarray,
    *,
    seen: bool = False,
) -> np.ndarray:
    """Return the pixels (B, 21) by which pins displace points, increased by what touches (B, 21) displace
    them; with `seen` by what can be seen of that, across the line of sight.

    Either finger of a touch may have to close the whole gap; the palm does not move for it.
    """
    if touches is None:
        return displaced
    row, point = np.nonzero(np.isfinite(touches))
    other = touches[row, point].astype(int)
    capsules = fitter.surface.capsules(fitter.chain.pose(state))
    near = fitter.surface.gaps_at(capsules, row, np.stack([point, other], axis=1))
    gap = np.abs(near.gap)
    if seen:
        sight = near.places.mean(axis=1)
        sight /= np.linalg.norm(sight, axis=1, keepdims=True)
        gap *= np.linalg.norm(np.cross(near.towards, sight), axis=1)
    gap *= 0.5 * (intrinsics.fx + intrinsics.fy) / state.wrist[row, 2]
    other = np.abs(other)
    most = pinning.propagate(displaced)
    most = gap + np.maximum(most[row, point], np.where(other > 0, most[row, other], 0.0))
    drawn = displaced.copy()
    for points in (point, other):
        at = ~np.isin(points, PALM_KEYPOINTS)
        np.maximum.at(drawn, (row[at], points[at]), most[at])
    return drawn


def with_fixed(hand: RefineHand, fixed: np.ndarray, pose: Sequence[np.ndarray]) -> HandMotion:
    """Return the solver's poses, with those of the joints that `fixed` (T, 16) bool marks as they were given,
    to the last bit."""
    wrist, fingers = fixed[:, :1].repeat(3, axis=1), fixed[:, 1:].repeat(3, axis=1)
    rows = (
        np.where(np.isfinite(found) & joints, own, found)
        for found, joints, own in zip(pose, (wrist, fingers, wrist), hand.pose, strict=True)
    )
    return HandMotion(hand.side, hand.betas, *rows)


def _joints(wrist: np.ndarray, fingers: np.ndarray) -> np.ndarray:
    """Spread a value of each wrist (N,) and of each finger (N, 5) over their joints (N, 16), in MANO's
    order."""
    joints = np.empty((len(fingers), NUM_JOINTS), dtype=fingers.dtype)
    joints[:, 0] = wrist
    joints[:, JOINTS_BY_FINGER] = fingers[..., None]
    return joints


def check_stop(should_stop: ShouldStop) -> None:
    """Raise Cancelled when `should_stop` says that the fit is to stop."""
    if should_stop():
        raise Cancelled("re-fitting was stopped; nothing was changed")


def posed_in_front(hand: RefineHand, model: HandModel) -> tuple[np.ndarray, np.ndarray]:
    """Return which frames have a pose in front of the camera, (T,) bool, and the landmarks (T, 21, 3) of
    these poses in metres, camera frame, with ones in all other frames."""
    posed = hand.present
    points = np.ones((len(hand), NUM_KEYPOINTS, 3))
    points[posed] = landmark_points(model, hand.betas, *(rows[posed] for rows in hand.pose))
    behind = points[..., 2].min(axis=1) <= TERMS.nearest
    points[behind] = 1.0
    return posed & ~behind, points


def _landmarks(hand: RefineHand, rows: np.ndarray) -> Landmarked:
    """Return the corrected landmarks of the frames `rows`; NaN where nothing is detected."""
    there = hand.detected[rows]
    return _over_rows(_corrected_once(hand.side, _detections_in(hand, rows[there])), there)


def _two_view_landmarks(hand: RefineHand, rows: np.ndarray) -> tuple[Landmarked, SecondView | None]:
    """Return the landmarks of the frames `rows`, and what the second camera saw of them; None where it saw
    nothing. Where both views see the hand they are weighted as a capture of two views weights them."""
    second = hand.second
    if second is None or not len(second.times):
        return _landmarks(hand, rows), None
    there, moments = hand.detected[rows], second.moments[rows]
    found = landmarked(_detections_in(hand, rows[there]), hand.side)
    other = SeenOverTime(second.times, landmarked(second.detections, hand.side), second.fps)
    if there.any():
        own = SeenOverTime(moments[there], found, hand.fps)
        plain = observation_of(found, hand.intrinsics)
        found = other.in_second_view(plain, own.sigmas, own.times, second.camera)
    seen = SecondView.through(second.camera, other.at(moments)[0], other.sigmas_at(moments))
    return _over_rows(found, there), seen


def _detections_in(hand: RefineHand, frames: np.ndarray) -> Detections:
    return hand.detections.select(np.searchsorted(hand.detections.frame, frames))


def _over_rows(seen: Landmarked, there: np.ndarray) -> Landmarked:
    """Spread landmarks over N frames: they belong to the frames that `there` (N,) bool marks, and the others
    get NaN."""
    columns = (seen.pixels, seen.pixel_sigma, seen.depth, seen.depth_sigma)
    return Landmarked(*(scatter(each, there, len(there)) for each in columns))


_LAST: list[tuple[tuple[object, ...], Landmarked]] = []
"""The landmarks of the last few detections, as a drag asks for the same ones again and again: none or one"""


def _corrected_once(side: Side, detections: Detections) -> Landmarked:
    if len(detections) > EDITS.most_remembered:
        return landmarked(detections, side)
    key = (side, *((name, column.tobytes()) for name, column in arrays_of(detections).items()))
    if not _LAST or _LAST[0][0] != key:
        _LAST[:] = [(key, landmarked(detections, side))]
    return _LAST[0][1]


def chunks_of(rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Split the frames `rows` into chunks; yields each chunk's frames, and their indices in `rows`."""
    for first in range(0, len(rows), SOLVER.chunk_frames):
        part = np.arange(first, min(first + SOLVER.chunk_frames, len(rows)))
        yield rows[part], part


def states_of(
    fitter: FastFitter,
    hand: RefineHand,
    source: HandMotion,
    known: np.ndarray,
    rows: np.ndarray,
) -> State:
    """Return the poses that `source` has in the frames `rows`; where they are not `known`, a flat hand at the
    camera."""
    orient, fingers, place = (
        np.where(known[:, None], np.asarray(each, dtype=np.float64)[rows], 0.0) for each in source.pose
    )
    betas = np.broadcast_to(np.asarray(hand.betas, dtype=np.float64), (len(rows), len(hand.betas)))
    return fitter.chain.state(betas, orient, fingers, place, np.zeros(len(rows)))


def _start(
    fitter: FastFitter,
    hand: RefineHand,
    source: HandMotion,
    known: np.ndarray,
    observed: Observation,
    rows: np.ndarray,
) -> State:
    """Return the states that the solver starts from: the poses of `source` with where depth is zero, and a
    relaxed hand where no pose is known."""
    state = states_of(fitter, hand, source, known, rows)
    along = (fitter.chain.points(state) * observed.ray[:, None]).sum(axis=2).mean(axis=1)
    state = replace(state, depth_zero=along)
    if known.all():
        return state
    return state.where(known, fitter.start(observed, np.asarray(hand.betas, dtype=np.float64)))


def cheapest(
    fitter: FastFitter,
    observed: Observation,
    starts: Sequence[State],
    fixed: FixedJoints | None,
    max_iterations: int | None = None,
    *,
    solid: bool = False,
) -> Solution:
    """Fit independent frames from each of several starts, and take the lowest cost, or the first start's
    where it is not much higher. `max_iterations`: None for as many as captures take."""
    count = len(observed)
    index = np.tile(np.arange(count), len(starts))
    fixed = fixed if fixed is None or len(starts) == 1 else fixed.select(index)
    start = State.concatenate(starts)
    observed = observed if len(starts) == 1 else observed.select(index)
    problem = fitter.problem(observed, fixed=fixed, solid=solid)
    solution = fitter.solve_each(problem, start if fixed is None else fixed.put(start), max_iterations)
    if len(starts) == 1:
        return solution
    cost = np.nan_to_num(solution.cost, nan=np.inf, posinf=np.inf).reshape(len(starts), count)
    cost[0] *= EDITS.restart_cost_ratio
    return solution.select(cost.argmin(axis=0) * count + np.arange(count))


def fixed_at(joints: np.ndarray, state: State) -> FixedJoints | None:
    """Return the joints (B, 16) bool of B hands as fixed at `state`; None where no joint is."""
    return FixedJoints(joints, state) if joints.any() else None
