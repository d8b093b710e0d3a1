"""Following hands over a clip: which detection of one frame is which hand of the frame before.

A track's side is decided once, by the summed confidence of all its detections, since single frames
are wrong now and then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from handfit_core.errors import NoHandFoundError, OptionError
from handfit_core.keypoints import DetectedTrack, HandDetection
from handfit_core.skeleton import SIDES, Side, other_side

HandChoice = Literal["auto", "left", "right", "both"]
HAND_CHOICES: Final[tuple[HandChoice, ...]] = ("auto", "left", "right", "both")

DUPLICATE_DISTANCE = 0.25
"""Two detections of one frame nearer than this (mean keypoint distance / hand size) are one hand."""

MATCH_DISTANCE = 1.0
"""A hand moves less than its own size between two frames it is seen in, or it is another hand."""

STRAY_WEIGHT = 0.05
"""A track with less than this share of the surest track's confidence is a misdetection, not a hand."""

SIDE_PENALTY = 0.3
"""Added to the distance when the detector names the other side, so that crossing hands keep theirs."""


@dataclass
class _OpenTrack:
    detections: dict[int, HandDetection] = field(default_factory=dict)
    side_votes: dict[Side, float] = field(default_factory=lambda: dict.fromkeys(SIDES, 0.0))

    @property
    def last(self) -> HandDetection:
        return self.detections[max(self.detections)]

    @property
    def side(self) -> Side:
        return max(SIDES, key=lambda s: self.side_votes[s])

    @property
    def weight(self) -> float:
        return sum(self.side_votes.values())

    def add(self, frame: int, detection: HandDetection) -> None:
        self.detections[frame] = detection
        self.side_votes[detection.side] += detection.score

    def merge(self, other: _OpenTrack) -> None:
        self.detections.update(other.detections)
        for side in SIDES:
            self.side_votes[side] += other.side_votes[side]


def link_tracks(
    frames: Sequence[Sequence[HandDetection]], hands: HandChoice = "auto", max_hands: int = 2
) -> tuple[DetectedTrack, ...]:
    """Link per-frame detections into at most `max_hands` tracks, the surest first in frame order.

    `hands`: "auto" keeps whatever was seen, also two left hands; "left" and "right" keep hands of
    that side only; "both" means one left and one right, and overrules the detector if it named
    two hands alike.

    Raises OptionError for another `hands`, NoHandFoundError when nothing (of that side) was seen.
    """
    if hands not in HAND_CHOICES:
        raise OptionError(f"hands must be one of {', '.join(HAND_CHOICES)}; got {hands!r}")
    tracks = _merge_returning(_link([_without_duplicates(frame) for frame in frames]))
    if not tracks:
        raise NoHandFoundError(
            "no hand was found in any frame; try a lower detection threshold (--threshold 0.3), a larger "
            "or brighter picture, or one where the whole hand is in view"
        )
    tracks.sort(key=lambda t: t.weight, reverse=True)
    chosen = _choose(tracks, hands, max_hands)
    if not chosen:
        found = " and ".join(sorted({t.side for t in tracks}))
        raise NoHandFoundError(
            f"no {hands} hand was found, only a {found} one; try hands 'auto' (in a mirrored picture left "
            "is right)"
        )
    return tuple(
        DetectedTrack(side, tuple(track.detections.get(i) for i in range(len(frames))))
        for track, side in chosen
    )


def _choose(tracks: list[_OpenTrack], hands: HandChoice, max_hands: int) -> list[tuple[_OpenTrack, Side]]:
    if hands == "auto":
        surest = tracks[0]
        kept = [t for t in tracks if t.weight >= STRAY_WEIGHT * surest.weight]
        return [(t, t.side) for t in kept[:max_hands]]
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


def _sureness(track: _OpenTrack) -> float:
    """Mean confidence of the detections that agree with the track's side."""
    return track.side_votes[track.side] / len(track.detections)


def _without_duplicates(detections: Sequence[HandDetection]) -> list[HandDetection]:
    kept: list[HandDetection] = []
    for candidate in sorted(detections, key=lambda d: d.score, reverse=True):
        if all(_distance(candidate, other) > DUPLICATE_DISTANCE for other in kept):
            kept.append(candidate)
    return kept


def _distance(a: HandDetection, b: HandDetection) -> float:
    """Mean keypoint distance in units of the hands' size."""
    size = max(a.extent, b.extent, 1e-9)
    return float(np.mean(np.linalg.norm(a.keypoints_2d - b.keypoints_2d, axis=-1))) / size


def _link(frames: Sequence[Sequence[HandDetection]]) -> list[_OpenTrack]:
    from scipy.optimize import linear_sum_assignment

    tracks: list[_OpenTrack] = []
    for index, detections in enumerate(frames):
        if not detections:
            continue
        cost = np.array(
            [[_distance(t.last, d) + SIDE_PENALTY * (t.side != d.side) for d in detections] for t in tracks]
        ).reshape(len(tracks), len(detections))
        unmatched = set(range(len(detections)))
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if cost[row, column] < MATCH_DISTANCE:
                tracks[row].add(index, detections[column])
                unmatched.discard(int(column))
        for column in sorted(unmatched):
            track = _OpenTrack()
            track.add(index, detections[column])
            tracks.append(track)
    return tracks


def _merge_returning(tracks: list[_OpenTrack]) -> list[_OpenTrack]:
    """A left hand that leaves the picture and a left hand that enters later are one hand."""
    merged: list[_OpenTrack] = []
    for track in sorted(tracks, key=lambda t: t.weight, reverse=True):
        for earlier in merged:
            if earlier.side == track.side and not earlier.detections.keys() & track.detections.keys():
                earlier.merge(track)
                break
        else:
            merged.append(track)
    return merged
