"""Hands in the frames of a clip: followed from crop to crop, and looked for where one may be missing."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from handfit_core.detect.correction.corrected import with_side_judged
from handfit_core.detect.detector import Detector, DetectorSettings
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.looks import SAME_HAND, View, distance, hand_of_box, same_hand
from handfit_core.detect.networks import PALM_SIZE, Networks, view_of
from handfit_core.detect.search import IN_BOX_PRESENCE, Search, tiles
from handfit_core.skeleton import Side

SEARCH_EVERY = 24
"""Frames from one look for palms in the whole picture to the next, where all hands that were there are
followed"""

LOOK_BACK = 24
"""Past frames through which a hand that turns up is followed backwards, at most"""

MOST_PAST_BYTES = 100_000_000
"""Memory that those frames may take: 4 frames of 3840 x 2160. Where a hand is to be followed back to the
beginning, frames are kept as JPEG, and may take ten times as much"""

MOST_TRIES = 6
"""Searches around a hand that was lost, 1, 2, 4, ... frames apart: one that left costs no more than these"""

BESIDE = 1.0
"""A hand that was lost nearer than this to another, in units of their size, is most likely behind it"""

TRIES_BESIDE, WAIT_BESIDE = 32, 2
"""It is searched for so often, and so many frames apart at most, which costs less than to follow it"""

FIRST_WAIT, LONGEST_WAIT = 8, 128
"""Frames between two searches of parts of the picture in a clip in which no hand is followed"""

AROUND = 4.0
"""Side of what is searched for a lost hand, in units of its size"""

ASTRAY = 0.15
"""A hand found so far from where it was looked for, in units of its size, is at the edge of what was seen"""

CARRIED = 0.1
"""A hand that moves by more than this part of its size from frame to frame is looked for where it is going:
slower ones are where they were, and guesses would only make them tremble"""


@dataclass(eq=False)
class _Followed:
    """A hand that was seen."""

    last: HandDetection
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))
    """(2,) pixels from frame to frame"""
    least: float = 0.0
    """presence that it must have at least"""
    tries: int = 0
    """searches since it was last seen, all in vain"""
    wait: int = 0
    """frames until the next one"""
    beside: bool = False
    """Whether it was lost where another hand is"""

    def seen(self, hand: HandDetection) -> None:
        self.velocity = hand.keypoints_2d.mean(axis=0) - self.last.keypoints_2d.mean(axis=0)
        self.last = hand

    def expected(self) -> np.ndarray:
        """(21, 2) where its landmarks are looked for in the next frame."""
        speed, slow = float(np.linalg.norm(self.velocity)), CARRIED * self.last.extent
        carried = max(0.0, 1.0 - slow / max(speed, 1e-9))
        return self.last.keypoints_2d + carried * self.velocity

    def missed(self) -> None:
        self.velocity = np.zeros(2)
        self.tries += 1
        self.wait = min(2**self.tries - 1, WAIT_BESIDE if self.beside else LONGEST_WAIT)

    @property
    def hopeless(self) -> bool:
        """Whether it is not searched for any more."""
        return self.tries >= (TRIES_BESIDE if self.beside else MOST_TRIES)


class ClipFinder(Detector):
    """Finds the hands of one clip, frame by frame.

    A hand that turns up is followed backwards too, so that `frames` is final only `LOOK_BACK` frames back.
    Raises LandmarkModelError when the model file is missing or damaged.
    """

    def __init__(self, settings: DetectorSettings) -> None:
        self.frames: list[tuple[HandDetection, ...]] = []
        """The hands of every frame so far"""
        self._threshold = settings.threshold
        self._most = settings.max_hands
        self._networks = Networks(settings.landmark_model)
        self._searching = Search(self._networks, settings.threshold, first_word=settings.first_word)
        self._followed: list[_Followed] = []
        self._lost: list[_Followed] = []
        self._whole_past = settings.whole_past
        self._past: deque[tuple[int, np.ndarray]] = deque(maxlen=None if self._whole_past else LOOK_BACK)
        self._searches = 0
        self._search_wait = 0
        self._counts: list[int] = []

    @property
    def most_seen(self) -> int:
        """As `Detector.most_seen`; at least twice, since one picture may show what only looks like a hand."""
        return sorted([0, *self._counts])[-min(2, max(1, len(self._counts)))]

    def close(self) -> None:
        """Give the networks' threads and memory back."""
        self._networks.close()
        self._past.clear()

    def completed(self, found: list[tuple[HandDetection, ...]]) -> list[tuple[HandDetection, ...]]:  # noqa: ARG002
        """The hands of all frames, those that were found afterwards included, with sides judged."""
        judged = iter(with_side_judged([hand for frame in self.frames for hand in frame]))
        return [tuple(next(judged) for _ in frame) for frame in self.frames]

    def look_in(
        self, rgb: np.ndarray, box: Sequence[float], side: Side | None = None
    ) -> HandDetection | None:
        """As `Detector.look_in`."""
        followed = hand_of_box((f.last for f in self._followed), box)
        hand = followed or self._searching.hand_in(rgb, box)
        if hand is None:
            return None
        hand = replace(hand, shown=True, given_side=side)
        index = len(self.frames) - 1
        known = [f for f in self._followed if f.last is followed or same_hand(hand, f.last)]
        self._followed = [f for f in self._followed if f not in known]
        self._follow_new(hand, IN_BOX_PRESENCE)
        self.frames[index] = tuple(followed.last for followed in self._followed)
        if not known:
            self._look_back(self._followed[-1], before=index)
        return hand

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> tuple[HandDetection, ...]:  # noqa: ARG002
        """As `Detector.find`; hands that are found in this frame later are told by `completed`."""
        index = len(self.frames)
        self.frames.append(())
        if rgb is None:
            return ()
        lost = self._follow(rgb)
        new = self._search(rgb, index, bool(lost))
        self._lost += lost
        self.frames[index] = tuple(followed.last for followed in self._followed)
        for followed in new:
            hand = followed.last
            behind = [f for f in self._lost if f.beside]
            if behind:  # the nearest of them is behind another hand no more
                self._lost.remove(min(behind, key=lambda f: distance(f.last, hand)))
            self._look_back(followed, before=index)
        if self._full and not self._whole_past:
            self._past.clear()  # nothing is added to frames in which all that are wanted are seen
        else:
            self._past.append((index, _packed(rgb) if self._whole_past else rgb))
        while sum(past.nbytes for _, past in self._past) > MOST_PAST_BYTES * (10 if self._whole_past else 1):
            self._past.popleft()
        return self.frames[index]

    @property
    def _full(self) -> bool:
        return self._most is not None and len(self._followed) >= self._most

    def _follow(self, rgb: np.ndarray) -> list[_Followed]:
        """Look for the followed hands where they should be; returns those that are not there."""
        lost, self._followed, before = [], [], self._followed
        for followed in before:
            hand = self._there(rgb, followed)
            # Two that cross may lie in one place, but not with all their points.
            if hand is None or any(distance(hand, other.last) < SAME_HAND for other in self._followed):
                lost.append(followed)
            else:
                followed.seen(hand)
                self._followed.append(followed)
        for followed in lost:
            followed.beside = any(distance(followed.last, other.last) < BESIDE for other in self._followed)
        return lost

    def _there(self, rgb: np.ndarray, followed: _Followed) -> HandDetection | None:
        """A followed hand where it should be; looked at once more where it has moved away from there."""
        expected = followed.expected()
        look = self._networks.look(rgb, view_of(expected))
        off = np.linalg.norm(look.hand.keypoints_2d - expected, axis=-1).mean()
        if look.presence >= followed.least and off > ASTRAY * look.hand.extent:
            look = self._networks.look(rgb, view_of(look.hand.keypoints))
        return replace(look.hand, shown=followed.last.shown) if look.presence >= followed.least else None

    def _known(self, hand: HandDetection) -> bool:
        return any(same_hand(hand, followed.last) for followed in self._followed)

    def _search(self, rgb: np.ndarray, index: int, lost_one: bool) -> list[_Followed]:
        """Hands that are not followed, which then are: near where some were lost, and anywhere."""
        new: list[_Followed] = []
        for followed in self._lost:
            if followed.wait > 0:
                followed.wait -= 1
            elif not self._full:
                hand = followed.last
                centre = (hand.keypoints_2d.min(axis=0) + hand.keypoints_2d.max(axis=0)) / 2.0
                view = View.of_square(centre, AROUND * max(hand.extent, 8.0), PALM_SIZE)
                self._take(self._seen_in(rgb, [view]), new)
                followed.missed()
        self._lost = [f for f in self._lost if not (f.hopeless or (self._known(f.last) and not f.beside))]
        if (lost_one and not self._full) or index % SEARCH_EVERY == 0:
            height, width = rgb.shape[:2]
            there = self._seen_in(rgb, list(tiles(width, height, 1)))
            self._counts.append(len(self._followed) + len(there))
            self._take(there, new)
        if not self._followed:
            if self._search_wait > 0:
                self._search_wait -= 1
            else:
                self._take(self._searching.every_hand(rgb), new)
                self._searches += 1
                self._search_wait = min(FIRST_WAIT * 2**self._searches, LONGEST_WAIT)
        return new

    def _seen_in(self, rgb: np.ndarray, views: list[View]) -> list[HandDetection]:
        known = [followed.last for followed in self._followed]
        return self._searching.more_hands(rgb, views, known)

    def _take(self, hands: list[HandDetection], new: list[_Followed]) -> None:
        """Follow hands that are not followed, and add them to the new ones."""
        for hand in hands:
            if not self._full and not self._known(hand):
                new.append(self._follow_new(hand, self._threshold))
                self._searches, self._search_wait = 0, FIRST_WAIT

    def _follow_new(self, hand: HandDetection, least: float) -> _Followed:
        self._followed.append(_Followed(hand, least=least))
        return self._followed[-1]

    def _look_back(self, found: _Followed, before: int) -> None:
        """Follow a hand that turned up through the frames before, back to where it is not seen any more."""
        followed = _Followed(found.last, least=found.least)
        for index, past in reversed(self._past):
            if index >= before:
                continue
            there = self.frames[index]
            hand = self._there(_unpacked(past) if self._whole_past else past, followed)
            if hand is None or any(distance(hand, other) < SAME_HAND for other in there):
                return
            followed.seen(hand)
            self.frames[index] = (*there, hand)


def _packed(rgb: np.ndarray) -> np.ndarray:
    """A picture as JPEG."""
    import cv2

    return cv2.imencode(".jpg", rgb, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]


def _unpacked(jpeg: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.imdecode(jpeg, cv2.IMREAD_UNCHANGED)
