"""Linking detections to tracks: which detection of one frame is of which hand of the frame before.

A track's side is decided once, by the summed scores of all its detections, since single frames are wrong now
and then. While tracks are made, each is a list of rows, those of its detections among the clip's, in the
order of frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.common.errors import NoHandFoundError
from handfit_core.common.skeleton import SIDES, HandChoice, Side, other_side
from handfit_core.detect.identity import separate_hands
from handfit_core.detect.keypoints import Detections, Track
from handfit_core.detect.matching import MATCHING, covers, distances, share_within


@dataclass(frozen=True)
class LinkingSettings:
    """Thresholds of linking detections to tracks. Distances are in hand sizes, gaps in frames."""

    duplicate_distance: float = 0.25
    """Distance of two detections of one frame below which they are of one hand"""
    overlap_distance: float = 0.4
    """Distance of two tracks, in most of the frames that have both, below which they are of one hand that was
    found twice"""
    max_part_size: float = 0.75
    """Share of another hand's size below which a hand may be a part of that other: fingers taken for a
    hand"""
    min_part_inside: float = 0.75
    """Least share of such a part's points that lie within the larger hand's box"""
    max_motion: float = 1.0
    """Farthest that a hand may be found from where it was expected; what is farther is another hand"""
    gap_growth: float = 0.1
    """How much `max_motion` grows for each frame without a detection, as a share of it, in a short gap"""
    short_gap: int = 12
    """Most frames of a short gap; after a longer one a hand of the other side may well be another hand"""
    max_gap: int = 250
    """Most frames for which a track waits for its hand; what turns up later is joined to it if it is of its
    side"""
    velocity_base: int = 3
    """Number of detections back over which a hand's velocity is taken: two frames alone are mostly jitter"""
    velocity_frames: int = 6
    """Frames for which a hand is expected to keep its velocity"""
    min_weight: float = 0.05
    """Share of the surest track's summed score below which a track is a false detection"""
    sure_side_share: float = 0.8
    """Share of its summed score that a track's side must have; with less the track may be of the other
    side"""
    side_penalty: float = 0.3
    """Distance that is added for a detection that names the other side, so that crossing hands keep their
    sides"""

    def max_distance(self, gap: np.ndarray) -> np.ndarray:
        """Return (N,) the hand sizes that hands may be away from where they were expected, after gaps of so
        many frames (N,)."""
        return self.max_motion * (1.0 + self.gap_growth * (gap - 1) * (gap <= self.short_gap))


LINKING: Final = LinkingSettings()


class _OpenTrack:
    """A track while it is made, of rows of `hands`, the detections of the clip."""

    def __init__(self, hands: Detections, rows: Iterable[int]) -> None:
        self.hands = hands
        self.rows: list[int] = []
        """Rows of the track's detections in `hands`, in the order of frames"""
        self.votes = np.zeros(2)
        """(2,) the summed scores of each side, in the order of `SIDES`"""
        self.given_side: Side | None = None
        """The side that a person has given the track; None: nobody has"""
        for row in rows:
            self.add(row)

    @property
    def frames(self) -> np.ndarray:
        """(n,) frames of the track's detections."""
        return self.hands.frame[self.rows]

    @property
    def side(self) -> Side:
        return self.given_side or SIDES[int(self.votes.argmax())]

    @property
    def weight(self) -> float:
        return float(self.votes.sum())

    @property
    def side_share(self) -> float:
        """Share, 0..1, of the track's side in its summed score."""
        return float(self.votes[SIDES.index(self.side)]) / self.weight

    @property
    def side_score(self) -> float:
        """Mean score that the track's detections give to its side; infinite where a person has given that
        side."""
        if self.given_side is not None:
            return np.inf
        return float(self.votes[SIDES.index(self.side)]) / len(self.rows)

    @property
    def shown(self) -> bool:
        """True if a person has said that the hand is there."""
        return bool(self.hands.shown[self.rows].any())

    def add(self, row: int) -> None:
        """Add the detection in that row, which is of a later frame."""
        self.rows.append(row)
        self.votes += self.hands.side_votes[row]
        given = self.hands.given_side[row]
        self.given_side = self.given_side or (SIDES[given] if given >= 0 else None)

    def merge(self, other: _OpenTrack) -> None:
        """Take over those detections of another track that are in frames which this one lacks."""
        more = np.array(other.rows)[~np.isin(other.frames, self.frames)]
        self.rows = sorted([*self.rows, *more.tolist()])
        self.votes = self.votes + other.votes
        given = self.hands.given_side[self.rows]
        self.given_side = next((SIDES[side] for side in given if side >= 0), None)


