"""Linking detections to tracks: which detection of one frame is which hand of the frame before.

A track's side is decided once, by the summed scores of all its detections, since single frames are wrong now
and then.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from handfit_core.detect.identity import separate_hands
from handfit_core.detect.keypoints import DetectedTrack, HandDetection
from handfit_core.detect.matching import BONE_RADIUS, HandArrays, overlapped
from handfit_core.errors import NoHandFoundError
from handfit_core.options import HandChoice
from handfit_core.skeleton import SIDES, Side, other_side

DUPLICATE_DISTANCE = 0.25
"""Hand sizes (`matching.distance`); two detections of one frame nearer than this are of one hand"""

OVERLAP_DISTANCE = 0.4
"""Hand sizes; two tracks nearer than this in most of the frames that have both are of one hand, found
twice"""

MAX_PART_SIZE, MIN_PART_INSIDE = 0.75, 0.75
"""A hand less than this share of another's size, with more than this share of its points within the other's
box, is a part of it: fingers taken for a hand"""

MAX_MOTION = 1.0
"""Hand sizes; what is farther than this from where a hand was expected is another hand"""

GAP_GROWTH = 0.1
"""What each frame without a detection adds to MAX_MOTION, as a share of it, in a short gap"""

SHORT_GAP = 12
"""Frames; after a longer gap a hand of the other side may well be another hand"""

MAX_GAP = 250
"""Frames for which a track waits for its hand; what turns up later is joined to it if it is of its side"""

VELOCITY_BASE = 3
"""Detections back that a hand's velocity is taken over: two frames alone are mostly jitter"""

VELOCITY_FRAMES = 6
"""Frames for which a hand is expected to keep its velocity"""

MIN_WEIGHT = 0.05
"""Share of the surest track's summed score; a track with less is a false detection"""

SURE_SIDE_SHARE = 0.8
"""A track whose side has less than this share of its summed score may be of the other side"""

SIDE_PENALTY = 0.3
"""Hand sizes added to the distance of a detection that names the other side, so that crossing hands keep
theirs"""


@dataclass
class _OpenTrack:
    detections: dict[int, HandDetection] = field(default_factory=dict)
    """By frame, in the order of frames"""
    side_votes: dict[Side, float] = field(default_factory=lambda: dict.fromkeys(SIDES, 0.0))

    @classmethod
    def of(cls, detections: Mapping[int, HandDetection]) -> _OpenTrack:
        """A track of detections by frame, in the order of frames."""
        track = cls()
        for frame, detection in detections.items():
            track.add(frame, detection)
        return track

    @property
    def given_side(self) -> Side | None:
        """The side that a person has given."""
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
        seen = list(islice(reversed(self.detections.items()), VELOCITY_BASE))
        (first, before), (last, now) = seen[-1], seen[0]
        # A hand that comes back after long starts anew.
        if not 0 < last - first <= VELOCITY_FRAMES:
            return np.zeros(2)
        moved = now.keypoints_2d.mean(axis=0) - before.keypoints_2d.mean(axis=0)
        return moved / (last - first) * min(frame - last, VELOCITY_FRAMES)

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
    merger = _Merger(_link([without_duplicates(frame) for frame in frames]))
    merger.merge(_Merger.overlapping)
    surest = sorted(merger.tracks, key=lambda track: track.weight, reverse=True)
    merger = _Merger([_OpenTrack.of(each) for each in separate_hands([t.detections for t in surest])])
    merger.merge(_Merger.returning)
    tracks = merger.tracks
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
    sure = [t for t in tracks if t.shown or t.weight >= MIN_WEIGHT * most]
    rows = [_with_overlaps([track for track, _ in chosen], sure, i) for i in range(len(frames))]
    linked = tuple(
        DetectedTrack(side, tuple(row[i] for row in rows), fps, holes) for i, (_, side) in enumerate(chosen)
    )
    return linked, max(len(chosen), sum(hands not in SIDES or t.side == hands for t in sure))


def _with_overlaps(
    chosen: Sequence[_OpenTrack], tracks: Sequence[_OpenTrack], frame: int
) -> list[HandDetection | None]:
    """The detections of the chosen tracks in a frame, with `overlapped` set where points lie on another
    hand."""
    present = [track for track in tracks if frame in track.detections]
    places = {id(track): place for place, track in enumerate(present)}
    arrays = HandArrays.of([track.detections[frame] for track in present])
    margin = 1.001 * BONE_RADIUS * arrays.extent[:, None]
    first, end = arrays.box_min - margin, arrays.box_max + margin
    marked: list[HandDetection | None] = []
    for track in chosen:
        hand = track.detections.get(frame)
        if hand is not None:
            box_min, box_max = hand.keypoints_2d.min(axis=0), hand.keypoints_2d.max(axis=0)
            near = ((first <= box_max) & (end >= box_min)).all(axis=1)
            if id(track) in places:
                near[places[id(track)]] = False
            covered = arrays.covers(hand.keypoints_2d, np.flatnonzero(near))
            if hand.overlapped is not None:
                covered = covered | hand.overlapped
            hand = replace(hand, overlapped=covered) if np.any(covered) else hand
        marked.append(hand)
    return marked


