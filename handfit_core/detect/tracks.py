"""Following hands over a clip: which detection of one frame is which hand of the frame before.

A track's side is decided once, by the summed confidence of all its detections, since single frames
are wrong now and then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise

import numpy as np

from handfit_core.detect.keypoints import DetectedTrack, HandDetection
from handfit_core.detect.looks import distance, overlapped
from handfit_core.errors import NoHandFoundError
from handfit_core.options import HandChoice
from handfit_core.skeleton import SIDES, Side, other_side

DUPLICATE_DISTANCE = 0.25
"""Two detections of one frame nearer than this (mean keypoint distance / hand size) are one hand."""

OVERLAP_DISTANCE = 0.4
"""Two tracks nearer than this in most of the frames that have both are one hand, found twice."""

PART_SIZE, PART_INSIDE = 0.75, 0.75
"""A hand less than this share of another's size, with more than this share of its points within the other's
box, is a part of it: fingers taken for a hand"""

MATCH_DISTANCE = 1.0
"""A hand is seen nearer than its own size to where it was expected, or it is another hand."""

GAP_GROWTH = 0.1
"""What each frame in which a hand was not seen adds to MATCH_DISTANCE, as a share of it, in a short gap"""

SHORT_GAP = 12
"""After so many frames a hand of the other side, where one was lost, may well be another hand."""

LOST_AFTER = 250
"""After so many frames a hand is not waited for; what turns up is joined to it later, if it is of its side"""

MOTION_FRAMES = 3
"""Detections back that a hand's velocity is taken over: two frames alone are mostly jitter."""

FORESIGHT = 6
"""Frames for which a hand is expected to keep its velocity"""

STRAY_WEIGHT = 0.05
"""A track with less than this share of the surest track's confidence is a misdetection, not a hand."""

SURE_SIDE = 0.8
"""A track whose side has less than this share of its detections' confidence may be of the other side"""

SIDE_PENALTY = 0.3
"""Added to the distance when the detector names the other side, so that crossing hands keep theirs."""


@dataclass
class _OpenTrack:
    detections: dict[int, HandDetection] = field(default_factory=dict)
    """in the order of frames"""
    side_votes: dict[Side, float] = field(default_factory=lambda: dict.fromkeys(SIDES, 0.0))

    @property
    def given_side(self) -> Side | None:
        """The side that a person has named."""
        return next((d.given_side for d in self.detections.values() if d.given_side is not None), None)

    @property
    def side(self) -> Side:
        return self.given_side or max(SIDES, key=lambda s: self.side_votes[s])

    @property
    def weight(self) -> float:
        return sum(self.side_votes.values())

    @property
    def shown(self) -> bool:
        """Whether a person has said that it is there."""
        return any(detection.shown for detection in self.detections.values())

    def add(self, frame: int, detection: HandDetection) -> None:
        self.detections[frame] = detection
        for side, vote in detection.side_votes().items():
            self.side_votes[side] += vote

    @property
    def last(self) -> HandDetection:
        return next(reversed(self.detections.values()))

    def displacement(self, frame: int) -> np.ndarray:
        """(2,) pixels by which the hand is expected to have moved in `frame`, after all its detections,
        at its last velocity."""
        seen = list(islice(reversed(self.detections.items()), MOTION_FRAMES))
        (first, before), (last, now) = seen[-1], seen[0]
        # A hand that comes back after long starts anew.
        if not 0 < last - first <= FORESIGHT:
            return np.zeros(2)
        moved = now.keypoints_2d.mean(axis=0) - before.keypoints_2d.mean(axis=0)
        return moved / (last - first) * min(frame - last, FORESIGHT)

    def merge(self, other: _OpenTrack) -> None:
        """Take over another track's detections of frames that this one lacks."""
        self.detections = dict(sorted({**other.detections, **self.detections}.items()))
        for side in SIDES:
            self.side_votes[side] += other.side_votes[side]


def link_tracks(
    frames: Sequence[Sequence[HandDetection]],
    hands: HandChoice = "auto",
    max_hands: int | None = 2,
    fps: float = 25.0,
    holes: tuple[int, ...] = (),
) -> tuple[DetectedTrack, ...]:
    """Link per-frame detections into at most `max_hands` tracks (None: all), the surest first in frame order.

    `hands`: "auto" keeps whatever was seen, also two left hands; "left" and "right" keep hands of
    that side only; "both" means one left and one right, and overrules the detector if it named
    two hands alike. `fps` and `holes` are of the clip (see `DetectedTrack`).

    Raises NoHandFoundError when nothing (of that side) was seen.
    """
    return link_and_count(frames, hands, max_hands, fps, holes)[0]


