"""Hands in the frames of a clip: tracked from crop to crop, and searched where one may be missing."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from typing import Final

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.detect.correction.corrected import disagreement
from handfit_core.detect.crops import Crop
from handfit_core.detect.detector import Detector, DetectorSettings
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.matching import (
    distance,
    hand_of_box,
    is_same_hand,
    mean_detection,
    overlaps,
)
from handfit_core.detect.networks import NETWORK, Networks, augmented_crops, crop_around
from handfit_core.detect.search import SEARCH, Search, tiles
from handfit_core.detect.shot_boundary import Thumbnail


@dataclass(frozen=True)
class TrackingSettings:
    """Thresholds and intervals of tracking in clips. Distances are in hand sizes, intervals in frames."""

    search_interval: int = 24
    """From one palm detection in the whole picture to the next, where all hands that were there are
    tracked"""
    backtrack_frames: int = 24
    """Past frames through which a new hand is tracked backwards, at most"""
    max_past_bytes: int = 100_000_000
    """Memory that those frames may take: 4 frames of 3840 x 2160. Where a hand is to be tracked back to the
    beginning, frames are kept as JPEG, and may take ten times as much"""

    max_searches: int = 6
    """About a lost hand, 1, 2, 4, ... frames apart: one that left costs no more than these"""
    search_span: float = 4.0
    """Side of the crop about a lost hand in which palms are searched"""
    first_wait: int = 8
    """Between the first searches of the whole picture and its tiles in a clip in which no hand is tracked"""
    max_wait: int = 128
    """Between two searches, of these and of those about a lost hand, at most"""
    occluder_distance: float = 1.0
    """A hand that is lost nearer than this to another is most likely behind it"""
    max_occluded_searches: int = 32
    """About a hand that is behind another"""
    max_occluded_wait: int = 2
    """Between two of these searches, at most, which costs less than to track the hand"""

    max_shift: float = 0.15
    """A hand that is found farther than this from where it was expected lies at the crop's edge, and is
    predicted once more"""
    min_speed: float = 0.1
    """Per frame, beyond which a hand is expected where it is going. Slower ones are expected where they were,
    since a guess would only make them tremble"""
    max_disagreement: float = 0.2
    """Mean lengths of bones; where the two landmark networks' points are farther apart than this in the
    picture, the mirrored crop is predicted, too. Of clear hands, hardly any differ by more than 0.14"""


TRACKING: Final = TrackingSettings()


@dataclass(eq=False)
class TrackedHand:
    """A hand that was seen, and what is known of its motion."""

    last: HandDetection
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))
    """(2,) pixels per frame"""
    min_presence: float = 0.0
    """Presence below which it is lost"""
    searches: int = 0
    """Failed ones since it was seen last"""
    wait: int = 0
    """Frames until the next search"""
    occluded: bool = False
    """Whether it was lost where another hand is"""

    @classmethod
    def of(cls, hand: HandDetection, threshold: float, velocity: np.ndarray | None = None) -> TrackedHand:
        """Begin to track a hand that was found with that threshold of presence; one that a person has shown
        needs less of it."""
        min_presence = SEARCH.box_min_presence if hand.shown else threshold
        return cls(hand, np.zeros(2) if velocity is None else velocity, min_presence)

    def update(self, hand: HandDetection) -> None:
        """Take in its detection in the next frame."""
        self.velocity = hand.keypoints_2d.mean(axis=0) - self.last.keypoints_2d.mean(axis=0)
        self.last = hand

    def expected(self) -> np.ndarray:
        """(21, 2) pixels where its landmarks are expected in the next frame."""
        speed, slow = float(np.linalg.norm(self.velocity)), TRACKING.min_speed * self.last.extent
        moving = max(0.0, 1.0 - slow / max(speed, 1e-9))
        return self.last.keypoints_2d + moving * self.velocity

    def search_failed(self) -> None:
        """Count a failed search, and wait longer for the next one."""
        self.velocity = np.zeros(2)
        self.searches += 1
        longest = TRACKING.max_occluded_wait if self.occluded else TRACKING.max_wait
        self.wait = min(2**self.searches - 1, longest)

    @property
    def given_up(self) -> bool:
        """Whether it is not searched for any more."""
        return self.searches >= (TRACKING.max_occluded_searches if self.occluded else TRACKING.max_searches)


class ClipFinder(Detector):
    """Finds the hands of consecutive frames of one clip.

    A new hand is tracked backwards, too, and the landmark network of December 2020 runs on a frame while the
    present one runs on the next: `frames` is final only at the end.
    """

    def __init__(self, settings: DetectorSettings, networks: Networks, *, whole_past: bool = False) -> None:
        """`whole_past`: a new hand is tracked back to the first frame, not only for a second."""
        self._frames: list[tuple[HandDetection, ...]] = []
        self._cross_checks: list[tuple[int, HandDetection, Future[HandDetection]]] = []
        """The hands of the last frame, with the frame's index, on which `cross_check` runs"""
        self.cuts: list[int] = []
        """Indices of frames that begin another shot"""
        self.counts: list[int] = []
        """How many hands were seen at once, where palms were detected in the whole picture"""
        self.misses = 0
        """In how many of these frames another hand is likely"""
        self.thumbnails: list[Thumbnail] = []
        """Of the first and the last frame that could be read"""
        self.tracked: list[TrackedHand] = []
        """The hands of the last frame"""
        self._threshold = settings.threshold
        self._max_hands = settings.max_hands
        self._networks = networks
        self._searching = Search(self._networks, settings.threshold, plain=settings.plain)
        self._lost: list[TrackedHand] = []
        self._whole_past = whole_past
        self._past = PastJpegs() if whole_past else PastFrames()
        self._searches = 0
        self._search_wait = 0

    @property
    def frames(self) -> list[tuple[HandDetection, ...]]:
        """The hands of every frame so far."""
        for index, hand, future in self._cross_checks:
            self._frames[index] = tuple(future.result() if h is hand else h for h in self._frames[index])
        self._cross_checks = []
        return self._frames

    def detect_in_box(
        self,
        rgb: np.ndarray,
        box: Sequence[float],
        side: Side | None = None,
        known: Sequence[HandDetection] = (),
    ) -> HandDetection | None:
        """The hand in a box of the last frame (see `Detector`), which is tracked from there, both ways."""
        index = len(self.frames) - 1
        checked = dict(zip(self.tracked, self.frames[index], strict=True))
        known = [*(t.last for t in self.tracked), *known]
        found = hand_of_box(known, box) or self._searching.detect_in_box(rgb, box, known)
        if found is None:
            return None
        hand = next((h for t, h in checked.items() if t.last is found), found)
        hand = replace(self._networks.with_keypoints_2020(rgb, hand), shown=True, given_side=side)
        replaced = [t for t in self.tracked if t.last is found or overlaps(hand, [t.last])]
        self.tracked = [t for t in self.tracked if t not in replaced]
        self.frames[index] = (*(checked[t] for t in self.tracked), hand)
        self._start_track(hand)
        if not replaced:
            self._track_back(self.tracked[-1], index, islice(self._past.backwards(), 1, None))
        return hand

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> tuple[HandDetection, ...]:  # noqa: ARG002
        """The hands of the next frame (see `Detector`); `frames` may have more of it later."""
        index = len(self._frames)
        self._frames.append(())
        if rgb is None:
            self._past.append(None)
            return ()
        thumbnail = Thumbnail.of(rgb)
        cut = bool(self.thumbnails) and thumbnail.is_cut_from(self.thumbnails[-1])
        self.thumbnails[1:] = [thumbnail]
        if cut:
            self.cuts.append(index)
            self.tracked, self._lost, self._search_wait = [], [], 0
            self._past.clear()
        lost = self._track(rgb)
        new = self._search(rgb, index, bool(lost) or cut)
        self._lost += lost
        self.frames[index] = tuple(tracked.last for tracked in self.tracked)
        self._submit_cross_checks(rgb, index)
        for tracked in new:
            hand = tracked.last
            behind = [t for t in self._lost if t.occluded]
            if behind:  # The nearest of them has come out from behind the other hand.
                self._lost.remove(min(behind, key=lambda t: distance(t.last, hand)))
            self._track_back(tracked, index, self._past.backwards())
        if self._full and not self._whole_past:
            self._past.clear()  # Nothing is added to frames that show all hands that are wanted.
        else:
            self._past.append(rgb)
        return self._frames[index]

    def _submit_cross_checks(self, rgb: np.ndarray, index: int) -> None:
        for tracked in self.tracked:
            future = self._networks.submit(partial(cross_check, self._networks, rgb, replace(tracked)))
            self._cross_checks.append((index, tracked.last, future))

    @property
    def _full(self) -> bool:
        return self._max_hands is not None and len(self.tracked) >= self._max_hands

    def _track(self, rgb: np.ndarray) -> list[TrackedHand]:
        """Track all hands into the next frame; returns those that are lost."""
        self.tracked, before = [], self.tracked
        hands = self._networks.map(lambda networks, tracked: redetect(networks, rgb, tracked), before)
        found = [(t, hand) for t, hand in zip(before, hands, strict=True) if hand is not None]
        # Of two tracks that end up on one hand, the one that has come farther has taken the other's.
        for tracked, hand in sorted(found, key=lambda each: distance(each[0].last, each[1])):
            if not overlaps(hand, [other.last for other in self.tracked]):
                tracked.update(hand)
                self.tracked.append(tracked)
        self.tracked = [tracked for tracked in before if tracked in self.tracked]
        lost = [tracked for tracked in before if tracked not in self.tracked]
        for tracked in lost:
            tracked.occluded = any(
                distance(tracked.last, other.last) < TRACKING.occluder_distance for other in self.tracked
            )
        return lost

    def _is_known(self, hand: HandDetection) -> bool:
        return any(is_same_hand(hand, tracked.last) for tracked in self.tracked)

    def _search(self, rgb: np.ndarray, index: int, lost_one: bool) -> list[TrackedHand]:
        """Search near lost hands and in the whole picture, and begin to track what is new."""
        new: list[TrackedHand] = []
        for lost in self._lost:
            if lost.wait > 0:
                lost.wait -= 1
            elif not self._full:
                hand = lost.last
                centre = (hand.keypoints_2d.min(axis=0) + hand.keypoints_2d.max(axis=0)) / 2.0
                crop = Crop.of_square(
                    centre, TRACKING.search_span * max(hand.extent, 8.0), NETWORK.palm_input_px
                )
                self._start_tracks(self._detect_new(rgb, [crop]), new)
                lost.search_failed()
        self._lost = [
            t for t in self._lost if not (t.given_up or (self._is_known(t.last) and not t.occluded))
        ]
        if (lost_one and not self._full) or index % TRACKING.search_interval == 0:
            height, width = rgb.shape[:2]
            found = self._detect_new(rgb, list(tiles(width, height, 1)))
            self.counts.append(len(self.tracked) + len(found))
            self.misses += self._searching.missed
            self._start_tracks(found, new)
        if not self.tracked:
            if self._search_wait > 0:
                self._search_wait -= 1
            else:
                self._start_tracks(self._searching.detect_all(rgb), new)
                self._searches += 1
                self._search_wait = min(TRACKING.first_wait * 2**self._searches, TRACKING.max_wait)
        return new

    def _detect_new(self, rgb: np.ndarray, crops: list[Crop]) -> list[HandDetection]:
        known = [tracked.last for tracked in self.tracked]
        return self._searching.detect_new(rgb, self._searching.detect_palms(rgb, crops), known)

    def _start_tracks(self, hands: list[HandDetection], new: list[TrackedHand]) -> None:
        """Begin to track those hands that are not tracked yet, and add them to the new ones."""
        for hand in hands:
            if not self._full and not self._is_known(hand):
                new.append(self._start_track(hand))
                self._searches, self._search_wait = 0, TRACKING.first_wait

    def _start_track(self, hand: HandDetection) -> TrackedHand:
        self.tracked.append(TrackedHand.of(hand, self._threshold))
        return self.tracked[-1]

    def _track_back(self, new: TrackedHand, index: int, past: Iterable[np.ndarray | None]) -> None:
        """Track a new hand of that frame through the frames before it, until it is lost."""
        tracked = TrackedHand.of(new.last, self._threshold)
        for row, rgb in zip(range(index - 1, -1, -1), past, strict=False):
            if rgb is not None and not extend_track(self._networks, tracked, rgb, row, self.frames):
                return