def _choose(
    tracks: list[_OpenTrack], hands: HandChoice, max_hands: int | None
) -> list[tuple[_OpenTrack, Side]]:
    if hands == "auto":
        most = max(t.weight for t in tracks)
        sure = [t for t in tracks if t.shown or t.weight >= MIN_WEIGHT * most]
        doubtful = _of_doubtful_side(*sure) if len(sure) == 2 else None
        return [(t, other_side(t.side) if t is doubtful else t.side) for t in sure[:max_hands]]
    if hands == "both":
        first = tracks[0]
        for second in tracks[1:]:
            if second.side != first.side:
                return [(first, first.side), (second, second.side)]
        if len(tracks) == 1:
            return [(first, first.side)]
        # All named alike: of the two that were seen most, the one whose side is less sure is the other.
        second = tracks[1]
        if _side_score(first) < _side_score(second):
            return [(first, other_side(first.side)), (second, second.side)]
        return [(first, first.side), (second, other_side(second.side))]
    of_side: list[tuple[_OpenTrack, Side]] = [(t, t.side) for t in tracks if t.side == hands]
    return of_side[:1]


def _of_doubtful_side(first: _OpenTrack, second: _OpenTrack) -> _OpenTrack | None:
    """The track that is most likely of the other side: of two hands of one side that touch, as a person's
    left and right one do, the one whose side is in doubt. None where neither is, as where two people shake
    hands."""
    common = first.detections.keys() & second.detections.keys()
    if first.side != second.side or not any(
        overlapped(first.detections[i], second.detections[i]).any() for i in common
    ):
        return None
    shares = {t.side_votes[t.side] / t.weight: t for t in (first, second) if t.given_side is None}
    share = min(shares, default=1.0)
    return shares[share] if share < SURE_SIDE_SHARE else None


def _side_score(track: _OpenTrack) -> float:
    """Mean score that a track's detections give to its side; infinite where a person has given it."""
    if track.given_side is not None:
        return np.inf
    return track.side_votes[track.side] / len(track.detections)


def without_duplicates(detections: Sequence[HandDetection]) -> list[HandDetection]:
    """Non-maximum suppression: the best detection of each hand in one picture."""
    ordered = sorted(detections, key=lambda d: (d.shown, d.score), reverse=True)
    arrays, hands = HandArrays.of(ordered), np.zeros(0, dtype=int)
    for number in range(len(ordered)):
        to_hands = arrays.distances(np.full(len(hands), number), arrays, hands, DUPLICATE_DISTANCE)
        if np.all(to_hands > DUPLICATE_DISTANCE):
            hands = np.append(hands, number)
    return [ordered[number] for number in hands]


def _link(frames: Sequence[Sequence[HandDetection]]) -> list[_OpenTrack]:
    from scipy.optimize import linear_sum_assignment

    every: list[_OpenTrack] = []
    tracks: list[_OpenTrack] = []
    for index, detections in enumerate(frames):
        if not detections:
            continue
        tracks = [t for t in tracks if index - next(reversed(t.detections)) <= MAX_GAP]
        cost = _costs(tracks, detections, index)
        limits = [_limit(index - next(reversed(t.detections))) for t in tracks]
        unmatched = set(range(len(detections)))
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if cost[row, column] < limits[row]:
                tracks[row].add(index, detections[column])
                unmatched.discard(int(column))
        for column in sorted(unmatched):
            track = _OpenTrack()
            track.add(index, detections[column])
            tracks.append(track)
            every.append(track)
    return every


def _costs(tracks: Sequence[_OpenTrack], detections: Sequence[HandDetection], frame: int) -> np.ndarray:
    """(tracks, detections) cost in hand sizes of assigning each detection of a frame to each track."""
    last, now = HandArrays.of([track.last for track in tracks]), HandArrays.of(detections)
    moved = np.array([track.displacement(frame) for track in tracks]).reshape(-1, 2)
    sides = np.array([track.side == SIDES[0] for track in tracks], dtype=bool)
    named = np.array([detection.likely_side == SIDES[0] for detection in detections])
    # A pair too far apart costs as much as none, or it would push another pair apart.
    most = 3 * MAX_MOTION
    cost = np.full((len(tracks), len(detections)), most)
    columns = np.arange(len(detections))
    for row in range(len(tracks)):
        far = last.distances(np.full(len(columns), row), now, columns, most, moved[row])
        cost[row] = np.minimum(far + SIDE_PENALTY * (sides[row] != named), most)
    return cost


