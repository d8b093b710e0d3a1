"""Hands in the frames of a clip: followed from crop to crop, and looked for where one may be missing."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

import numpy as np

from handfit_core.detect.correction.corrected import disagreement
from handfit_core.detect.cuts import Glance
from handfit_core.detect.detector import Detector, DetectorSettings
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.looks import SAME_HAND, View, distance, hand_of_box, mean_of, same_hand
from handfit_core.detect.networks import PALM_SIZE, TURNS, Networks, around, view_of
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

DIFFER = 0.2
"""A hand is looked at once more where the two landmark networks' points are farther apart than this in the
picture, in mean lengths of bones: of clear hands, hardly any differ by more than 0.14"""


@dataclass(eq=False)
class Followed:
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

    @classmethod
    def of(cls, hand: HandDetection, threshold: float, velocity: np.ndarray | None = None) -> Followed:
        """A hand that was found, where so much presence was asked of one."""
        least = IN_BOX_PRESENCE if hand.shown else threshold
        return cls(hand, np.zeros(2) if velocity is None else velocity, least)

    def seen(self, hand: HandDetection) -> None:
        """Take in where it is now."""
        self.velocity = hand.keypoints_2d.mean(axis=0) - self.last.keypoints_2d.mean(axis=0)
        self.last = hand

    def expected(self) -> np.ndarray:
        """(21, 2) where its landmarks are looked for in the next frame."""
        speed, slow = float(np.linalg.norm(self.velocity)), CARRIED * self.last.extent
        carried = max(0.0, 1.0 - slow / max(speed, 1e-9))
        return self.last.keypoints_2d + carried * self.velocity

    def missed(self) -> None:
        """Take in that it was searched in vain."""
        self.velocity = np.zeros(2)
        self.tries += 1
        self.wait = min(2**self.tries - 1, WAIT_BESIDE if self.beside else LONGEST_WAIT)

    @property
    def hopeless(self) -> bool:
        """Whether it is not searched for any more."""
        return self.tries >= (TRIES_BESIDE if self.beside else MOST_TRIES)


class ClipFinder(Detector):
    """Finds the hands of consecutive frames of one clip.

    A hand that turns up is followed backwards too, and the landmark network of December 2020 looks at a frame
    while the next one is looked for: `frames` is final only at the end.
    """

    def __init__(self, settings: DetectorSettings, networks: Networks, *, whole_past: bool = False) -> None:
        """`whole_past`: a hand that turns up is followed back to the first frame, not only for a second."""
        self._frames: list[tuple[HandDetection, ...]] = []
        self._second_looks: list[tuple[int, HandDetection, Future[HandDetection]]] = []
        """The hands of the last frame, with the frame's index, that are being looked at by both networks"""
        self.cuts: list[int] = []
        """Which of them begin another shot"""
        self.counts: list[int] = []
        """How many hands were seen at once, where that was looked for"""
        self.glances: list[Glance] = []
        """At the first and the last of the frames that could be read"""
        self.followed: list[Followed] = []
        """The hands that were seen last"""
        self._threshold = settings.threshold
        self._most = settings.max_hands
        self._networks = networks
        self._searching = Search(self._networks, settings.threshold, first_word=settings.first_word)
        self._lost: list[Followed] = []
        self._whole_past = whole_past
        self._past = Packed() if whole_past else Past()
        self._searches = 0
        self._search_wait = 0

    @property
    def frames(self) -> list[tuple[HandDetection, ...]]:
        """The hands of every frame so far."""
        for index, hand, second in self._second_looks:
            self._frames[index] = tuple(second.result() if h is hand else h for h in self._frames[index])
        self._second_looks = []
        return self._frames

    def look_in(
        self, rgb: np.ndarray, box: Sequence[float], side: Side | None = None
    ) -> HandDetection | None:
        """As `Detector.look_in`."""
        followed = hand_of_box((f.last for f in self.followed), box)
        hand = followed or self._searching.hand_in(rgb, box)
        if hand is None:
            return None
        hand = replace(self._networks.seen_twice(rgb, hand), shown=True, given_side=side)
        index = len(self.frames) - 1
        known = [f for f in self.followed if f.last is followed or same_hand(hand, f.last)]
        self.followed = [f for f in self.followed if f not in known]
        self._follow_new(hand)
        self.frames[index] = tuple(followed.last for followed in self.followed)
        if not known:
            self._look_back(self.followed[-1], index, islice(self._past.backwards(), 1, None))
        return hand

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> tuple[HandDetection, ...]:  # noqa: ARG002
        """As `Detector.find`; hands that are found in it later are told by `frames`."""
        index = len(self._frames)
        self._frames.append(())
        if rgb is None:
            self._past.append(None)
            return ()
        glance = Glance.at(rgb)
        cut = bool(self.glances) and glance.is_cut_from(self.glances[-1])
        self.glances[1:] = [glance]
        if cut:
            self.cuts.append(index)
            self.followed, self._lost, self._search_wait = [], [], 0
            self._past.clear()
        lost = self._follow(rgb)
        new = self._search(rgb, index, bool(lost) or cut)
        self._lost += lost
        self.frames[index] = tuple(followed.last for followed in self.followed)
        self._look_twice(rgb, index)
        for followed in new:
            hand = followed.last
            behind = [f for f in self._lost if f.beside]
            if behind:  # the nearest of them is behind another hand no more
                self._lost.remove(min(behind, key=lambda f: distance(f.last, hand)))
            self._look_back(followed, index, self._past.backwards())
        if self._full and not self._whole_past:
            self._past.clear()  # nothing is added to frames in which all that are wanted are seen
        else:
            self._past.append(rgb)
        return self._frames[index]

    def _look_twice(self, rgb: np.ndarray, index: int) -> None:
        """Begin to look at the hands of a frame with both networks."""
        for followed in self.followed:
            second = self._networks.beside(partial(second_look, self._networks, rgb, replace(followed)))
            self._second_looks.append((index, followed.last, second))

    @property
    def _full(self) -> bool:
        return self._most is not None and len(self.followed) >= self._most

    def _follow(self, rgb: np.ndarray) -> list[Followed]:
        """Look for the followed hands where they should be; returns those that are not there."""
        self.followed, before = [], self.followed
        hands = self._networks.each(lambda networks, followed: there(networks, rgb, followed), before)
        found = [(f, hand) for f, hand in zip(before, hands, strict=True) if hand is not None]
        # Of two that are found in one place, the one that has come farther has taken the other for itself.
        for followed, hand in sorted(found, key=lambda each: distance(each[0].last, each[1])):
            if not meets(hand, [other.last for other in self.followed]):
                followed.seen(hand)
                self.followed.append(followed)
        self.followed = [followed for followed in before if followed in self.followed]
        lost = [followed for followed in before if followed not in self.followed]
        for followed in lost:
            followed.beside = any(distance(followed.last, other.last) < BESIDE for other in self.followed)
        return lost

    def _known(self, hand: HandDetection) -> bool:
        return any(same_hand(hand, followed.last) for followed in self.followed)

    def _search(self, rgb: np.ndarray, index: int, lost_one: bool) -> list[Followed]:
        """Hands that are not followed, which then are: near where some were lost, and anywhere."""
        new: list[Followed] = []
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
            self.counts.append(len(self.followed) + len(there))
            self._take(there, new)
        if not self.followed:
            if self._search_wait > 0:
                self._search_wait -= 1
            else:
                self._take(self._searching.every_hand(rgb), new)
                self._searches += 1
                self._search_wait = min(FIRST_WAIT * 2**self._searches, LONGEST_WAIT)
        return new

    def _seen_in(self, rgb: np.ndarray, views: list[View]) -> list[HandDetection]:
        known = [followed.last for followed in self.followed]
        return self._searching.more_hands(rgb, views, known)

    def _take(self, hands: list[HandDetection], new: list[Followed]) -> None:
        """Follow hands that are not followed, and add them to the new ones."""
        for hand in hands:
            if not self._full and not self._known(hand):
                new.append(self._follow_new(hand))
                self._searches, self._search_wait = 0, FIRST_WAIT

    def _follow_new(self, hand: HandDetection) -> Followed:
        self.followed.append(Followed.of(hand, self._threshold))
        return self.followed[-1]

    def _look_back(self, found: Followed, before: int, past: Iterable[np.ndarray | None]) -> None:
        """Follow a hand that turned up through the frames before, back to where it is not seen any more."""
        followed = Followed.of(found.last, self._threshold)
        for row, rgb in zip(range(before - 1, -1, -1), past, strict=False):
            if rgb is not None and not goes_on(self._networks, followed, rgb, row, self.frames):
                return


