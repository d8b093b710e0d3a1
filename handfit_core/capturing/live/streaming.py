"""Hands that are followed while they move: `live`, a preview of what a recording is captured to afterwards.

Each frame has one run of the landmark networks a hand, in the crop where the hand was, and a few iterations
of the fit from the last pose. What comes out is smoothed without looking ahead (One-Euro filter: Casiez et
al., "1€ Filter", 2012).
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Literal, Self

import numpy as np

from handfit_core.capturing.options import LiveOptions
from handfit_core.common.skeleton import KEYPOINT_PARENTS, SIDES, Side
from handfit_core.detect.correction.corrected import with_side_judged
from handfit_core.detect.crops import Crop
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.networks import NETWORK, Networks, Palms
from handfit_core.detect.search import Search, tiles
from handfit_core.detect.tracker import HandTracker, TrackedHand
from handfit_core.fit.fast import fitter_of
from handfit_core.fit.observation import Observation
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.length import flat_hand_length
from handfit_core.media.camera import LiveReader, LiveSource
from handfit_core.media.source import Frame

HandState = Literal["seen", "held", "resting"]


@dataclass(frozen=True)
class LiveSettings:
    """Times in seconds, intervals in frames, of how hands are followed as they move."""

    first_iterations: int = 20
    """Of the fit of a hand that has just come"""
    iterations: int = 2
    """Of the fit of every further frame, from the pose of the one before"""
    shape_frames: int = 16
    """To which a hand's shape is fitted, once they were seen; until then it is an average one. It brings the
    preview 0.2 mm nearer to the truth, and takes 40 ms"""
    shape_interval: int = 4
    """From one of these frames to the next"""
    anew_gain: float = 0.7
    """Part of the cost that a fit from a relaxed hand must have, to be taken instead of one from the last
    pose"""
    search_interval: int = 15
    """From one palm detection in the picture to the next while a hand is wanted and another one is followed:
    it takes longer than a hand"""
    empty_search_interval: int = 3
    """From one palm detection in the picture to the next while no hand is followed"""
    edge: float = 0.02
    """Part of the picture's longer side that a hand must be away from the edges when it begins"""
    kept_inside: float = 0.6
    """Part of its keypoints that must lie in the picture for a hand to go on"""
    side_memory: float = 0.95
    """Of the votes for a hand's side, the part that each frame leaves"""
    hold_seconds: float = 0.5
    """How long a lost hand keeps its pose"""
    ease_seconds: float = 0.6
    """How long it then takes to come to rest"""
    calibration_seconds: float = 1.0
    calibration_frames: int = 10
    """Of an open hand, at least; a slow camera gets more time for them"""
    longest_calibration: float = 3.0
    """seconds"""
    open_bend: float = 0.4
    """radians; mean bend of a finger's joint, thumb left out, up to which a hand is an open one"""
    late: float = 0.04
    """seconds since the frame before, from which on one that comes after a dropped one is late"""
    judged: int = 50
    """Frames over which the part of late ones is averaged"""
    most_late: float = 0.15
    """Part of the frames that may be late before detection hurries, up to the run's end"""
    speed_cutoff: float = 1.0
    """Hz, of the low-pass filter of speeds in the One-Euro filter"""
    wait_seconds: float = 0.1
    """For a frame, before who waits can do something else"""


LIVE: Final = LiveSettings()


@dataclass(frozen=True, eq=False)
class LiveHand:
    """A hand in one frame, in MANO's parameters, as in `HandMotion`; metres, radians, camera frame."""

    side: Side
    state: HandState
    """`held`: lost a moment ago, as it was; `resting`: on its way to rest, or there"""
    score: float
    """Confidence in the hand and its side, 0..1; of the frame in which it was seen last"""
    betas: np.ndarray
    """(10,)"""
    global_orient: np.ndarray
    """(3,)"""
    hand_pose: np.ndarray
    """(45,)"""
    transl: np.ndarray
    """(3,)"""
    keypoints: np.ndarray | None
    """(21, 2) pixels, as the picture shows it; None where it is not seen"""