def link_and_count(
    frames: Sequence[Sequence[HandDetection]],
    hands: HandChoice = "auto",
    max_hands: int | None = 2,
    fps: float = 25.0,
    holes: tuple[int, ...] = (),
    *,
    only_shown: bool = False,
) -> tuple[tuple[DetectedTrack, ...], int]:
    """`link_tracks`, and among how many hands of the whole clip (of that side) it chose. `only_shown`: among
    those that a person has said to be there."""
    tracks = _merge(_link([without_duplicates(frame) for frame in frames]), _overlap)
    tracks = _merge(tracks, _adjoin)
    tracks = _merge(tracks, _may_return)
    if only_shown:
        tracks = [track for track in tracks if track.shown]
        if not tracks:
            raise NoHandFoundError("no hand was found in any region")
    if not tracks:
        raise NoHandFoundError("no hand was found in any frame")
    tracks.sort(key=lambda t: (t.shown, t.weight), reverse=True)
    chosen = _choose(tracks, hands, max_hands)
    if not chosen:
        found = " and ".join(sorted({t.side for t in tracks}))
        raise NoHandFoundError(
            f"no {hands} hand was found, only a {found} one; try hands 'auto' (in a mirrored picture left "
            "is right)"
        )
    most = max(t.weight for t in tracks)
    sure = [t for t in tracks if t.shown or t.weight >= STRAY_WEIGHT * most]
    linked = tuple(
        DetectedTrack(side, tuple(_beside(track, sure, i) for i in range(len(frames))), fps, holes)
        for track, side in chosen
    )
    return linked, max(len(chosen), sum(hands not in SIDES or t.side == hands for t in sure))


def _beside(track: _OpenTrack, tracks: Sequence[_OpenTrack], frame: int) -> HandDetection | None:
    """A track's detection, with its points marked that lie where another hand is."""
    hand = track.detections.get(frame)
    if hand is None:
        return None
    others = [t.detections[frame] for t in tracks if t is not track and frame in t.detections]
    covered = np.any([overlapped(hand, other) for other in others], axis=0)
    if hand.overlapped is not None:
        covered = covered | hand.overlapped
    return replace(hand, overlapped=covered) if np.any(covered) else hand


def _choose(
    tracks: list[_OpenTrack], hands: HandChoice, max_hands: int | None
) -> list[tuple[_OpenTrack, Side]]:
    if hands == "auto":
        most = max(t.weight for t in tracks)
        sure = [t for t in tracks if t.shown or t.weight >= STRAY_WEIGHT * most]
        less = _less_sure(*sure) if len(sure) == 2 else None
        return [(t, other_side(t.side) if t is less else t.side) for t in sure[:max_hands]]
    if hands == "both":
        first = tracks[0]
        for second in tracks[1:]:
            if second.side != first.side:
                return [(first, first.side), (second, second.side)]
        if len(tracks) == 1:
            return [(first, first.side)]
        # All named alike: of the two that were seen most, the one whose side is less sure is the other.
        second = tracks[1]
        if _sureness(first) < _sureness(second):
            return [(first, other_side(first.side)), (second, second.side)]
        return [(first, first.side), (second, other_side(second.side))]
    of_side: list[tuple[_OpenTrack, Side]] = [(t, t.side) for t in tracks if t.side == hands]
    return of_side[:1]


def _less_sure(first: _OpenTrack, second: _OpenTrack) -> _OpenTrack | None:
    """Of two hands that are named alike and touch, most likely the left and the right one of one person,
    the one whose side is in doubt; None where neither is, as where two people shake hands."""
    common = first.detections.keys() & second.detections.keys()
    if first.side != second.side or not any(
        overlapped(first.detections[i], second.detections[i]).any() for i in common
    ):
        return None
    shares = {t.side_votes[t.side] / t.weight: t for t in (first, second) if t.given_side is None}
    share = min(shares, default=1.0)
    return shares[share] if share < SURE_SIDE else None