def there(networks: Networks, rgb: np.ndarray, followed: Followed) -> HandDetection | None:
    """A followed hand where it should be; looked at once more where it has moved away from there."""
    expected = followed.expected()
    look = networks.look(rgb, view_of(expected))
    off = np.linalg.norm(look.hand.keypoints_2d - expected, axis=-1).mean()
    if look.presence >= followed.least and off > ASTRAY * look.hand.extent:
        look = networks.look(rgb, view_of(look.hand.keypoints))
    if look.presence < followed.least:
        return None
    views = list(around(look.hand.keypoints))[1:] if networks.quality == "best" else []
    return replace(_mean_with(networks, rgb, look.hand, views, followed.least), shown=followed.last.shown)


def second_look(networks: Networks, rgb: np.ndarray, followed: Followed) -> HandDetection:
    """A hand that was just seen, with what the landmark network of December 2020 sees of it; the mirror image
    is looked at as well where the two networks differ and nothing but one look was had."""
    hand = networks.seen_twice(rgb, followed.last)
    if networks.quality != "standard" or hand.keypoints_2020 is None or hand.spread is not None:
        return hand
    apart = disagreement(hand.keypoints[None], hand.keypoints_2020[None])[0]
    mirrored = list(around(hand.keypoints))[len(TURNS)]
    return _mean_with(networks, rgb, hand, [mirrored] if apart > DIFFER else [], followed.least)


