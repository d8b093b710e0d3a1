"""Hands in the frames of a clip: tracked from crop to crop, and searched where one may be missing."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.detect.crops import Crop
from handfit_core.detect.detector import Detector, DetectorSettings
from handfit_core.detect.in_turn import Difference
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.matching import distance, hand_of_box, overlaps
from handfit_core.detect.networks import NETWORK, Networks
from handfit_core.detect.search import Search, tiles
from handfit_core.detect.shot_boundary import Thumbnail
from handfit_core.detect.tracker import HandTracker, TrackedHand, cross_check, extend_track


@dataclass(frozen=True)
class TrackingSettings:
    """Thresholds and intervals of tracking in clips. Distances are in hand sizes, intervals in frames."""

    search_interval: int = 24
    """Frames from one palm detection in the whole picture to the next, where all hands that were there are
    tracked"""
    backtrack_frames: int = 24
    """Most past frames through which a new hand is tracked backwards"""
    max_past_bytes: int = 100_000_000
    """Bytes that the frames kept for tracking backwards may take, such as 4 of 3840 x 2160. Where a hand is
    to be tracked back to the beginning, frames are kept as JPEG, and may take ten times as much"""

    max_searches: int = 6
    """Most searches about a lost hand, 1, 2, 4, ... frames apart; a hand that left costs no more than
    these"""
    search_span: float = 4.0
    """Side of the square crop about a lost hand in which palms are searched"""
    first_wait: int = 8
    """Frames between the first searches of the whole picture and its tiles, in a clip in which no hand is
    tracked"""
    max_wait: int = 128
    """Most frames between two searches, both of the whole picture and about a lost hand"""
    occluder_distance: float = 1.0
    """Distance to another hand below which a lost hand is most likely hidden behind that one"""
    max_occluded_searches: int = 32
    """Most searches about a lost hand that is hidden behind another"""
    max_occluded_wait: int = 2
    """Most frames between two searches about a hidden hand, which cost less than to track the hand"""


TRACKING: Final = TrackingSettings()


class ClipFinder(HandTracker, Detector):
    """Finds the hands of consecutive frames of one clip.

    A new hand is tracked backwards, too, and what both landmark networks see differently is interpolated
    between the frames in which both ran: `frames` is final only after `finish`.
    """

    def __init__(self, settings: DetectorSettings, networks: Networks, *, whole_past: bool = False) -> None:
        """Begin a clip. With `whole_past`, a new hand is tracked back to the first frame, not only for a
        second."""
        self.frames: list[tuple[Detections, ...]] = []
        """The hands of every frame so far: a tuple of detections for each frame"""
        self._seen_alone: list[tuple[int, Detections, TrackedHand, int]] = []
        """Detections that only the landmark network of December 2020 has made: index of the frame, the hand,
        the track that follows it, and how many of that track's frames both networks had seen"""
        self.cuts: list[int] = []
        """Indices of frames that begin another shot"""
        self.counts: list[int] = []
        """The number of hands that were seen at once, for each frame in which palms were detected in the
        whole picture"""
        self.misses = 0
        """Number of the frames of `counts` in which another hand is likely beside those that were found"""
        self.thumbnails: list[Thumbnail] = []
        """Thumbnails of the first and of the last frame that could be read"""
        HandTracker.__init__(self, networks, settings.threshold, settings.max_hands)
        self._searching = Search(self._networks, settings.threshold, plain=settings.plain)
        self._lost: list[TrackedHand] = []
        self._whole_past = whole_past
        self._past = PastJpegs() if whole_past else PastFrames()
        self._searches = 0
        self._search_wait = 0

    def finish(self) -> None:
        """Make `frames` final: fill in what both landmark networks see differently where only one ran."""
        for index, hand, tracked, count in self._seen_alone:
            difference, *later = tracked.differences[count - 1 : count + 1]
            if later:
                difference = difference.towards(later[0], hand)
            better = replace(difference.added_to(hand), shown=hand.shown)
            self.frames[index] = tuple(better if each is hand else each for each in self.frames[index])
        self._seen_alone = []

    def detect_in_box(
        self,
        rgb: np.ndarray,
        box: Sequence[float],
        side: Side | None = None,
        known: Iterable[Detections] = (),
    ) -> Detections | None:
        """Return the hand in a box of the last frame (see `Detector`), and track it from there, both ways;
        None where there is none."""
        index = len(self.frames) - 1
        checked = dict(zip(self.tracked, self.frames[index], strict=True))
        known = [*(t.last for t in self.tracked), *known]
        found = hand_of_box(known, box) or self._searching.detect_in_box(rgb, box, known)
        if found is None:
            return None
        hand = next((h for t, h in checked.items() if t.last is found), found)
        hand = self._networks.with_keypoints_2020(rgb, hand).shown_by_person(side)
        replaced = [t for t in self.tracked if t.last is found or overlaps(hand, t.last)]
        self.tracked = [t for t in self.tracked if t not in replaced]
        self.frames[index] = (*(checked[t] for t in self.tracked), hand)
        self.tracked.append(TrackedHand.of(hand, self._threshold))
        if not replaced:
            self._track_back(self.tracked[-1], index, islice(self._past.backwards(), 1, None))
        return hand

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> Detections:
        """Return the hands of the next frame (see `Detector`); `frames` may hold more hands of it later."""
        index = len(self.frames)
        self.frames.append(())
        if rgb is None:
            self._past.append(None)
            return Detections.of([[]])
        thumbnail = Thumbnail.of(rgb)
        cut = bool(self.thumbnails) and thumbnail.is_cut_from(self.thumbnails[-1])
        self.thumbnails[1:] = [thumbnail]
        if cut:
            self.cuts.append(index)
            self.tracked, self._lost, self._search_wait = [], [], 0
            self._past.clear()
        lost = self.follow(rgb, time=time)
        for tracked in lost:
            near = distance(tracked.last, self.hands) < TRACKING.occluder_distance
            tracked.occluded = bool(near.any())
        new = self._search(rgb, index, bool(lost) or cut)
        self._lost += lost
        self.frames[index] = tuple(self._checked(rgb, tracked, index, time) for tracked in self.tracked)
        for tracked in new:
            hand = tracked.last
            behind = [t for t in self._lost if t.occluded]
            if behind:  # The nearest of them has come out from behind the other hand.
                self._lost.remove(min(behind, key=lambda t: float(distance(t.last, hand)[0])))
            self._track_back(tracked, index, self._past.backwards())
        if self.full and not self._whole_past:
            self._past.clear()  # Nothing is added to frames that show all hands that are wanted.
        else:
            self._past.append(rgb)
        return Detections.of([self.frames[index]])

    def _checked(self, rgb: np.ndarray, tracked: TrackedHand, index: int, time: float) -> Detections:
        """Return a tracked hand of the frame `index` in the form in which it is stored in `frames`."""
        if tracked.seen_alone:
            self._seen_alone.append((index, tracked.last, tracked, len(tracked.differences)))
            return tracked.last
        hand = cross_check(self._networks, rgb, tracked.last, tracked.min_presence)
        if self._networks.take_turns:
            last = tracked.differences[-1] if tracked.differences else None
            tracked.differences.append(Difference.of(hand, time, last))
        return hand

    def _search(self, rgb: np.ndarray, index: int, lost_one: bool) -> list[TrackedHand]:
        """Search near lost hands and in the whole picture, and begin to track what is new."""
        new: list[TrackedHand] = []
        for lost in self._lost:
            if lost.search_is_due() and not self.full:
                hand = lost.last
                centre = (hand.box_min[0] + hand.box_max[0]) / 2.0
                span = TRACKING.search_span * max(float(hand.extent[0]), 8.0)
                crop = Crop.of_square(centre, span, NETWORK.palm_input_px)
                self._start_tracks(self._detect_new(rgb, [crop]), new)
                lost.missed(TRACKING.max_occluded_wait if lost.occluded else TRACKING.max_wait)
        self._lost = [t for t in self._lost if self._is_missing(t)]
        if (lost_one and not self.full) or index % TRACKING.search_interval == 0:
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

    def _detect_new(self, rgb: np.ndarray, crops: list[Crop]) -> list[Detections]:
        return self._searching.detect_new(rgb, self._searching.detect_palms(rgb, crops), self.hands)

    def _is_missing(self, lost: TrackedHand) -> bool:
        """Return True if a lost hand is still to be searched for."""
        if lost.occluded:
            return lost.misses < TRACKING.max_occluded_searches
        return lost.misses < TRACKING.max_searches and not self.is_known(lost.last)

    def _start_tracks(self, hands: list[Detections], new: list[TrackedHand]) -> None:
        """Begin to track those of `hands` that are not tracked yet, and add them to `new`."""
        begun = self.begin(hands)
        new += begun
        if begun:
            self._searches, self._search_wait = 0, TRACKING.first_wait

    def _track_back(self, new: TrackedHand, index: int, past: Iterable[np.ndarray | None]) -> None:
        """Track a hand that is new in the frame `index` through the `past` pictures, the last first, until it
        is lost."""
        tracked = TrackedHand.of(new.last, self._threshold)
        for row, rgb in zip(range(index - 1, -1, -1), past, strict=False):
            if rgb is not None and not extend_track(self._networks, tracked, rgb, row, self.frames):
                return


