"""Identity assignment: which of two hands each detection is of, decided over a whole clip at once.

Hands meet, hide each other and part, and a small fast hand is soon where the other one was: frame by frame,
a track jumps. So the detections are assigned to the hands in the way that is likeliest over all frames
together, by how each hand then moves and by the sides that its detections name: Viterbi's algorithm, in which
a state is the last detection of either hand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, permutations
from typing import Any, Final

import numpy as np

from handfit_core.common.skeleton import SIDES
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.matching import distances


@dataclass(frozen=True)
class IdentitySettings:
    """Thresholds and weights of identity assignment. Motions and distances are in hand sizes, gaps in
    frames."""

    side_weight: float = 0.25
    """Weight of the side that a detection names, small since the sides of neighbouring frames are wrong
    together"""
    max_side_probability: float = 0.95
    """Bound to which probabilities of a side are clipped: that of a detection, and a hand's share of
    detections of one side"""
    max_motion: float = 3.0
    """Motion from one frame to the next beyond which all motions are equally unlikely"""
    start_motion: float = 1.0
    """Motion that is as unlikely as the start of another hand"""
    min_typical_motion: float = 0.1
    """The least motion per frame, in hand sizes, that counts as typical; else the clip's median does"""
    min_typical_deformation: float = 0.05
    """The least motion per frame, in hand sizes, of a hand's points about their mean that counts as typical;
    else the clip's median does. A left hand is never the shape of a right one"""
    gap_growth: float = 0.5
    """How much farther a hand may have moved for each frame without a detection, as a share of the distance
    in one frame"""
    gap_motion: float = 0.15
    """Motion that is as unlikely as a gap in a hand's detections"""
    velocity_frames: int = 3
    """Frames for which a hand may keep its velocity"""
    cut_weight: float = 0.1
    """Weight of motion and deformation across a cut, which say little of whose hand it is"""
    max_states: int = 12
    """Number of the likeliest states that are kept from frame to frame"""
    max_worse: float = 40.0
    """Negative log-likelihood by which a state may be worse than the likeliest one"""
    min_side_difference: float = 0.2
    """Difference of two hands' shares of detections named left below which both may be of one side, so that
    sides tell nothing"""
    max_third_share: float = 0.2
    """Share of the frames with two hands or more that may have three, as if a face were taken for one"""
    max_rounds: int = 3
    """Most rounds of assigning detections and estimating the hands' sides from the assignment"""
    max_tracks: int = 32
    """How many of the surest tracks are assigned anew: most clips have two or four, and a crowd's would take
    long"""
    near_distance: float = 3.0
    """Distance up to which two tracks count as near each other"""
    near_frames: int = 12
    """Frames between two detections up to which their tracks can come near each other"""
    max_partners: int = 3
    """Most other tracks from which each track is separated, one after another: as many as two people have
    other hands"""


IDENTITY: Final = IdentitySettings()


def separate_hands(
    hands: Detections, tracks: Sequence[np.ndarray], cuts: Sequence[int] = ()
) -> list[np.ndarray]:
    """Rearrange the detections of a clip into tracks that stay on their hands where two of these come near
    each other; a hand that was lost for a moment is one track again. `tracks` are the rows (N,) of each
    track's detections, in the order of frames, the surest track first; `cuts` are the frames that begin
    another shot.

    The sides that a person has given are kept: no track has detections of two given sides, where another one
    is near that they may be of.
    """
    surest = list(tracks[: IDENTITY.max_tracks])
    apart: set[tuple[int, int]] = set()
    for _ in range(IDENTITY.max_partners):
        groups, surest = _near_groups(hands, surest, apart), []
        apart = set()
        for group in groups:
            if len(group) > 1:
                group = _assign_two(hands, group, cuts)
                apart.add((len(surest), len(surest) + 1))
            surest += group
        if not apart:
            break
    return [*surest, *tracks[IDENTITY.max_tracks :]]


