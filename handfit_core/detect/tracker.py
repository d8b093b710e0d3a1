"""Following hands and bodies from frame to frame: where they are expected, found again, lost, searched for
and given up.

Clips (`clips.py`), live hands (`capturing/live/streaming.py`) and bodies (`bodies.py`) are followed with it,
each at intervals of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from handfit_core.detect.correction.corrected import disagreement
from handfit_core.detect.crops import Crop
from handfit_core.detect.in_turn import IN_TURN, Difference
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.matching import distance, is_same_hand, mean_detection, overlaps
from handfit_core.detect.networks import NETWORK, Networks, augmented_crops, crop_around
from handfit_core.detect.search import SEARCH


@dataclass(frozen=True)
class TrackerSettings:
    """Thresholds of following hands. Distances are in hand sizes."""

    max_shift: float = 0.15
    """Farthest that a hand may be found from where it was expected; beyond, it lies at the crop's edge, and
    is predicted once more"""
    min_speed: float = 0.1
    """Speed, in hand sizes per frame, beyond which a hand is expected where it is going. Slower ones are
    expected where they were, since a guess would only make them tremble"""
    max_disagreement: float = 0.2
    """Disagreement of the two landmark networks' points in the picture, in mean lengths of bones, beyond
    which the mirrored crop is predicted, too. Of clear hands, hardly any differ by more than 0.14"""


TRACKER: Final = TrackerSettings()


@dataclass(eq=False)
class Tracked:
    """A hand or a body that was found, and what is known of its motion."""

    points: np.ndarray
    """(K, 2) pixels: the points at which it was found last, about which the next crop is laid"""
    min_presence: float
    """Presence, 0..1, below which it counts as lost"""
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))
    """(2,) pixels per frame by which it moved last"""
    misses: int = 0
    """For a hand, the searches that failed since it was lost; for a body, the frames since a hand was at its
    wrists"""
    wait: int = 0
    """Frames until the next search for it"""

    def found(self, points: np.ndarray) -> None:
        """Take in the points (K, 2), pixels, at which it was found in the next frame."""
        self.velocity = points.mean(axis=0) - self.points.mean(axis=0)
        self.points = points

    def expected(self) -> np.ndarray:
        """(K, 2) pixels where its points are expected in the next frame."""
        speed = float(np.linalg.norm(self.velocity))
        slow = TRACKER.min_speed * float(np.ptp(self.points, axis=0).max())
        moving = max(0.0, 1.0 - slow / max(speed, 1e-9))
        return self.points + moving * self.velocity

    def search_is_due(self) -> bool:
        """Count a frame in which it is lost; return True if it is to be searched for in this frame."""
        due = self.wait == 0
        self.wait -= not due
        return due

    def missed(self, most_wait: int) -> None:
        """Count a failed search, and wait longer for the next one, at most `most_wait` frames."""
        self.velocity = np.zeros(2)
        self.misses += 1
        self.wait = min(2**self.misses - 1, most_wait)


@dataclass(eq=False)
class TrackedHand(Tracked):
    """A hand that is followed through the frames of a shot."""

    last: Detections = field(kw_only=True)
    """The detection with which the hand was found last"""
    occluded: bool = False
    """True if it was lost where another hand is"""
    differences: list[Difference] = field(default_factory=list)
    """Differences of the two landmark networks on this hand, one for each frame in which both ran"""
    seen_alone: bool = False
    """True if the landmark network of December 2020 alone has seen `last`"""
    votes: np.ndarray = field(default_factory=lambda: np.zeros(2))
    """(2,) votes of the last frames for each of `SIDES`, where a caller counts them"""

    @classmethod
    def of(cls, hand: Detections, threshold: float) -> TrackedHand:
        """Begin to follow a hand that was found with a threshold of presence, 0..1; a hand that a person has
        shown needs less presence to be kept."""
        min_presence = SEARCH.box_min_presence if hand.shown.all() else threshold
        return cls(hand.keypoints_2d[0], min_presence, last=hand)

    def update(self, hand: Detections) -> None:
        """Take in the hand's detection in the next frame."""
        self.found(hand.keypoints_2d[0])
        self.last = hand


