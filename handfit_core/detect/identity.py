"""Identity assignment: which of two hands each detection is of, decided over a whole clip at once.

Hands meet, hide each other and part, and a small fast hand is soon where the other one was: frame by frame,
a track jumps. So the detections are assigned to the hands in the way that is likeliest over all frames
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
from handfit_core.detect.matching import HandArrays
from handfit_core.skeleton import SIDES

SIDE_WEIGHT: Final = 0.25
"""Weight of a detection's side: those of neighbouring frames are wrong together"""

MAX_SIDE_PROBABILITY: Final = 0.95
"""To which the side's probability of a detection, and a hand's share of detections of one side, are
clipped"""

MAX_MOTION: Final = 3.0
"""Hand sizes from frame to frame beyond which all motions are equally unlikely"""

START_MOTION: Final = 1.0
"""Hand sizes of motion that the start of another hand is as unlikely as"""

MIN_TYPICAL_MOTION: Final = 0.1
"""Hand sizes a frame; the typical motion is the clip's median, and no less"""

MIN_TYPICAL_DEFORMATION: Final = 0.05
"""Hand sizes a frame; the typical motion of a hand's points about their mean is the clip's median, and no
less. A left hand is never the shape of a right one"""

GAP_GROWTH: Final = 0.5
"""What each frame without a detection adds to how far a hand may have moved, as a share of that"""

GAP_MOTION: Final = 0.15
"""Hand sizes of motion that a gap in a hand's detections is as unlikely as"""

VELOCITY_FRAMES: Final = 3
"""Frames for which a hand may keep its velocity"""

MAX_STATES: Final = 12
"""States that are kept from frame to frame, the likeliest"""

MAX_WORSE: Final = 40.0
"""Negative log-likelihood by which a state may be worse than the likeliest one"""

MIN_SIDE_DIFFERENCE: Final = 0.2
"""Two hands whose shares of detections that are named left differ by less may be of one side, so that sides
tell nothing"""

MAX_THIRD_SHARE: Final = 0.2
"""Of the frames with two hands or more, the share that may have three, as if a face were taken for one"""

MAX_ROUNDS: Final = 3
"""Rounds of assigning detections and estimating the hands' sides from the assignment"""

MAX_TRACKS: Final = 32
"""The surest tracks are assigned anew: most clips have two or four, and a crowd's would take long"""

NEAR_DISTANCE: Final = 3.0
"""Hand sizes; tracks come near each other where they are no farther apart than this"""

NEAR_FRAMES: Final = 12
"""within so many frames"""

MAX_PARTNERS: Final = 3
"""Other tracks from which each one is separated, one after another: as many as two people have other hands"""

Track = Mapping[int, HandDetection]
"""Detections by frame, in the order of frames"""


def separate_hands(tracks: Sequence[Track]) -> list[Track]:
    """Rearrange detections into tracks that stay on their hands where two of these come near each other. A
    hand that was lost for a moment is one track again. `tracks`: the surest first.

    The sides that a person has given are kept: no track has detections of two given sides, where another one
    is near that they may be of.
    """
    surest: list[Track] = list(tracks[:MAX_TRACKS])
    apart: set[tuple[int, int]] = set()
    for _ in range(MAX_PARTNERS):
        groups, surest = _near_groups(surest, apart), []
        apart = set()
        for group in groups:
            if len(group) > 1:
                group = _assign_two(group)
                apart.add((len(surest), len(surest) + 1))
            surest += group
        if not apart:
            break
    return [*surest, *tracks[MAX_TRACKS:]]


def _near_groups(tracks: Sequence[Track], apart: set[tuple[int, int]]) -> list[list[Track]]:
    """Group tracks that are near each other most often, with their fragments, unless they are among the pairs
    that were just set `apart`. Few frames of a group have more than two hands."""
    arrays = [HandArrays.of(list(track.values())) for track in tracks]
    frames = [np.array(list(track)) for track in tracks]
    near: list[tuple[int, int, int]] = []
    for one, other in combinations(range(len(tracks)), 2):
        after = np.searchsorted(frames[other], frames[one])
        other_rows = np.stack([after - 1, after]).clip(0, len(frames[other]) - 1)
        soon = np.abs(frames[other][other_rows] - frames[one]) <= NEAR_FRAMES
        distances = arrays[one].distances(np.nonzero(soon)[1], arrays[other], other_rows[soon], NEAR_DISTANCE)
        if (one, other) not in apart:
            near.append((int(np.isfinite(distances).sum()), one, other))
    groups, of = [[track] for track in tracks], list(range(len(tracks)))
    counts = [Counter(track.keys()) for track in tracks]
    for meetings, *both in sorted(near, key=lambda pair: -pair[0]):
        one, other = (of[track] for track in both)
        if not meetings or one == other:
            continue
        many = np.bincount(list((counts[one] + counts[other]).values()), minlength=4)
        if len(many) == 4 and many[3] <= MAX_THIRD_SHARE * many[2:].sum():
            groups[one] += groups[other]
            counts[one] += counts[other]
            groups[other] = []
            of = [one if group == other else group for group in of]
    return [group for group in groups if group]