def link_tracks(
    detections: Detections,
    frame_count: int,
    hands: HandChoice = "auto",
    max_hands: int | None = 2,
    fps: float = 25.0,
    holes: tuple[int, ...] = (),
) -> tuple[Track, ...]:
    """Link the detections of a clip's `frame_count` frames into at most `max_hands` tracks (None: all), the
    surest first.

    `hands`: "auto" keeps whatever was seen, also two left hands; "left" and "right" keep hands of that side
    only; "both" means one left and one right, and overrules the detector if it named two hands alike. `fps`
    (frames per second) and `holes` are of the clip (see `Track`).

    Raises NoHandFoundError when nothing (of that side) was seen.
    """
    return link_and_count(detections, frame_count, hands, max_hands, fps, holes)[0]


def link_and_count(
    detections: Detections,
    frame_count: int,
    hands: HandChoice = "auto",
    max_hands: int | None = 2,
    fps: float = 25.0,
    holes: tuple[int, ...] = (),
    *,
    cuts: Sequence[int] = (),
    only_shown: bool = False,
) -> tuple[tuple[Track, ...], int]:
    """Return the tracks of `link_tracks`, and the number of hands of the whole clip (of the wanted side)
    among which it chose. With `only_shown`, it chooses among those that a person has said to be there. `cuts`
    are the frames that begin another shot, in which the hand at the same place may well be another one."""
    merger = _Merger(detections, _link(detections, without_duplicates(detections), cuts))
    merger.merge(_Merger.overlapping)
    surest = sorted(merger.tracks, key=lambda track: track.weight, reverse=True)
    separate = separate_hands(detections, [np.array(track.rows) for track in surest], cuts)
    merger = _Merger(detections, [_OpenTrack(detections, rows.tolist()) for rows in separate])
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
    sure = _sure(tracks)
    linked = tuple(
        Track(side, _with_overlaps(detections, track, sure), frame_count, fps, holes)
        for track, side in chosen
    )
    return linked, max(len(chosen), sum(hands not in SIDES or t.side == hands for t in sure))


def _sure(tracks: Sequence[_OpenTrack]) -> list[_OpenTrack]:
    """Return the tracks that are no false detections."""
    most = max(t.weight for t in tracks)
    return [t for t in tracks if t.shown or t.weight >= LINKING.min_weight * most]


def _with_overlaps(hands: Detections, track: _OpenTrack, tracks: Sequence[_OpenTrack]) -> Detections:
    """Return the detections of a track, with `overlapped` set where points lie on a hand of another track."""
    others = np.array(sorted(row for each in tracks if each is not track for row in each.rows), dtype=int)
    margin = 1.001 * MATCHING.bone_radius * hands.extent[:, None]
    low, high = hands.box_min - margin, hands.box_max + margin
    first, end = (np.searchsorted(hands.frame[others], track.frames, side) for side in ("left", "right"))
    found = hands.select(np.array(track.rows))
    covered = np.zeros(found.keypoints.shape[:2], dtype=bool)
    for at in np.flatnonzero(end > first):
        beside = others[first[at] : end[at]]
        near = (low[beside] <= found.box_max[at]) & (high[beside] >= found.box_min[at])
        covered[at] = covers(hands, beside[near.all(axis=1)], found.keypoints_2d[at])
    if not covered.any():
        return found
    return replace(found, overlapped=covered if found.overlapped is None else covered | found.overlapped)