def _mean_with(
    networks: Networks, rgb: np.ndarray, hand: HandDetection, views: Sequence[View], least: float
) -> HandDetection:
    """A hand and what more views show of it, where they show so much presence."""
    more = [networks.look(rgb, view) for view in views]
    hands = [hand, *(look.hand for look in more if look.presence >= least)]
    return replace(mean_of(hands), shown=hand.shown) if len(hands) > 1 else hand


def meets(hand: HandDetection, others: Iterable[HandDetection]) -> bool:
    """Whether it lies where another one is: two that cross may lie in one place, but not with all their
    points."""
    return any(distance(hand, other) < SAME_HAND for other in others)


def goes_on(
    networks: Networks,
    followed: Followed,
    rgb: np.ndarray,
    row: int,
    frames: list[tuple[HandDetection, ...]],
) -> bool:
    """Look for a hand in the picture of a frame, and add it to the frame's hands; whether it is there, and is
    none of them."""
    hand = there(networks, rgb, followed)
    if hand is None or meets(hand, frames[row]):
        return False
    followed.seen(hand)
    frames[row] = (*frames[row], second_look(networks, rgb, followed))
    return True


class Past:
    """The frames before one: so many of them, as memory holds."""

    def __init__(self) -> None:
        self._kept: deque[np.ndarray | None] = deque(maxlen=LOOK_BACK)
        self._most_bytes = MOST_PAST_BYTES

    def __len__(self) -> int:
        return len(self._kept)

    def append(self, rgb: np.ndarray | None) -> None:
        """Keep (H, W, 3) uint8 RGB, or None for a frame that could not be read; the first ones go."""
        self._kept.append(rgb)
        while sum(past.nbytes for past in self._kept if past is not None) > self._most_bytes:
            self._kept.popleft()

    def clear(self) -> None:
        """Forget them."""
        self._kept.clear()

    def backwards(self) -> Iterator[np.ndarray | None]:
        """The kept pictures, the last first."""
        return reversed(self._kept)


class Packed(Past):
    """The same as JPEGs: ten times as much memory, and a hundred times as many frames."""

    def __init__(self) -> None:
        super().__init__()
        self._kept = deque()
        self._most_bytes = 10 * MOST_PAST_BYTES

    def append(self, rgb: np.ndarray | None) -> None:
        """As `Past.append`."""
        import cv2

        packed = None if rgb is None else cv2.imencode(".jpg", rgb, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        super().append(packed)

    def backwards(self) -> Iterator[np.ndarray | None]:
        """As `Past.backwards`."""
        import cv2

        for packed in super().backwards():
            yield None if packed is None else cv2.imdecode(packed, cv2.IMREAD_UNCHANGED)