def redetect(networks: Networks, rgb: np.ndarray, tracked: TrackedHand) -> HandDetection | None:
    """Predict a tracked hand where it is expected in the next frame, once more where it has moved away from
    there. None where it is lost."""
    expected = tracked.expected()
    prediction = networks.predict(rgb, crop_around(expected))
    off = np.linalg.norm(prediction.hand.keypoints_2d - expected, axis=-1).mean()
    if prediction.presence >= tracked.min_presence and off > TRACKING.max_shift * prediction.hand.extent:
        prediction = networks.predict(rgb, crop_around(prediction.hand.keypoints))
    if prediction.presence < tracked.min_presence:
        return None
    hand = prediction.hand
    crops = list(augmented_crops(hand.keypoints))[1:] if networks.quality == "best" else []
    return replace(
        _mean_with_crops(networks, rgb, hand, crops, tracked.min_presence), shown=tracked.last.shown
    )


def cross_check(networks: Networks, rgb: np.ndarray, tracked: TrackedHand) -> HandDetection:
    """Add what the landmark network of December 2020 sees of a hand. In quality `standard`, where the
    networks disagree on a hand with a single prediction, the mirrored crop is averaged in."""
    hand = networks.with_keypoints_2020(rgb, tracked.last)
    if networks.quality != "standard" or hand.keypoints_2020 is None or hand.spread is not None:
        return hand
    apart = disagreement(hand.keypoints[None], hand.keypoints_2020[None])[0]
    mirrored = list(augmented_crops(hand.keypoints))[len(NETWORK.augmentation_turns)]
    crops = [mirrored] if apart > TRACKING.max_disagreement else []
    return _mean_with_crops(networks, rgb, hand, crops, tracked.min_presence)