def _choose(
    tracks: list[_OpenTrack], hands: HandChoice, max_hands: int | None
) -> list[tuple[_OpenTrack, Side]]:
    if hands == "auto":
        sure = _sure(tracks)
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
        if first.side_score < second.side_score:
            return [(first, other_side(first.side)), (second, second.side)]
        return [(first, first.side), (second, other_side(second.side))]
    of_side: list[tuple[_OpenTrack, Side]] = [(t, t.side) for t in tracks if t.side == hands]
    return of_side[:1]


def _of_doubtful_side(first: _OpenTrack, second: _OpenTrack) -> _OpenTrack | None:
    """Return the track that is most likely of the other side: of two hands of one side that touch, as a
    person's left and right one do, the one whose side is in doubt. None where neither is in doubt, as where
    two people shake hands."""
    hands = first.hands
    _, mine, theirs = np.intersect1d(first.frames, second.frames, return_indices=True)
    if first.side != second.side or not any(
        covers(hands, np.array([second.rows[j]]), hands.keypoints_2d[first.rows[i]]).any()
        for i, j in zip(mine, theirs, strict=True)
    ):
        return None
    shares = {t.side_share: t for t in (first, second) if t.given_side is None}
    share = min(shares, default=1.0)
    return shares[share] if share < LINKING.sure_side_share else None


def without_duplicates(hands: Detections) -> list[np.ndarray]:
    """Suppress non-maxima: return for each frame with hands the row of each hand's best detection, the best
    first."""
    ordered = np.lexsort([-hands.score, ~hands.shown, hands.frame])
    kept: list[np.ndarray] = []
    for rows in hands.rows_by_frame:
        best = ordered[rows[:1]]
        for row in ordered[rows[1:]]:
            apart = distances(hands, np.full(len(best), row), best, LINKING.duplicate_distance)
            if np.all(apart > LINKING.duplicate_distance):
                best = np.append(best, row)
        kept.append(best)
    return kept


def _link(hands: Detections, frames: Sequence[np.ndarray], cuts: Sequence[int]) -> list[_OpenTrack]:
    """Link the detections in these rows, one array for each frame with hands, into tracks. A track
    goes on after a cut only with a hand of its side."""
    from scipy.optimize import linear_sum_assignment

    every: list[_OpenTrack] = []
    tracks: list[_OpenTrack] = []
    for now in frames:
        frame = hands.frame[now[0]]
        tracks = [t for t in tracks if frame - hands.frame[t.rows[-1]] <= LINKING.max_gap]
        cost = _costs(hands, tracks, now)
        last = hands.frame[_rows_back(tracks, 1)]
        cut = np.searchsorted(cuts, last, "right") < np.searchsorted(cuts, frame, "right")
        if cut.any():
            sides = np.array([SIDES.index(track.side) for track in tracks])
            cost[cut[:, None] & (sides[:, None] != hands.likely_side[now])] = 3 * LINKING.max_motion
        limits = LINKING.max_distance(frame - last)
        unmatched = set(range(len(now)))
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if cost[row, column] < limits[row]:
                tracks[row].add(int(now[column]))
                unmatched.discard(int(column))
        new = [_OpenTrack(hands, [int(now[column])]) for column in sorted(unmatched)]
        tracks += new
        every += new
    return every


def _rows_back(tracks: Sequence[_OpenTrack], count: int) -> np.ndarray:
    """Return (tracks,) the row of the first one of each track's last `count` detections."""
    return np.array([track.rows[-count:][0] for track in tracks], dtype=int)


def _costs(hands: Detections, tracks: Sequence[_OpenTrack], now: np.ndarray) -> np.ndarray:
    """Return (tracks, D) the cost in hand sizes of assigning each of the D detections of a frame, whose rows
    are `now` (D,), to each track."""
    last = _rows_back(tracks, 1)
    moved = _displacements(hands, last, _rows_back(tracks, LINKING.velocity_base), int(hands.frame[now[0]]))
    sides = [SIDES.index(track.side) for track in tracks]
    # A pair too far apart costs as much as none, or it would push another pair apart.
    most = 3 * LINKING.max_motion
    cost = np.full((len(tracks), len(now)), most)
    for row in range(len(tracks)):
        far = distances(hands, np.full(len(now), last[row]), now, most, moved[row])
        cost[row] = np.minimum(far + LINKING.side_penalty * (sides[row] != hands.likely_side[now]), most)
    return cost