class PastFrames:
    """The last frames of a clip, as many as memory holds."""

    def __init__(self) -> None:
        self._kept: deque[np.ndarray | None] = deque(maxlen=TRACKING.backtrack_frames)
        self._max_bytes = TRACKING.max_past_bytes

    def __len__(self) -> int:
        return len(self._kept)

    def append(self, rgb: np.ndarray | None) -> None:
        """Keep a picture (H, W, 3) uint8 RGB, or None for a frame that could not be read; drop the oldest
        where memory is full."""
        self._kept.append(rgb)
        while sum(past.nbytes for past in self._kept if past is not None) > self._max_bytes:
            self._kept.popleft()

    def clear(self) -> None:
        """Forget all frames."""
        self._kept.clear()

    def backwards(self) -> Iterator[np.ndarray | None]:
        """Yield the kept pictures (H, W, 3) uint8 RGB, the last first; None for frames that could not be
        read."""
        return reversed(self._kept)


class PastJpegs(PastFrames):
    """The last frames of a clip as JPEGs, which may take ten times the memory and hold a hundred times as
    many frames."""

    def __init__(self) -> None:
        super().__init__()
        self._kept = deque()
        self._max_bytes = 10 * TRACKING.max_past_bytes

    def append(self, rgb: np.ndarray | None) -> None:
        """Keep a picture (H, W, 3) uint8 RGB compressed, or None for an unreadable frame; drop the oldest
        where memory is full."""
        import cv2

        packed = None if rgb is None else cv2.imencode(".jpg", rgb, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        super().append(packed)

    def backwards(self) -> Iterator[np.ndarray | None]:
        """Yield the kept pictures (H, W, 3) uint8 RGB, decompressed, the last first; None for frames that
        could not be read."""
        import cv2

        for packed in super().backwards():
            yield None if packed is None else cv2.imdecode(packed, cv2.IMREAD_UNCHANGED)