class HandTracker:
    """The hands that are followed in one shot, `most` at a time (None: any number)."""

    def __init__(self, networks: Networks, threshold: float, most: int | None) -> None:
        self.tracked: list[TrackedHand] = []
        """The hands that were followed in the last frame"""
        self._networks, self._threshold, self._most = networks, threshold, most

    @property
    def full(self) -> bool:
        """True if as many hands are followed as are wanted."""
        return self._most is not None and len(self.tracked) >= self._most

    @property
    def hands(self) -> Detections:
        """The detections of the hands that were followed in the last frame."""
        return Detections.of([[tracked.last for tracked in self.tracked]])

    def is_known(self, hand: Detections) -> bool:
        """Return True if a hand is one of those that are followed already."""
        return bool(is_same_hand(hand, self.hands).any())

    def _is_near(self, tracked: TrackedHand, others: Sequence[TrackedHand]) -> bool:
        """Return True if a followed hand touches or crosses one of the others."""
        rest = [other.last for other in others if other is not tracked]
        return bool(rest) and bool((distance(tracked.last, Detections.of([rest])) < IN_TURN.near).any())

    def begin(self, hands: Iterable[Detections]) -> list[TrackedHand]:
        """Begin to follow those of the given hands that are wanted and new; return their tracks."""
        begun = []
        for hand in hands:
            if not self.full and not self.is_known(hand):
                begun.append(TrackedHand.of(hand, self._threshold))
                self.tracked.append(begun[-1])
        return begun

    def follow(
        self,
        rgb: np.ndarray,
        is_usable: Callable[[Detections], bool] = lambda _: True,
        *,
        time: float | None = None,
    ) -> list[TrackedHand]:
        """Find all followed hands in the next frame (H, W, 3) uint8 RGB; return those that are lost, or not
        usable there. With the frame's `time` in seconds, both landmark networks take turns in quality
        `standard`."""
        self.tracked, before = [], self.tracked
        apart = [t for t in before if time is not None and not self._is_near(t, before)]
        hands = self._networks.map(
            lambda networks, t: redetect(networks, rgb, t, time if t in apart else None), before
        )
        found = [(t, hand) for t, hand in zip(before, hands, strict=True) if hand and is_usable(hand)]
        # Of two tracks that end up on one hand, the one that has come farther has taken the other's.
        for tracked, hand in sorted(found, key=lambda each: float(distance(each[0].last, each[1])[0])):
            if not overlaps(hand, self.hands):
                tracked.update(hand)
                self.tracked.append(tracked)
        self.tracked = [tracked for tracked in before if tracked in self.tracked]
        return [tracked for tracked in before if tracked not in self.tracked]


def redetect(
    networks: Networks, rgb: np.ndarray, tracked: TrackedHand, time: float | None = None
) -> Detections | None:
    """Predict a tracked hand where it is expected in the next frame (H, W, 3) uint8 RGB, once more where it
    has moved away from there; return None where it is lost. With a `time` in seconds, the network of December
    2020 may see it alone."""
    expected, tracked.seen_alone = tracked.expected(), False
    in_turn = time is not None and networks.take_turns
    crop = crop_around(expected)
    hand = networks.predict(rgb, crop, by_2020=in_turn)
    if in_turn and _has_moved(hand, expected, tracked):
        in_turn, hand = False, networks.predict(rgb, crop)
    if _has_moved(hand, expected, tracked):
        hand = networks.predict(rgb, crop_around(hand.keypoints[0]))
    if in_turn and time is not None:
        last = tracked.differences[-1] if tracked.differences else None
        if hand.certainty[0] >= IN_TURN.min_presence and last and not last.is_due(hand, time):
            tracked.seen_alone = True
            return replace(last.added_to(hand), shown=tracked.last.shown)
        hand = replace(networks.predict(rgb, crop), keypoints_2020=hand.keypoints_2020)
    if hand.certainty[0] < tracked.min_presence:
        return None
    crops = list(augmented_crops(hand.keypoints[0]))[1:] if networks.quality == "best" else []
    hand = _mean_with_crops(networks, rgb, hand, crops, tracked.min_presence)
    return replace(hand, shown=tracked.last.shown)


def _has_moved(hand: Detections, expected: np.ndarray, tracked: TrackedHand) -> bool:
    """Return True if a tracked hand was found at the edge of its crop, away from the points (21, 2), pixels,
    where it was expected."""
    off = np.linalg.norm(hand.keypoints_2d[0] - expected, axis=-1).mean()
    return bool(hand.certainty[0] >= tracked.min_presence and off > TRACKER.max_shift * hand.extent[0])


def cross_check(networks: Networks, rgb: np.ndarray, hand: Detections, min_presence: float) -> Detections:
    """Add what the landmark network of December 2020 sees of a hand. In quality `standard`, where the
    networks disagree on a hand with a single prediction, the mirrored crop is averaged in."""
    hand = networks.with_keypoints_2020(rgb, hand)
    if networks.quality != "standard" or hand.keypoints_2020 is None or hand.spread is not None:
        return hand
    apart = disagreement(hand.keypoints, hand.keypoints_2020)[0]
    mirrored = list(augmented_crops(hand.keypoints[0]))[len(NETWORK.augmentation_turns)]
    crops = [mirrored] if apart > TRACKER.max_disagreement else []
    return _mean_with_crops(networks, rgb, hand, crops, min_presence)


def _mean_with_crops(
    networks: Networks, rgb: np.ndarray, hand: Detections, crops: Sequence[Crop], min_presence: float
) -> Detections:
    """Average a hand with its predictions in further crops, where these have at least `min_presence`."""
    more = [networks.predict(rgb, crop) for crop in crops]
    hands = [hand, *(other for other in more if other.certainty[0] >= min_presence)]
    return replace(mean_detection(Detections.of([hands])), shown=hand.shown) if len(hands) > 1 else hand


def extend_track(
    networks: Networks,
    tracked: TrackedHand,
    rgb: np.ndarray,
    row: int,
    frames: list[tuple[Detections, ...]],
) -> bool:
    """Follow a hand into the frame `row`, whose picture is `rgb`, and add it to the hands of that frame in
    `frames`. Return False where it is lost, or is a hand that is there already."""
    hand = redetect(networks, rgb, tracked)
    if hand is None or overlaps(hand, Detections.of([frames[row]])):
        return False
    tracked.update(hand)
    frames[row] = (*frames[row], cross_check(networks, rgb, hand, tracked.min_presence))
    return True
