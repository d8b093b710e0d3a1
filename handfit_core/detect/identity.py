"""Which of two hands each detection is of, decided over a whole clip at once.

Hands meet, hide each other and part, and a small fast hand is soon where the other one was: frame by frame,
a track jumps. So the detections are shared between the hands in the way that is likeliest over all frames
together, by how each hand then moves and by the sides that its detections name: Viterbi's algorithm, in which
a state is the last detection of either hand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, groupby, pairwise, permutations
from typing import Any, Final

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.looks import Crowd
from handfit_core.skeleton import SIDES

SIDE_WEIGHT: Final = 0.25
"""What a detection's word for a side counts: those of neighbouring frames are wrong together"""

SUREST: Final = 0.95
"""No detection, and no hand's share of detections of one side, counts as surer of a side than this"""

FARTHEST: Final = 3.0
"""Hand sizes from frame to frame, from which on all movements are as unlikely"""

BEGINNING: Final = 1.0
"""The cost of beginning another hand, as that of a movement by so many hand sizes"""

LEAST_MOTION: Final = 0.1
"""Hand sizes a frame; what hands usually move is the clip's median, and no less"""

LEAST_CHANGE: Final = 0.05
"""The same of how much their points move about their middle: a left hand is never the shape of a right one"""

GAP_MOTION: Final = 0.5
"""What each frame in which a hand was not seen adds to how far it may have moved, as a share of that"""

LOST: Final = 0.15
"""To be lost for frames and found again is as unlikely as a movement by so many hand sizes"""

FORESIGHT: Final = 3
"""Frames for which a hand may keep its velocity"""

MOST_STATES: Final = 12
"""The likeliest, which are gone on with"""

MOST_WORSE: Final = 40.0
"""What is less likely than the likeliest state by a factor of exp(40) is given up"""

UNLIKE: Final = 0.2
"""Hands whose shares of detections that are named left differ by less may be of one side, and sides tell
nothing"""

STRAYS: Final = 0.2
"""Share of the frames with two hands or more that may have three, as if a face were taken for one"""

ROUNDS: Final = 3
"""How often the hands' sides are learned anew from what was decided"""

MOST_TRACKS: Final = 32
"""The surest of a clip are looked at: most clips have two or four, and a crowd's would take long"""

REACH: Final = 3.0
"""Tracks come near each other where they are no more hand sizes apart than this"""

SOON: Final = 12
"""and no more frames"""

PARTNERS: Final = 3
"""So often each track is told apart from another one: as often as two people have other hands"""

Track = Mapping[int, HandDetection]
"""A detection of each frame, in the order of frames"""


def told_apart(tracks: Sequence[Track]) -> list[Track]:
    """Detections, rearranged into tracks that stay on their hands where two of these come near each other.
    A hand that was lost for a moment is one track again. tracks: the surest first.

    What a person has said of sides is never contradicted: no track has detections of two given sides, where
    another one is near that they may be of.
    """
    surest: list[Track] = list(tracks[:MOST_TRACKS])
    apart: set[tuple[int, int]] = set()
    for _ in range(PARTNERS):
        groups, surest = _pairs(surest, apart), []
        apart = set()
        for group in groups:
            if len(group) > 1:
                group = _of_two(group)
                apart.add((len(surest), len(surest) + 1))
            surest += group
        if not apart:
            break
    return [*surest, *tracks[MOST_TRACKS:]]


def _pairs(tracks: Sequence[Track], apart: set[tuple[int, int]]) -> list[list[Track]]:
    """The tracks in groups, in few frames of which there are more than two hands: those that are near each
    other most often, unless they have just been told `apart`, and their fragments."""
    crowds = [Crowd.of(list(track.values())) for track in tracks]
    frames = [np.array(list(track)) for track in tracks]
    near: list[tuple[int, int, int]] = []
    for one, other in combinations(range(len(tracks)), 2):
        after = np.searchsorted(frames[other], frames[one])
        theirs = np.stack([after - 1, after]).clip(0, len(frames[other]) - 1)
        soon = np.abs(frames[other][theirs] - frames[one]) <= SOON
        far = crowds[one].distances(np.nonzero(soon)[1], crowds[other], theirs[soon], REACH)
        if (one, other) not in apart:
            near.append((int(np.isfinite(far).sum()), one, other))
    groups, of = [[track] for track in tracks], list(range(len(tracks)))
    counts = [Counter(track.keys()) for track in tracks]
    for meetings, *both in sorted(near, key=lambda pair: -pair[0]):
        one, other = (of[track] for track in both)
        if not meetings or one == other:
            continue
        many = np.bincount(list((counts[one] + counts[other]).values()), minlength=4)
        if len(many) == 4 and many[3] <= STRAYS * many[2:].sum():
            groups[one] += groups[other]
            counts[one] += counts[other]
            groups[other] = []
            of = [one if group == other else group for group in of]
    return [group for group in groups if group]