def _near_groups(
    hands: Detections, tracks: Sequence[np.ndarray], apart: set[tuple[int, int]]
) -> list[list[np.ndarray]]:
    """Group tracks with the other tracks that they are near most often and with their fragments, except for
    the pairs that were just set `apart`. Few frames of a group have more than two hands."""
    frames = [hands.frame[track] for track in tracks]
    near: list[tuple[int, int, int]] = []
    for one, other in combinations(range(len(tracks)), 2):
        after = np.searchsorted(frames[other], frames[one])
        beside = np.stack([after - 1, after]).clip(0, len(frames[other]) - 1)
        soon = np.abs(frames[other][beside] - frames[one]) <= IDENTITY.near_frames
        mine, theirs = tracks[one][np.nonzero(soon)[1]], tracks[other][beside[soon]]
        if (one, other) not in apart:
            found = distances(hands, mine, theirs, IDENTITY.near_distance)
            near.append((int(np.isfinite(found).sum()), one, other))
    groups, of = [[track] for track in tracks], list(range(len(tracks)))
    counts = [Counter(each.tolist()) for each in frames]
    for meetings, *both in sorted(near, key=lambda pair: -pair[0]):
        one, other = (of[track] for track in both)
        if not meetings or one == other:
            continue
        many = np.bincount(list((counts[one] + counts[other]).values()), minlength=4)
        if len(many) == 4 and many[3] <= IDENTITY.max_third_share * many[2:].sum():
            groups[one] += groups[other]
            counts[one] += counts[other]
            groups[other] = []
            of = [one if group == other else group for group in of]
    return [group for group in groups if group]


def _assign_two(hands: Detections, tracks: Sequence[np.ndarray], cuts: Sequence[int]) -> list[np.ndarray]:
    """Rearrange a group's detections into the tracks of two hands, and a track of what is left in frames that
    have three."""
    rows = np.concatenate(tracks)
    number = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    order = np.lexsort([number, hands.frame[rows]])
    rows, number = rows[order], number[order]
    assignment = _Assignment(hands.select(rows), cuts)
    left = assignment.left
    both = np.array([np.sort(left[pair]) for pair in assignment.rows if len(pair) == 2]).reshape(-1, 2)
    rates = both.mean(axis=0) if len(both) else _clipped(np.array([0.0, 1.0]))
    owners = np.zeros(0, dtype=int)
    for _ in range(IDENTITY.max_rounds):
        if rates[1] - rates[0] < IDENTITY.min_side_difference:
            rates[:] = rates.mean()
        before, owners = owners, assignment.owners(rates)
        if np.array_equal(before, owners):
            break
        rates = np.array([left[owners == i].mean() if i in owners else 0.5 for i in (0, 1)])
    owners = np.where(owners >= 0, owners, -1 - number)
    return [rows[owners == owner] for owner in dict.fromkeys(owners.tolist())]