def _sureness(track: _OpenTrack) -> float:
    """Mean confidence of the detections that agree with the track's side; nothing outweighs a person."""
    if track.given_side is not None:
        return np.inf
    return track.side_votes[track.side] / len(track.detections)


def without_duplicates(detections: Sequence[HandDetection]) -> list[HandDetection]:
    """One detection of each hand in one picture: the surest."""
    hands: list[HandDetection] = []
    for candidate in sorted(detections, key=lambda d: (d.shown, d.score), reverse=True):
        if all(distance(candidate, other) > DUPLICATE_DISTANCE for other in hands):
            hands.append(candidate)
    return hands


def _link(frames: Sequence[Sequence[HandDetection]]) -> list[_OpenTrack]:
    from scipy.optimize import linear_sum_assignment

    every: list[_OpenTrack] = []
    tracks: list[_OpenTrack] = []
    for index, detections in enumerate(frames):
        if not detections:
            continue
        tracks = [t for t in tracks if index - next(reversed(t.detections)) <= LOST_AFTER]
        expected = [(t.last, t.displacement(index), t.side) for t in tracks]
        cost = np.array(
            [
                [distance(last, d, moved) + SIDE_PENALTY * (side != d.likely_side) for d in detections]
                for last, moved, side in expected
            ]
        ).reshape(len(tracks), len(detections))
        limits = [_limit(index - next(reversed(t.detections))) for t in tracks]
        unmatched = set(range(len(detections)))
        # A pair too far apart costs as much as none, or it would push another pair apart.
        for row, column in zip(*linear_sum_assignment(np.minimum(cost, 3 * MATCH_DISTANCE)), strict=True):
            if cost[row, column] < limits[row]:
                tracks[row].add(index, detections[column])
                unmatched.discard(int(column))
        for column in sorted(unmatched):
            track = _OpenTrack()
            track.add(index, detections[column])
            tracks.append(track)
            every.append(track)
    return every


def _limit(gap: int) -> float:
    return MATCH_DISTANCE * (1.0 + GAP_GROWTH * (gap - 1) if gap <= SHORT_GAP else 1.0)


def _merge(tracks: list[_OpenTrack], one_hand: Callable[[_OpenTrack, _OpenTrack], bool]) -> list[_OpenTrack]:
    """Merge tracks into surer ones of the same hand."""
    merged: list[_OpenTrack] = []
    for track in sorted(tracks, key=lambda t: t.weight, reverse=True):
        for surer in merged:
            if one_hand(surer, track):
                surer.merge(track)
                break
        else:
            merged.append(track)
    return merged


def _overlap(a: _OpenTrack, b: _OpenTrack) -> bool:
    """One hand that was found twice, often once as a left and once as a right one."""
    common = a.detections.keys() & b.detections.keys()
    same = sum(
        distance(a.detections[i], b.detections[i]) < OVERLAP_DISTANCE
        or _is_part_of(b.detections[i], a.detections[i])
        for i in common
    )
    return same > len(common) / 2


def _is_part_of(part: HandDetection, hand: HandDetection) -> bool:
    """Fingers that were taken for another, smaller hand."""
    if part.shown:
        return False
    points, whole = part.keypoints_2d, hand.keypoints_2d
    inside = ((points >= whole.min(axis=0)) & (points <= whole.max(axis=0))).all(axis=-1)
    return part.extent < PART_SIZE * hand.extent and float(inside.mean()) > PART_INSIDE


def _adjoin(a: _OpenTrack, b: _OpenTrack) -> bool:
    """One hand that was lost for a moment, and found near there, perhaps as one of the other side."""
    if a.detections.keys() & b.detections.keys():
        return False
    frames = sorted((frame, track is b) for track in (a, b) for frame in track.detections)
    turns = [(j - i, i, j) for (i, mine), (j, other) in pairwise(frames) if mine != other]
    gap, i, j = min(turns)
    before, after = (a, b) if i in a.detections else (b, a)
    return gap <= SHORT_GAP and distance(before.detections[i], after.detections[j]) < _limit(gap)


def _may_return(a: _OpenTrack, b: _OpenTrack) -> bool:
    """A left hand that leaves the picture and a left hand that enters later are one hand."""
    return a.side == b.side and not a.detections.keys() & b.detections.keys()
