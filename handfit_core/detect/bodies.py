"""The bodies that hands belong to: a pass over a clip's frames after its hands are known.

As hands are, bodies are found chunk by chunk of frames, each from its own frames alone, so that the number of
threads changes no result. Whose body is whose is decided once, over all chunks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from handfit_core.common.skeleton import SIDES
from handfit_core.detect.body import (
    ELBOWS,
    NUM_BODY_POINTS,
    SHOULDERS,
    WRISTS,
    Body,
    BodyNetworks,
    BodyTrack,
)
from handfit_core.detect.detector import InChunks
from handfit_core.detect.sharing import detect_chunks
from handfit_core.detect.shot_boundary import Thumbnail
from handfit_core.detect.tracker import Tracked
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.media.read_ahead import read_ahead
from handfit_core.media.source import Media


@dataclass(frozen=True)
class FollowingSettings:
    """Thresholds and intervals of following bodies. Intervals are in frames."""

    min_score: float = 0.5
    """Score from which the detector's find counts as a person, 0..1; for people whose body is then predicted
    anew"""
    min_any_score: float = 0.05
    """Score, 0..1, from which the detector's find counts at all: a person who is followed already with less
    than this gets a score of 0"""
    min_presence: float = 0.5
    """Presence by the landmark network, 0..1, below which a followed body is lost"""
    detection_interval: int = 48
    """Frames from one run of the people's detector to the next, where all hands have bodies"""
    first_wait: int = 8
    max_wait: int = 32
    """Most frames between two runs of the people's detector for a hand without a body; the wait begins with
    `first_wait` and doubles each time"""
    step: int = 2
    """Every step-th frame is looked at, and bodies are interpolated between: fitted arms are as exact, and
    tremble no more"""
    resting_step: int = 8
    """Frames from one that is looked at to the next, in place of `step`, once no arm was seen in the last
    `max_unseen` frames that were looked at, as where only a forearm is in the picture"""
    max_unseen: int = 6
    min_visibility: float = 0.5
    """Visibility, 0..1, that the shoulder, elbow and wrist of an arm must have for the arm to count as
    seen"""
    max_wrist_distance: float = 1.0
    """Farthest distance, in sizes of a hand, of a hand from the wrist of the body that it belongs to"""
    max_misses: int = 6
    """Number of predictions in a row in which no hand is at a body's wrists, after which it is followed no
    more"""
    most_looked_at: int = 6
    """Most people of one picture whose bodies are predicted to find the body of a hand"""
    max_reach: float = 2.0
    """Farthest that a hand may lie from the hips of its person, in distances of the two points of
    `People.axis`, as far as from a man's hips to above his head"""
    same_person_distance: float = 0.5
    """Distance between the hips of two finds below which they are one person, in distances of the two points
    of `People.axis`"""


FOLLOWING: Final = FollowingSettings()