class _Assignment:
    """Which of two hands N detections are of, by Viterbi's algorithm."""

    def __init__(self, hands: Detections, cuts: Sequence[int]) -> None:
        self.rows: list[list[int]] = [rows.tolist() for rows in hands.rows_by_frame]
        """The rows of the detections of each frame that has any"""
        self._frame: list[int] = hands.frame.tolist()
        shot = np.searchsorted(cuts, hands.frame, "right")
        begins = hands.frame == hands.frame[np.searchsorted(shot, shot)]
        self._begins: list[bool] = (begins & (shot > 0)).tolist()
        """N bools: True for the first detections after a cut"""
        self._size: list[float] = np.maximum(hands.extent, 1e-9).tolist()
        """N sizes of the hands in the picture, pixels"""
        self._points = hands.keypoints_2d @ np.array([1.0, 1.0j])
        """(N, 21) complex numbers x + iy: the keypoints in pixels"""
        votes, given = hands.side_votes, hands.given_side
        left = votes[:, 0] / np.maximum(votes.sum(axis=1), 1e-9)
        left = np.where(given >= 0, given == SIDES.index("left"), left)
        self.left = _clipped(left)
        """(N,) probability that each detection is of a left hand, clipped"""
        named = given[:, None] == np.arange(len(SIDES))
        self._excluded = named & named.any(axis=0).all()
        """(N, 2) bool: True where a detection cannot be of the first hand, or of the second, by the sides
        that a person has given to both"""

    def _step(self, last: int, now: int, velocity: complex) -> tuple[float, float, complex]:
        """Return motion, deformation and velocity of a hand whose detection `last` is followed by `now`, with
        `velocity` (complex, pixels a frame) before: the hand sizes that it moved otherwise than expected, the
        hand sizes that its points moved about their mean, and its new velocity in complex pixels a frame."""
        gap, size = self._frame[now] - self._frame[last], max(self._size[last], self._size[now])
        moved = self._points[now] - self._points[last]
        shift = complex(moved.mean())
        off = min(abs(shift), abs(shift - velocity * min(gap, IDENTITY.velocity_frames)))
        longer = 1.0 + IDENTITY.gap_growth * (gap - 1)
        motion = min(off / size, IDENTITY.max_motion) / longer + IDENTITY.gap_motion * (gap > 1)
        deformation = float(np.abs(moved - shift).mean()) / size / longer
        return motion, deformation, shift / gap if gap <= IDENTITY.velocity_frames else 0j

    @property
    def _typical(self) -> tuple[float, float]:
        """Return the typical motion and deformation from one frame to the next, in hand sizes."""
        steps = [
            min((self._step(last, row, 0j)[:2] for last in before), key=sum)
            for before, rows in pairwise(self.rows)
            for row in rows
            if self._frame[row] - self._frame[before[0]] == 1
        ]
        least = IDENTITY.min_typical_motion, IDENTITY.min_typical_deformation
        motion, change = np.maximum(np.median(steps, axis=0), least).tolist() if steps else least
        return motion, change

    def owners(self, rates: np.ndarray) -> np.ndarray:
        """Return (N,) the hand of each detection, 0 or 1, on the likeliest path; -1 for neither, where both
        hands have a likelier detection in that frame. `rates` (2,) are the shares of the hands' detections
        that are named left."""
        rates, left = _clipped(rates), self.left[:, None]
        side_costs = -IDENTITY.side_weight * (left * np.log(rates) + (1.0 - left) * np.log(1.0 - rates))
        # The first hand is the one that is named right more often.
        side_costs = (side_costs + 1000.0 * self._excluded).tolist()
        typical_motion, typical_deformation = self._typical
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
                        motion, deformation = IDENTITY.start_motion, 0.0
                        if lasts[hand] >= 0:
                            step = self._step(lasts[hand], row, velocities[hand])
                            motion, deformation, moving[hand] = step
                        weight = IDENTITY.cut_weight if self._begins[row] else 1.0
                        total += side_costs[row][hand]
                        total += weight * (motion / typical_motion + deformation / typical_deformation)
                        now[hand] = row
                    key = now[0], now[1]
                    if key not in after or total < after[key][0]:
                        after[key] = total, (moving[0], moving[1]), (past, choice)
            best = sorted(after.items(), key=lambda state: state[1][0])[: IDENTITY.max_states]
            states = {key: state for key, state in best if state[0] <= best[0][1][0] + IDENTITY.max_worse}
        _, _, past = next(iter(states.values()))
        owners = np.full(len(self.left), -1)
        while past is not None:
            past, choice = past
            for hand, row in enumerate(choice):
                if row >= 0:
                    owners[row] = hand
        return owners


def _clipped(probability: np.ndarray) -> np.ndarray:
    return np.clip(probability, 1.0 - IDENTITY.max_side_probability, IDENTITY.max_side_probability)