@dataclass(frozen=True, eq=False)
class LivePose:
    """The hands of one frame."""

    sequence: int
    """The frame's number, counted from 1 over all that came"""
    time: float
    """seconds of `time.perf_counter` when the picture came"""
    hands: tuple[LiveHand, ...]
    rgb: np.ndarray
    """(H, W, 3) uint8, the picture"""
    intrinsics: Intrinsics
    """Of the camera that the hands are seen by, without its distortion"""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What an open hand has told."""

    side: Side
    betas: np.ndarray
    """(10,)"""
    hand_length: float
    """metres from the wrist to the tip of the middle finger"""
    hand_pose: np.ndarray
    """(45,) radians, the mean pose"""


class OneEuro:
    """The gains of One-Euro filters of N values of D numbers each, which share a speed.

    A value's cutoff frequency is min_cutoff + beta |speed|, of its low-passed speed.
    """

    def __init__(self, min_cutoff: float, beta: float) -> None:
        self._min_cutoff, self._beta = min_cutoff, beta
        self._speed: np.ndarray | None = None

    def gain(self, change: np.ndarray, seconds: float) -> np.ndarray:
        """(N, 1) share of the way from the filtered to the new value that a step goes. `change` (N, D): from
        the last value to this one, in `seconds`."""
        speed = change / seconds
        if self._speed is not None:
            speed = self._speed + _gain(LIVE.speed_cutoff, seconds) * (speed - self._speed)
        self._speed = speed
        return _gain(self._min_cutoff + self._beta * np.linalg.norm(speed, axis=1, keepdims=True), seconds)


def _gain(cutoff: Any, seconds: float) -> Any:
    """Of a first-order low-pass filter with that cutoff frequency, Hz, and a sample every `seconds`."""
    return 1.0 / (1.0 + 1.0 / (2.0 * np.pi * cutoff * seconds))


class HandFilter:
    """One-Euro filters of one hand: each joint's rotation, the direction of the wrist, and its distance."""

    def __init__(self, min_cutoff: float, beta: float) -> None:
        self._turning, self._travel = OneEuro(min_cutoff, beta), OneEuro(min_cutoff, beta)
        self._last: tuple[float, np.ndarray, np.ndarray] | None = None
        """Time, rotations and place of the last values"""
        self._turns, self._place = np.empty(0), np.empty(0)

    def step(self, seconds: float, turns: np.ndarray, wrist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Filtered rotations (16, 3, 3) and wrist (3,), metres in the camera frame, of the values at
        `seconds`."""
        depth = max(float(wrist[2]), 1e-3)
        # All about radians: across the view, and the distance relative to itself.
        place = np.array([[wrist[0] / depth, wrist[1] / depth], [np.log(depth), 0.0]])
        if self._last is None:
            self._turns, self._place = turns, place
        else:
            before, last_turns, last_place = self._last
            passed = max(seconds - before, 1e-4)
            gain = self._turning.gain(_way(last_turns, turns), passed)
            self._turns = self._turns @ rotvec_to_rotmat(gain * _way(self._turns, turns))
            self._place = self._place + self._travel.gain(place - last_place, passed) * (place - self._place)
        self._last = seconds, turns, place
        depth = float(np.exp(self._place[1, 0]))
        return self._turns, np.append(self._place[0] * depth, depth)


def _way(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """(N, 3) rotation vectors from rotations (N, 3, 3) to others, in the first ones' axes."""
    return rotmat_to_rotvec(np.swapaxes(first, -1, -2) @ last)


class LiveDetector(HandTracker):
    """The clip's detector for frames that come one by one, of which none is kept. A single hand is seen by
    both landmark networks, or, once it `hurries`, by the faster one, as two hands are."""

    def __init__(self, networks: Networks, threshold: float, most: int) -> None:
        """`most`: hands to follow."""
        super().__init__(networks, threshold, most)
        self._search = Search(networks, threshold, plain=True)
        self._wait = 0
        self.hurries = False

    def find(self, rgb: np.ndarray) -> list[TrackedHand]:
        """The hands in the next picture (H, W, 3) uint8 RGB."""
        self._networks.quality = "draft" if self.hurries or len(self.tracked) > 1 else "standard"
        palms = None
        if not self.full:
            self._wait -= 1
            if self._wait < 0:
                palms = self._palms(rgb)
                self._wait = LIVE.search_interval if self.tracked else LIVE.empty_search_interval
        lost = self.follow(rgb, lambda hand: _inside(hand, rgb) >= LIVE.kept_inside)
        if lost and palms is None:
            palms, self._wait = self._palms(rgb), LIVE.search_interval
        if palms is not None:
            margin = LIVE.edge * max(rgb.shape[:2])
            new = self._search.detect_new(rgb, palms.result(), self.hands)
            self.begin(hand for hand in new if _inside(hand, rgb, margin) >= 1.0)
        for tracked in self.tracked:
            tracked.last = self._networks.with_keypoints_2020(rgb, tracked.last)
        return self.tracked

    def _palms(self, rgb: np.ndarray) -> Future[Palms]:
        """Look for palms in the whole picture, beside whatever else is done."""
        height, width = rgb.shape[:2]
        return self._networks.submit(partial(self._search.detect_palms, rgb, list(tiles(width, height, 1))))


def _inside(hand: Detections, rgb: np.ndarray, margin: float = 0.0) -> float:
    """Share of a hand's keypoints that lie in the picture, `margin` pixels away from its edges."""
    points, size = hand.keypoints_2d[0], np.array(rgb.shape[1::-1])
    return float(((points >= margin) & (points <= size - margin)).all(axis=1).mean())


class _SideFit:
    """The pose of one side's hand, from frame to frame."""

    def __init__(self, side: Side, options: LiveOptions) -> None:
        given = options.capture
        self.side: Side = side
        self._options = options
        self._fitter = fitter_of(load_model(given.model, side), given.hand_length)
        self._betas: np.ndarray | None = None
        """(10,) of the hand that was seen, or calibrated; None: of an average one"""
        self._shape_seen: list[Observation] = []
        """What the shape will be fitted to"""
        self._fits = 0
        self._rest: np.ndarray | None = None
        """(15, 3, 3) pose at rest; None: relaxed, known with the first fit"""
        self._state: State | None = None
        self._filter = HandFilter(options.min_cutoff, options.beta)
        self.last: LiveHand | None = None
        self._lost_at = 0.0
        self.observed: list[Observation] = []
        """Open hands in the frames of the calibration that runs"""
        self._poses: list[np.ndarray] = []

    def see(
        self,
        hands: Detections,
        keypoints: np.ndarray,
        intrinsics: Intrinsics,
        seconds: float,
        *,
        calibrating: bool,
    ) -> None:
        """Fit the hand of one detection; `keypoints` (21, 2) is where the picture shows it."""
        fitter = self._fitter
        seen = fitter.observe(hands, intrinsics)
        start, iterations = fitter.start(seen, self._betas), LIVE.first_iterations
        both = seen
        if self._state is not None:
            start = State.concatenate([self._state, start])
            both, iterations = seen.select(np.zeros(2, dtype=int)), LIVE.iterations
        found = fitter.solve_each(fitter.problem(both), start, iterations)
        anew = len(found) == 2 and not found.cost[0] * LIVE.anew_gain <= found.cost[1]
        state = found.state.select(np.array([int(anew)]))
        if not all(np.isfinite(each).all() for each in (state.root, state.angles, state.wrist)):
            self.lose(seconds)
            return
        self._state = state
        self._see_shape(seen)
        betas, orient, pose, _ = fitter.chain.parameters(state)
        turns = rotvec_to_rotmat(np.concatenate([orient, pose.reshape(15, 3)]))
        # The third of each finger's joints' angles is its bend; the thumb comes first.
        bend = float(np.abs(state.angles[0, 1:, 2::3]).mean())
        if calibrating and bend <= LIVE.open_bend:
            self.observed.append(seen)
            self._poses.append(turns[1:])
        turns, wrist = self._filter.step(seconds, turns, state.wrist[0])
        vectors = rotmat_to_rotvec(turns)
        transl = wrist - fitter.model.shaped(betas[0]).joints[0]
        score, pose = float(hands.score[0]), vectors[1:].reshape(45)
        self.last = LiveHand(self.side, "seen", score, betas[0], vectors[0], pose, transl, keypoints)
        self._lost_at = seconds

    def _see_shape(self, seen: Observation) -> None:
        """Fit the hand's shape once enough frames were seen."""
        # In other frames than those of the other hand, since it takes longer than a frame has.
        turn = SIDES.index(self.side) * LIVE.shape_interval // len(SIDES)
        if self._betas is None and self._fits % LIVE.shape_interval == turn:
            self._shape_seen.append(seen)
            if len(self._shape_seen) == LIVE.shape_frames:
                self._take_shape(self._shape_seen)
        self._fits += 1

    def _take_shape(self, seen: list[Observation]) -> np.ndarray:
        """Betas (10,) of frames; the next one is fitted anew with them."""
        self._betas = self._fitter.solve_shape(Observation.concatenate(seen))
        self._state, self._shape_seen = None, []
        return self._betas

    def lose(self, seconds: float) -> None:
        """Hold the pose of a hand that is not seen in the frame at `seconds`, and ease it to rest."""
        if self.last is None:
            return
        gone = seconds - self._lost_at - LIVE.hold_seconds
        if gone <= 0.0:
            self.last = replace(self.last, state="held", keypoints=None)
            return
        if self.last.state != "resting":
            self._state, self._filter = None, HandFilter(self._options.min_cutoff, self._options.beta)
            self._held = rotvec_to_rotmat(self.last.hand_pose.reshape(15, 3))
        if self._rest is None:
            self._rest = rotvec_to_rotmat(self._fitter.relaxed_pose().reshape(15, 3))
        part = min(gone / LIVE.ease_seconds, 1.0)
        part = part * part * (3.0 - 2.0 * part)
        turned = self._held @ rotvec_to_rotmat(part * _way(self._held, self._rest))
        pose = rotmat_to_rotvec(turned).reshape(45)
        self.last = replace(self.last, state="resting", hand_pose=pose, keypoints=None)

    def calibrated(self) -> Calibration | None:
        """Take over what the frames of a calibration have told; None where they show no open hand."""
        observed, poses, self.observed, self._poses = self.observed, self._poses, [], []
        if len(observed) < LIVE.calibration_frames:
            return None
        # A pose that is held is seen with the same errors in all frames, so that one tells as much as all.
        betas = self._take_shape([observed[len(observed) // 2]])
        self._rest = poses[-1] @ rotvec_to_rotmat(np.mean([_way(poses[-1], each) for each in poses], axis=0))
        pose = rotmat_to_rotvec(self._rest).reshape(45)
        return Calibration(self.side, betas, flat_hand_length(self._fitter.model, betas), pose)


class HandFollower:
    """Follows the hands of frames that come one by one. Use it as a context manager.

    Raises LandmarkModelError, HandModelError.
    """

    def __init__(self, options: LiveOptions) -> None:
        given = options.capture
        self._options = options
        sides: list[Side] = [side for side in SIDES if given.hands in (side, "auto", "both")]
        self._networks = Networks(given.landmark_model)
        self._warm_up()
        self._detector = self._new_detector()
        self._hands = {side: _SideFit(side, options) for side in sides}
        self._before, self._lateness = (0, 0.0), 0.0
        self._size: tuple[int, int] | None = None
        self._intrinsics = Intrinsics.assumed(640, 480)
        self._lens: Lens | None = None
        self._calibrating_since: float | None = None
        self.calibrations: list[tuple[Calibration, ...]] = []
        """Finished calibrations, empty ones of no open hand, that nobody has taken out yet"""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._networks.close()

    def _warm_up(self) -> None:
        """Run all networks once, those of the second hand's thread too: they load with that, for longer than
        a frame has."""
        networks, grey = self._networks, np.full((64, 64, 3), 128, dtype=np.uint8)
        networks.threads = min(networks.threads, len(SIDES))
        crop = Crop.of_square(np.full(2, 32.0), 64.0, NETWORK.hand_input_px)
        networks.quality = "draft"  # which the other thread's keep
        for _ in networks.map(lambda each, _: each.predict(grey, crop), SIDES):
            pass
        networks.quality = "standard"
        networks.predict(grey, crop)

    def _new_detector(self) -> LiveDetector:
        # Two even where one is wanted, so that the other side's hand is not taken for it.
        return LiveDetector(self._networks, self._options.capture.threshold, len(SIDES))

    def calibrate(self) -> None:
        """Take the hands that are seen in the next second for open ones: `calibrations` tells the result."""
        self._calibrating_since = np.inf

    def follow(self, frame: Frame) -> LivePose:
        """The hands in the next frame, whose time rises from frame to frame. Raises OptionError where a
        camera was given that cannot have taken it."""
        rgb, seconds = frame.rgb, frame.time
        assert rgb is not None
        if rgb.shape[1::-1] != self._size:
            self._size = rgb.shape[1], rgb.shape[0]
            given = self._options.capture
            self._intrinsics = given.camera(*self._size) or Intrinsics.assumed(*self._size)
            self._lens = given.measured_lens(*self._size)
            self._detector = self._new_detector()
        number, moment = self._before
        late = frame.number > number + 1 and frame.time > moment + LIVE.late
        self._lateness += (late - self._lateness) / LIVE.judged
        self._before = frame.number, frame.time
        self._detector.hurries |= self._lateness > LIVE.most_late
        if self._calibrating_since == np.inf:
            self._calibrating_since = seconds
        calibrating = self._calibrating_since is not None
        tracks = self._detector.find(rgb)
        rows = with_side_judged(self._detector.hands) if tracks else None
        seen = {} if rows is None else self._sided(tracks, rows)
        for side, hand in self._hands.items():
            if rows is not None and side in seen:
                row = rows.select(np.array([seen[side]]))
                pinhole = row if self._lens is None else row.moved(self._lens.undistorted)
                hand.see(pinhole, row.keypoints_2d[0], self._intrinsics, seconds, calibrating=calibrating)
            else:
                hand.lose(seconds)
        if self._calibrating_since is not None:
            few = any(0 < len(hand.observed) < LIVE.calibration_frames for hand in self._hands.values())
            wanted = LIVE.longest_calibration if few else LIVE.calibration_seconds
            if seconds >= self._calibrating_since + wanted:
                self._calibrating_since = None
                found = (hand.calibrated() for hand in self._hands.values())
                self.calibrations.append(tuple(each for each in found if each is not None))
        hands = tuple(hand.last for hand in self._hands.values() if hand.last is not None)
        return LivePose(frame.number, seconds, hands, rgb, self._intrinsics)

    @staticmethod
    def _sided(tracks: list[TrackedHand], rows: Detections) -> dict[Side, int]:
        """Which row is the hand of each side. Where two are voted to be of one, the less sure is the
        other's."""
        for track, votes in zip(tracks, rows.side_votes, strict=True):
            track.votes = LIVE.side_memory * track.votes + votes
        margins = [float(track.votes[1] - track.votes[0]) for track in tracks]
        if len(tracks) == 1:
            return {SIDES[int(margins[0] > 0.0)]: 0}
        right = int(margins[1] > margins[0])
        return {SIDES[0]: 1 - right, SIDES[1]: right}


class Live:
    """A live run: a source that is read, and the hands in it. Use it as a context manager.

    Raises OptionError for a source or an option that is none,
    LandmarkModelError, HandModelError; `next` raises InputError.
    """

    def __init__(self, source: str, options: LiveOptions | None = None) -> None:
        options = options or LiveOptions()
        parsed = LiveSource.parse(source, online=options.online)
        self.follower = HandFollower(options)
        self.reader = LiveReader(parsed, options.size, options.fps, loop=options.loop)
        """What reads and records the source: its counts, and what is wrong with it"""
        self._done: deque[tuple[float, float]] = deque()
        """When each frame of the last second was done, and how old it was then, seconds"""
        self.shown = 0
        """Frames whose hands were found"""

    def __enter__(self) -> Self:
        self.reader.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.reader.__exit__()
        self.follower.__exit__()

    def next(self, wait: float = LIVE.wait_seconds) -> LivePose | None:
        """The hands of the newest frame; None where none came within `wait` seconds."""
        frame = self.reader.newest(wait)
        if frame is None:
            return None
        pose = self.follower.follow(frame)
        now = time.perf_counter()
        self._done.append((now, now - frame.time))
        while self._done[0][0] < now - 1.0:
            self._done.popleft()
        self.shown += 1
        return pose

    def __iter__(self) -> Iterator[LivePose]:
        while not self.reader.ended:
            pose = self.next()
            if pose is not None:
                yield pose

    @property
    def fps(self) -> float:
        """Frames shown a second."""
        times = [done for done, _ in self._done]
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0

    @property
    def latency(self) -> float:
        """Median seconds from a picture's arrival to its pose; 0 before the first."""
        return float(np.median([age for _, age in self._done])) if self._done else 0.0


def live(source: str, options: LiveOptions | None = None) -> Iterator[LivePose]:
    """Yield the hands of the newest frame of a live source, again and again, until the source ends or the
    generator is closed: `with contextlib.closing(live("0")) as poses`.

    source
        A camera's number or name, an address (http, https or rtsp), or `file:CLIP`, which plays a file.
    options
        See `LiveOptions`.

    Frames that come meanwhile are dropped. Raises what `Live` raises.
    """
    with Live(source, options) as run:
        yield from run


def picture(pose: LivePose, width: int, *, mirror: bool = False) -> np.ndarray:
    """A small picture (h, w, 3) uint8 RGB of a frame with its hands drawn in, at most `width` pixels wide."""
    import cv2

    scale = min(1.0, width / pose.rgb.shape[1])
    small = cv2.resize(pose.rgb, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for hand in pose.hands:
        if hand.keypoints is not None:
            points = np.round(np.clip(hand.keypoints * scale, -9999.0, 9999.0)).astype(int).tolist()
            colour = (255, 160, 60) if hand.side == "left" else (80, 180, 255)
            for point, parent in zip(points[1:], KEYPOINT_PARENTS[1:], strict=True):
                cv2.line(small, points[parent], point, colour, 1, cv2.LINE_AA)
    return np.ascontiguousarray(small[:, ::-1]) if mirror else small