def _displacements(hands: Detections, last: np.ndarray, before: np.ndarray, frame: int) -> np.ndarray:
    """Return (N, 2) the pixels by which N hands are expected to have moved by `frame`, which is after all
    their detections, at the velocities between their detections `before` (N,) and `last` (N,)."""
    span = hands.frame[last] - hands.frame[before]
    velocity = (hands.centroid[last] - hands.centroid[before]) / np.maximum(span, 1)[:, None]
    frames = np.minimum(frame - hands.frame[last], LINKING.velocity_frames)
    # A hand that comes back after long starts anew.
    lasting = (span > 0) & (span <= LINKING.velocity_frames)
    return np.where(lasting[:, None], velocity * frames[:, None], 0.0)


class _Merger:
    """Merges tracks of one hand; rows are those of the clip's detections."""

    def __init__(self, hands: Detections, tracks: Sequence[_OpenTrack]) -> None:
        self._hands, self._tracks = hands, tracks
        self._track_of = np.full(len(hands), -1)
        """(N,) the number of each detection's track; -1 for a duplicate, or one that was dropped in a
        merge"""
        for number, track in enumerate(tracks):
            self._track_of[track.rows] = number
        self._sides = np.array([SIDES.index(track.side) for track in tracks], dtype=int)
        self._merged = list(range(len(tracks)))
        self._ranks = np.zeros(len(tracks) + 1, dtype=int)
        """(tracks + 1,) the rank of each track among `_merged`, by falling weight; for a track that is not
        among them, and in the last place, for dropped detections, the count of tracks"""

    @property
    def tracks(self) -> list[_OpenTrack]:
        """The tracks that are left after merging."""
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
            frames = self._hands.frame
            taken = np.isin(frames[rows], frames[self._track_of == into])
            self._track_of[rows] = np.where(taken, -1, into)
            self._tracks[into].merge(self._tracks[number])
            self._sides[into] = SIDES.index(self._tracks[into].side)

    def overlapping(self, rows: np.ndarray) -> np.ndarray:
        """Return the numbers of the surer tracks that overlap a track in most common frames: one hand that
        was found twice, often once as a left and once as a right one."""
        mine, theirs = self._concurrent(rows)
        hands, limit = self._hands, LINKING.overlap_distance
        apart = distances(hands, theirs, mine, limit)
        # A hand that a person has shown may be tangled with the other.
        same = apart < np.where(hands.shown[mine], LINKING.duplicate_distance, limit)
        # Fingers may have been taken for another, smaller hand.
        smaller = hands.extent[mine] < LINKING.max_part_size * hands.extent[theirs]
        part = np.flatnonzero(~same & ~hands.shown[mine] & smaller)
        same[part] = share_within(hands, mine[part], theirs[part]) > LINKING.min_part_inside
        tracks, count = self._track_of[theirs], len(self._tracks)
        overlaps, common = (np.bincount(each, minlength=count) for each in (tracks[same], tracks))
        return np.flatnonzero(2 * overlaps > common)

    def returning(self, rows: np.ndarray) -> np.ndarray:
        """Return the numbers of the surer tracks of the same side without a common frame, as when a left hand
        leaves the picture and a left hand enters later."""
        same_side = self._sides == self._sides[self._track_of[rows[0]]]
        return np.flatnonzero(self._disjoint(rows)[:-1] & same_side)

    def _concurrent(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the P pairs of a detection in `rows` and a surer track's detection in its frame: (P,) rows
        of the ones and (P,) rows of the others."""
        frames = self._hands.frame
        first, end = (np.searchsorted(frames, frames[rows], side) for side in ("left", "right"))
        count = end - first
        theirs = np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
        surer = self._ranks[self._track_of[theirs]] < len(self._tracks)
        return np.repeat(rows, count)[surer], theirs[surer]

    def _disjoint(self, rows: np.ndarray) -> np.ndarray:
        """Return (tracks + 1,) bool: True for the surer tracks that are in none of the frames of these
        rows."""
        disjoint = self._ranks < len(self._tracks)
        disjoint[self._track_of[self._concurrent(rows)[1]]] = False
        return disjoint