def _of_two(tracks: Sequence[Track]) -> list[Track]:
    """Detections, rearranged into tracks of two hands, and of what is left in frames that have three."""
    hands = sorted(
        ((frame, number, hand) for number, track in enumerate(tracks) for frame, hand in track.items()),
        key=lambda each: each[:2],
    )
    seen = _Seen.of([(frame, hand) for frame, _, hand in hands])
    both = np.array([np.sort(seen.left[rows]) for rows in seen.rows if len(rows) == 2]).reshape(-1, 2)
    rates = both.mean(axis=0) if len(both) else np.array([1.0 - SUREST, SUREST])
    owners = np.zeros(0, dtype=int)
    for _ in range(ROUNDS):
        if rates[1] - rates[0] < UNLIKE:
            rates[:] = rates.mean()
        before, owners = owners, seen.owners(rates)
        if np.array_equal(before, owners):
            break
        rates = np.array([seen.left[owners == i].mean() if i in owners else 0.5 for i in (0, 1)])
    told: dict[int, dict[int, HandDetection]] = {}
    for (frame, number, hand), owner in zip(hands, owners.tolist(), strict=True):
        told.setdefault(owner if owner >= 0 else -1 - number, {})[frame] = hand
    return list(told.values())


@dataclass(frozen=True, eq=False)
class _Seen:
    """N detections as arrays."""

    rows: list[list[int]]
    """of each frame"""
    frame: list[int]
    points: np.ndarray
    """(N, 21) complex: x + iy, pixels"""
    size: list[float]
    """pixels"""
    left: np.ndarray
    """(N,) how sure it is that it is a left hand"""
    given: np.ndarray
    """(N, 2) bool: whether it cannot be of the first hand, or of the second, since a person has told them
    apart"""

    @classmethod
    def of(cls, hands: Sequence[tuple[int, HandDetection]]) -> _Seen:
        """Detections and their frames, in order."""
        frame = [frame for frame, _ in hands]
        given = np.array([[hand.given_side == side for side in SIDES] for _, hand in hands])
        return cls(
            [list(rows) for _, rows in groupby(range(len(frame)), frame.__getitem__)],
            frame,
            np.array([hand.keypoints_2d @ [1.0, 1.0j] for _, hand in hands]),
            [max(hand.extent, 1e-9) for _, hand in hands],
            np.clip([_left(hand) for _, hand in hands], 1.0 - SUREST, SUREST),
            given & given.any(axis=0).all(),
        )

    def step(self, last: int, now: int, velocity: complex) -> tuple[float, float, complex]:
        """By how many hand sizes a hand moved otherwise than expected, where `now` follows `last`; how much
        its points moved about their middle, in the same units; its velocity then, pixels a frame."""
        gap, size = self.frame[now] - self.frame[last], max(self.size[last], self.size[now])
        moved = self.points[now] - self.points[last]
        middle = complex(moved.mean())
        off = min(abs(middle), abs(middle - velocity * min(gap, FORESIGHT)))
        longer = 1.0 + GAP_MOTION * (gap - 1)
        far = min(off / size, FARTHEST) / longer + LOST * (gap > 1)
        changed = float(np.abs(moved - middle).mean()) / size / longer
        return far, changed, middle / gap if gap <= FORESIGHT else 0j

    @property
    def usual(self) -> tuple[float, float]:
        """Hand sizes that hands usually move and change from one frame to the next."""
        steps = [
            min((self.step(last, row, 0j)[:2] for last in before), key=sum)
            for before, rows in pairwise(self.rows)
            for row in rows
            if self.frame[row] - self.frame[before[0]] == 1
        ]
        motion, change = np.median(steps, axis=0) if steps else (0.0, 0.0)
        return max(LEAST_MOTION, float(motion)), max(LEAST_CHANGE, float(change))

    def owners(self, rates: np.ndarray) -> np.ndarray:
        """(N,) 0 or 1: whose each detection most likely is, where `rates` (2,) are the shares of the hands'
        detections that are named left; -1: of neither, since both have a likelier one in that frame."""
        rates, left = np.clip(rates, 1.0 - SUREST, SUREST), self.left[:, None]
        words = -SIDE_WEIGHT * (left * np.log(rates) + (1.0 - left) * np.log(1.0 - rates))
        # The first hand is the one that is named right more often.
        words = (words + 1000.0 * self.given).tolist()
        motion, change = self.usual
        states: dict[tuple[int, int], tuple[float, tuple[complex, complex], Any]]
        states = {(-1, -1): (0.0, (0j, 0j), None)}
        for rows in self.rows:
            choices = list(permutations(rows, 2)) if len(rows) > 1 else [(rows[0], -1), (-1, rows[0])]
            after: dict[tuple[int, int], tuple[float, tuple[complex, complex], Any]] = {}
            for lasts, (cost, velocities, past) in states.items():
                for choice in choices:
                    total, now, moving = cost, list(lasts), list(velocities)
                    for hand, row in enumerate(choice):
                        if row < 0:
                            continue
                        far, changed = BEGINNING, 0.0
                        if lasts[hand] >= 0:
                            far, changed, moving[hand] = self.step(lasts[hand], row, velocities[hand])
                        total += words[row][hand] + far / motion + changed / change
                        now[hand] = row
                    key = now[0], now[1]
                    if key not in after or total < after[key][0]:
                        after[key] = total, (moving[0], moving[1]), (past, choice)
            best = sorted(after.items(), key=lambda state: state[1][0])[:MOST_STATES]
            states = {key: state for key, state in best if state[0] <= best[0][1][0] + MOST_WORSE}
        _, _, past = next(iter(states.values()))
        owners = np.full(len(self.left), -1)
        while past is not None:
            past, choice = past
            for hand, row in enumerate(choice):
                if row >= 0:
                    owners[row] = hand
        return owners


def _left(hand: HandDetection) -> float:
    if hand.given_side is not None:
        return float(hand.given_side == "left")
    votes = hand.side_votes()
    return votes["left"] / max(sum(votes.values()), 1e-9)