def _assign_two(tracks: Sequence[Track]) -> list[Track]:
    """Rearrange a group's detections into tracks of two hands, and of what is left in frames that have
    three."""
    hands = sorted(
        ((frame, number, hand) for number, track in enumerate(tracks) for frame, hand in track.items()),
        key=lambda each: each[:2],
    )
    seen = _Detections.of([(frame, hand) for frame, _, hand in hands])
    both = np.array([np.sort(seen.left[rows]) for rows in seen.rows if len(rows) == 2]).reshape(-1, 2)
    rates = both.mean(axis=0) if len(both) else np.array([1.0 - MAX_SIDE_PROBABILITY, MAX_SIDE_PROBABILITY])
    owners = np.zeros(0, dtype=int)
    for _ in range(MAX_ROUNDS):
        if rates[1] - rates[0] < MIN_SIDE_DIFFERENCE:
            rates[:] = rates.mean()
        before, owners = owners, seen.owners(rates)
        if np.array_equal(before, owners):
            break
        rates = np.array([seen.left[owners == i].mean() if i in owners else 0.5 for i in (0, 1)])
    assigned: dict[int, dict[int, HandDetection]] = {}
    for (frame, number, hand), owner in zip(hands, owners.tolist(), strict=True):
        assigned.setdefault(owner if owner >= 0 else -1 - number, {})[frame] = hand
    return list(assigned.values())


@dataclass(frozen=True, eq=False)
class _Detections:
    """N detections as arrays."""

    rows: list[list[int]]
    """Indices of the detections of each frame that has some"""
    frame: list[int]
    """(N)"""
    points: np.ndarray
    """(N, 21) complex: x + iy, pixels"""
    size: list[float]
    """(N) pixels"""
    left: np.ndarray
    """(N,) probability of a left hand"""
    excluded: np.ndarray
    """(N, 2) bool: whether it cannot be of the first hand, or of the second, by the sides that a person has
    given to both"""

    @classmethod
    def of(cls, hands: Sequence[tuple[int, HandDetection]]) -> _Detections:
        """Detections and their frames, in order."""
        frame = [frame for frame, _ in hands]
        given = np.array([[hand.given_side == side for side in SIDES] for _, hand in hands])
        return cls(
            [list(rows) for _, rows in groupby(range(len(frame)), frame.__getitem__)],
            frame,
            np.array([hand.keypoints_2d @ [1.0, 1.0j] for _, hand in hands]),
            [max(hand.extent, 1e-9) for _, hand in hands],
            np.clip([_left(hand) for _, hand in hands], 1.0 - MAX_SIDE_PROBABILITY, MAX_SIDE_PROBABILITY),
            given & given.any(axis=0).all(),
        )

    def step(self, last: int, now: int, velocity: complex) -> tuple[float, float, complex]:
        """Motion, deformation and velocity of a hand whose detection `last` is followed by `now`, with
        `velocity` before: hand sizes that it moved otherwise than expected; hand sizes that its points moved
        about their mean; pixels a frame, complex."""
        gap, size = self.frame[now] - self.frame[last], max(self.size[last], self.size[now])
        moved = self.points[now] - self.points[last]
        shift = complex(moved.mean())
        off = min(abs(shift), abs(shift - velocity * min(gap, VELOCITY_FRAMES)))
        longer = 1.0 + GAP_GROWTH * (gap - 1)
        motion = min(off / size, MAX_MOTION) / longer + GAP_MOTION * (gap > 1)
        deformation = float(np.abs(moved - shift).mean()) / size / longer
        return motion, deformation, shift / gap if gap <= VELOCITY_FRAMES else 0j

    @property
    def typical(self) -> tuple[float, float]:
        """Typical motion and deformation from one frame to the next, hand sizes."""
        steps = [
            min((self.step(last, row, 0j)[:2] for last in before), key=sum)
            for before, rows in pairwise(self.rows)
            for row in rows
            if self.frame[row] - self.frame[before[0]] == 1
        ]
        motion, change = np.median(steps, axis=0) if steps else (0.0, 0.0)
        return max(MIN_TYPICAL_MOTION, float(motion)), max(MIN_TYPICAL_DEFORMATION, float(change))

    def owners(self, rates: np.ndarray) -> np.ndarray:
        """(N,) the hand of each detection, 0 or 1, on the likeliest path; -1: of neither, since both have a
        likelier one in that frame. `rates` (2,): shares of the hands' detections that are named left."""
        rates, left = np.clip(rates, 1.0 - MAX_SIDE_PROBABILITY, MAX_SIDE_PROBABILITY), self.left[:, None]
        side_costs = -SIDE_WEIGHT * (left * np.log(rates) + (1.0 - left) * np.log(1.0 - rates))
        # The first hand is the one that is named right more often.
        side_costs = (side_costs + 1000.0 * self.excluded).tolist()
        typical_motion, typical_deformation = self.typical
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
                        motion, deformation = START_MOTION, 0.0
                        if lasts[hand] >= 0:
                            step = self.step(lasts[hand], row, velocities[hand])
                            motion, deformation, moving[hand] = step
                        total += (
                            side_costs[row][hand]
                            + motion / typical_motion
                            + deformation / typical_deformation
                        )
                        now[hand] = row
                    key = now[0], now[1]
                    if key not in after or total < after[key][0]:
                        after[key] = total, (moving[0], moving[1]), (past, choice)
            best = sorted(after.items(), key=lambda state: state[1][0])[:MAX_STATES]
            states = {key: state for key, state in best if state[0] <= best[0][1][0] + MAX_WORSE}
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