def _limit(gap: int) -> float:
    return MAX_MOTION * (1.0 + GAP_GROWTH * (gap - 1) if gap <= SHORT_GAP else 1.0)


class _Merger:
    """Merges tracks of one hand. Holds the detections of all tracks as arrays, in the order of frames.

    `rows` of a track are indices into these arrays.
    """

    def __init__(self, tracks: Sequence[_OpenTrack]) -> None:
        self._tracks = tracks
        rows = sorted((frame, number) for number, track in enumerate(tracks) for frame in track.detections)
        detections = [tracks[number].detections[frame] for frame, number in rows]
        self._arrays = HandArrays.of(detections)
        self._shown = np.array([detection.shown for detection in detections], dtype=bool)
        self._frame, self._track_of = np.array(rows, dtype=int).reshape(-1, 2).T.copy()
        """(N,) frame of each detection, and number of its track; -1: it was dropped in a merge"""
        self._sides = np.array([SIDES.index(track.side) for track in tracks], dtype=int)
        self._merged = list(range(len(tracks)))
        self._ranks = np.zeros(len(tracks) + 1, dtype=int)
        """(tracks + 1,) rank of each track among `_merged`, by falling weight; the count of tracks for one
        that is not among them, and in the last place, for dropped detections"""

    @property
    def tracks(self) -> list[_OpenTrack]:
        """The tracks after merging."""
        return [self._tracks[number] for number in self._merged]

    def merge(self, same_hand: Callable[[_Merger, np.ndarray], np.ndarray]) -> None:
        """Merge each track into the surest of the surer tracks whose numbers `same_hand` returns for its
        rows."""
        order = sorted(self._merged, key=lambda number: self._tracks[number].weight, reverse=True)
        self._merged = []
        self._ranks[:] = len(self._tracks)
        for number in order:
            rows = np.flatnonzero(self._track_of == number)
            surer = same_hand(self, rows)
            if not len(surer):
                self._ranks[number] = len(self._merged)
                self._merged.append(number)
                continue
            into = int(surer[np.argmin(self._ranks[surer])])
            taken = np.isin(self._frame[rows], self._frame[self._track_of == into])
            self._track_of[rows] = np.where(taken, -1, into)
            self._tracks[into].merge(self._tracks[number])
            self._sides[into] = SIDES.index(self._tracks[into].side)

    def overlapping(self, rows: np.ndarray) -> np.ndarray:
        """Numbers of the surer tracks that overlap a track in most common frames: one hand that was found
        twice, often once as a left and once as a right one."""
        mine, theirs = self._concurrent(rows)
        same = self._arrays.distances(theirs, self._arrays, mine, OVERLAP_DISTANCE) < OVERLAP_DISTANCE
        # Fingers may have been taken for another, smaller hand.
        smaller = self._arrays.extent[mine] < MAX_PART_SIZE * self._arrays.extent[theirs]
        part = np.flatnonzero(~same & ~self._shown[mine] & smaller)
        same[part] = self._arrays.share_within(mine[part], theirs[part]) > MIN_PART_INSIDE
        tracks, count = self._track_of[theirs], len(self._tracks)
        overlaps, common = (np.bincount(each, minlength=count) for each in (tracks[same], tracks))
        return np.flatnonzero(2 * overlaps > common)

    def returning(self, rows: np.ndarray) -> np.ndarray:
        """Numbers of the surer tracks of the same side without a common frame, as a left hand leaves the
        picture and a left hand enters later."""
        same_side = self._sides == self._sides[self._track_of[rows[0]]]
        return np.flatnonzero(self._disjoint(rows)[:-1] & same_side)

    def _concurrent(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P,) and (P,) pairs of these rows with those of surer tracks in the same frame."""
        first, end = (np.searchsorted(self._frame, self._frame[rows], side) for side in ("left", "right"))
        count = end - first
        theirs = np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
        surer = self._ranks[self._track_of[theirs]] < len(self._tracks)
        return np.repeat(rows, count)[surer], theirs[surer]

    def _disjoint(self, rows: np.ndarray) -> np.ndarray:
        """(tracks + 1,) bool: which surer tracks are in none of the frames of these rows."""
        disjoint = self._ranks < len(self._tracks)
        disjoint[self._track_of[self._concurrent(rows)[1]]] = False
        return disjoint