def _mean_with_crops(
    networks: Networks, rgb: np.ndarray, hand: HandDetection, crops: Sequence[Crop], min_presence: float
) -> HandDetection:
    """The mean of a hand and its predictions in more crops, where these have enough presence."""
    more = [networks.predict(rgb, crop) for crop in crops]
    hands = [hand, *(prediction.hand for prediction in more if prediction.presence >= min_presence)]
    return replace(mean_detection(hands), shown=hand.shown) if len(hands) > 1 else hand


def extend_track(
    networks: Networks,
    tracked: TrackedHand,
    rgb: np.ndarray,
    row: int,
    frames: list[tuple[HandDetection, ...]],
) -> bool:
    """Track a hand into the frame `row` with that picture, and add it to the frame's hands. False where it is
    lost, or is one of them."""
    hand = redetect(networks, rgb, tracked)
    if hand is None or overlaps(hand, frames[row]):
        return False
    tracked.update(hand)
    frames[row] = (*frames[row], cross_check(networks, rgb, tracked))
    return True


class PastFrames:
    """The last frames of a clip, as many as memory holds."""

    def __init__(self) -> None:
        self._kept: deque[np.ndarray | None] = deque(maxlen=TRACKING.backtrack_frames)
        self._max_bytes = TRACKING.max_past_bytes

    def __len__(self) -> int:
        return len(self._kept)

    def append(self, rgb: np.ndarray | None) -> None:
        """Keep (H, W, 3) uint8 RGB, or None for a frame that could not be read; the first ones go."""
        self._kept.append(rgb)
        while sum(past.nbytes for past in self._kept if past is not None) > self._max_bytes:
            self._kept.popleft()

    def clear(self) -> None:
        """Forget all frames."""
        self._kept.clear()

    def backwards(self) -> Iterator[np.ndarray | None]:
        """The kept pictures, the last first."""
        return reversed(self._kept)


class PastJpegs(PastFrames):
    """The last frames of a clip as JPEGs: ten times as much memory, and a hundred times as many frames."""

    def __init__(self) -> None:
        super().__init__()
        self._kept = deque()
        self._max_bytes = 10 * TRACKING.max_past_bytes

    def append(self, rgb: np.ndarray | None) -> None:
        """Keep (H, W, 3) uint8 RGB, compressed, or None; the first ones go."""
        import cv2

        packed = None if rgb is None else cv2.imencode(".jpg", rgb, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        super().append(packed)

    def backwards(self) -> Iterator[np.ndarray | None]:
        """The kept pictures, decompressed, the last first."""
        import cv2

        for packed in super().backwards():
            yield None if packed is None else cv2.imdecode(packed, cv2.IMREAD_UNCHANGED)