def find_bodies(
    media: Media,
    numbers: Sequence[int],
    hands: Sequence[np.ndarray],
    camera: Intrinsics | Lens,
    processes: int | None = None,
    on_frame: Callable[[int], None] = lambda _: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> tuple[BodyTrack, ...]:
    """Return the people whom a clip's hands belong to, one track each over T frames.

    `numbers` are the source's numbers of these frames. `hands` has the keypoints (T, 21, 2) of each hand, in
    pixels, NaN in frames without it: frames without any hand are not looked at. A person is followed whose
    wrist, of either side, is nearest a hand's; two hands share one person where they do so in most frames. A
    lens' distortion is taken out of the bodies, as it has been of the hands. `processes` is the number of
    threads, None for as many as there are cores; it changes no result.

    `on_frame` is called with the count of frames that are done, `should_stop` asked before each; frames after
    that have no body. Raises LandmarkModelError where the body networks are missing or damaged.
    """
    if not len(hands):
        return ()
    seen = np.stack(hands)
    clip = _HandsInClip(list(numbers), seen[:, :, 0], np.ptp(seen, axis=2).max(axis=-1), camera)
    if not clip.wanted.any():
        return ()
    with _BodyDetector(media, clip) as detector:
        chunks = detect_chunks(
            detector, lambda again: _BodyDetector(again, clip), processes, on_frame, should_stop
        )
    return _joined(clip, chunks)


@dataclass(frozen=True, eq=False)
class _HandsInClip:
    """H hands in T frames, and the camera."""

    numbers: list[int]
    """The T frame numbers by which the source counts these frames"""
    wrists: np.ndarray
    """(H, T, 2) pixels, NaN where there is no hand"""
    extents: np.ndarray
    """(H, T) sizes of the hands in the picture, pixels"""
    camera: Intrinsics | Lens

    @property
    def wanted(self) -> np.ndarray:
        """(T,) bool: True for the frames that show a hand."""
        return np.asarray(np.isfinite(self.extents).any(axis=0))


@dataclass(eq=False)
class _Followed(Tracked):
    """A person over some of a chunk's frames, with the (2, 2) pixels of `People.axis` as `points`."""

    near: dict[int, np.ndarray] = field(default_factory=dict)
    """By the clip's row: (H,) how near each hand was to one of the person's wrists, from 1 at the wrist down
    to 0 from `max_wrist_distance` on"""
    bodies: dict[int, Body] = field(default_factory=dict)
    """By the clip's row: the person's body as the landmark network saw it"""
    scores: dict[int, float] = field(default_factory=dict)
    """By the clip's row: the score that the people's detector gave the person, 0..1"""


@dataclass(frozen=True, eq=False)
class _Part:
    """The people who were followed through one chunk's frames, and the chunk's cuts."""

    numbers: list[int]
    people: list[_Followed]
    cuts: list[int]
    """Rows of the clip that begin another shot, or may begin one"""


class _BodyDetector(InChunks[_Part]):
    """Finds the bodies of a clip's hands. Use it as a context manager."""

    def __init__(self, media: Media, clip: _HandsInClip) -> None:
        self.media = media
        self._clip = clip
        self._rows = {number: row for row, number in enumerate(clip.numbers)}
        self._networks = BodyNetworks()

    def close(self) -> None:
        self._networks.close()
        self.media.close()

    def chunk(self, index: int, on_frame: Callable[[int], None], should_stop: Callable[[], bool]) -> _Part:
        """Find the bodies in the chunk with that index; its frames before the first and after the last hand
        are not read."""
        start, step = index * self.media.chunk_frames, FOLLOWING.step
        numbers = list(self.media.numbers(start, self.media.chunk_frames))
        rows = [self._rows.get(number, -1) for number in numbers]
        wanted = [i for i in range(0, len(rows), step) if rows[i] >= 0 and self._clip.wanted[rows[i]]]
        following = _Following(self._networks, self._clip)
        if not wanted:
            past = not numbers or numbers[0] > self._clip.numbers[-1]
            return _Part([] if past else numbers, [], [])
        at, end = wanted[0], wanted[-1] + 1
        with closing(read_ahead(self.media.frames(start + at, end - at, step))) as frames:
            for frame in frames:
                if should_stop():
                    break
                if frame.rgb is not None and rows[at] >= 0:
                    following.find(frame.rgb, rows[at])
                for _ in range(step):
                    at += 1
                    on_frame(at)
        return _Part(numbers if at >= end else numbers[:at], following.people, following.cuts)


class _Following:
    """Follows bodies through the frames of a chunk."""

    def __init__(self, networks: BodyNetworks, clip: _HandsInClip) -> None:
        self.people: list[_Followed] = []
        """All people who were followed in the chunk so far"""
        self.cuts: list[int] = []
        """Rows of the clip that begin another shot, or may begin one"""
        self._networks, self._clip = networks, clip
        self._now: list[_Followed] = []
        self._thumbnail: Thumbnail | None = None
        self._row = -1
        """Row of the clip's frame that the last thumbnail shows; -1 before the first"""
        self._unseen, self._next = 0, 0
        """How many frames in a row were looked at without an arm being seen, and the next row to look at"""
        self._next_detection = 0
        """Row of the next run of the people's detector, where all hands have bodies"""
        self._wait, self._next_search = FOLLOWING.first_wait, 0
        """Frames to wait after a failed search for a hand's body, and the row of the next search"""

    def find(self, rgb: np.ndarray, row: int) -> None:
        """Find the bodies of one row's hands in its picture (H, W, 3) uint8 RGB."""
        thumbnail = Thumbnail.of(rgb)
        if self._thumbnail is not None and thumbnail.is_cut_from(self._thumbnail):
            self.cuts += range(self._row + 1, row + 1)
            self._now, self._unseen = [], 0
            self._next = self._next_detection = self._next_search = row
        self._thumbnail, self._row = thumbnail, row
        there = np.isfinite(self._clip.extents[:, row])
        if not there.any() or row < self._next:
            return
        for person in self._now:
            self._predict(person, rgb, row)
        free = there.copy()
        for person in self._now:
            person.misses += 1
            if row in person.bodies and (near := self._nearness(person.bodies[row], row)).any():
                person.near[row], person.misses = near, 0
                free &= near == 0.0
        self._now = [p for p in self._now if row in p.bodies and p.misses <= FOLLOWING.max_misses]
        if row >= self._next_detection or (free.any() and row >= self._next_search):
            self._detect(rgb, row, free)
        seen = any(_sees_arm(person.bodies[row]) for person in self._now)
        self._unseen = 0 if seen else self._unseen + 1
        if self._unseen >= FOLLOWING.max_unseen:
            self._next = row + FOLLOWING.resting_step

    def _detect(self, rgb: np.ndarray, row: int, free: np.ndarray) -> None:
        """Run the people's detector, and begin to follow those people to whom a hand without a body belongs;
        (H,) bool `free` names these hands."""
        found = self._networks.detect(rgb, FOLLOWING.min_any_score)
        radii = np.linalg.norm(found.axis[:, 1] - found.axis[:, 0], axis=-1)
        known = np.zeros(len(found.score), dtype=bool)
        for person in self._now:
            apart = np.linalg.norm(found.axis[:, 0] - person.points[0], axis=-1)
            same = apart < FOLLOWING.same_person_distance * radii
            person.scores[row] = float(found.score[same].max(initial=0.0))
            known |= same
        wrists = self._clip.wrists[free, row]
        off = np.linalg.norm(found.axis[:, :1] - wrists[None], axis=-1)
        reached = (off < FOLLOWING.max_reach * radii[:, None]).any(axis=1)
        candidates = np.flatnonzero(~known & reached & (found.score >= FOLLOWING.min_score))
        for i in candidates[: FOLLOWING.most_looked_at]:
            scores = {row: float(found.score[i])}
            person = _Followed(found.axis[i], FOLLOWING.min_presence, scores=scores)
            # The second crop is one about landmarks, as all further ones are.
            for _ in range(2):
                self._predict(person, rgb, row)
            if row in person.bodies and (near := self._nearness(person.bodies[row], row))[free].any():
                person.near[row] = near
                free = free & (near == 0.0)
                self._now.append(person)
                self.people.append(person)
        self._next_detection = row + FOLLOWING.detection_interval
        self._next_search = row + self._wait
        self._wait = min(2 * self._wait, FOLLOWING.max_wait) if free.any() else FOLLOWING.first_wait

    def _predict(self, person: _Followed, rgb: np.ndarray, row: int) -> None:
        """Predict a followed person's body in one row's picture, and keep it where it is found."""
        body = self._networks.predict(rgb, person.points, self._clip.camera)
        person.bodies.pop(row, None)
        if body.presence >= person.min_presence:
            person.bodies[row] = body
            person.found(body.axis)

    def _nearness(self, body: Body, row: int) -> np.ndarray:
        """Return (H,) how near each hand of one row is to one of the body's wrists: 1 at the wrist, 0 at the
        limit and beyond it. Each wrist has at most one hand."""
        wrists, hands = body.keypoints[list(WRISTS.values())], self._clip.wrists[:, row]
        off = np.linalg.norm(hands[:, None] - wrists[None], axis=-1) / self._clip.extents[:, row, None]
        near = np.clip(1.0 - np.nan_to_num(off, nan=np.inf) / FOLLOWING.max_wrist_distance, 0.0, 1.0)
        best = np.zeros(len(near))
        while near.any():
            hand, wrist = np.unravel_index(near.argmax(), near.shape)
            best[hand] = near[hand, wrist]
            near[hand], near[:, wrist] = 0.0, 0.0
        return best


def _sees_arm(body: Body) -> bool:
    """True if a shoulder, elbow and wrist of one side are visible."""
    arms = [[of[side] for of in (SHOULDERS, ELBOWS, WRISTS)] for side in SIDES]
    return bool((body.visibility[arms].min(axis=1) > FOLLOWING.min_visibility).any())


def _joined(clip: _HandsInClip, parts: Sequence[_Part]) -> tuple[BodyTrack, ...]:
    """Join the people of all chunks to one track each, by the hands that they have."""
    people = [person for part in parts for person in part.people]
    body_of = np.full(clip.extents.shape, -1)
    nearest = np.zeros(clip.extents.shape)
    for number, person in enumerate(people):
        for row, near in person.near.items():
            nearer = near > nearest[:, row]
            body_of[nearer, row], nearest[nearer, row] = number, near[nearer]
    count = len(body_of)
    owners = list(range(count))
    for one in range(count):
        for other in range(one):
            both = (body_of[one] >= 0) & (body_of[other] >= 0)
            if 2 * int((both & (body_of[one] == body_of[other])).sum()) > int(both.sum()):
                owners = [owners[other] if owner == owners[one] else owner for owner in owners]
    cut = np.zeros(len(clip.numbers), dtype=bool)
    cut[[row for part in parts for row in part.cuts]] = True
    votes = [(body_of == number).sum(axis=1) for number in range(len(people))]
    tracks = []
    for owner in sorted(set(owners)):
        mine = [n for n, each in enumerate(votes) if each.any() and owners[int(each.argmax())] == owner]
        if mine:
            surest_last = sorted(mine, key=lambda n: votes[n].max())
            tracks.append(_track([people[n] for n in surest_last], cut))
    return tuple(tracks)


def _track(people: Sequence[_Followed], cut: np.ndarray) -> BodyTrack:
    """Make one track of finds that are all of one person, the surest last, which wins in frames with
    several."""
    count = len(cut)
    whole = {
        name: np.full((count, NUM_BODY_POINTS, *shape), np.nan)
        for name, shape in (("keypoints", (2,)), ("visibility", ()), ("world", (3,)))
    }
    score = np.full(count, np.nan)
    for person in people:
        known = np.array(sorted(person.bodies))
        rows = np.arange(known[0], known[-1] + 1)
        before, after = np.searchsorted(known, rows, "right") - 1, np.searchsorted(known, rows)
        span = known[after] - known[before]
        near = span <= FOLLOWING.resting_step
        part = (rows - known[before]) / np.maximum(span, 1)
        for name, values in whole.items():
            predicted = np.stack([getattr(person.bodies[row], name) for row in known])
            moved = predicted[after] - predicted[before]
            between = predicted[before] + part.reshape(-1, *[1] * (moved.ndim - 1)) * moved
            values[rows[near]] = between[near]
        score[list(person.scores)] = list(person.scores.values())
    return BodyTrack(**whole, score=score, present=np.isfinite(whole["visibility"][:, 0]), cut=cut)
