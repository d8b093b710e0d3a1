"""Every hand of a picture: palms at low scores over the whole and over parts of it, each looked at until the
landmark network finds it again where it is, and kept if it looks like a hand from all sides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.looks import View, distance, mean_of, of_one, same_hand, shrunk
from handfit_core.detect.networks import (
    ALL_LOOKS,
    HAND_SIZE,
    PALM_SIZE,
    Look,
    Networks,
    Palms,
    around,
    crop_of,
    view_of,
)

FIRST_SCORE: Final = 0.07
"""Of palms that are looked at: far lower than what is believed"""

FIRST_WORD: Final = 0.5
"""Of those that are looked at where the first word counts"""

HOPELESS: Final = 0.02
"""Presence at the first look below which there is no second"""

LEAST_PRESENCE: Final = 0.1
"""After the last look, below which there is no hand"""

PASSES: Final = 3
"""Looks from crop to crop, each about the landmarks of the one before"""

STAYS: Final = 0.05
"""Landmarks that a look moves less than this, in units of the hand's size, need no other look"""
SURE: Final = 0.9
"""Presence of looks that agree"""

FEW_LOOKS: Final = 3
HARDLY: Final = 0.06
"""After so few looks, what is less sure than this is not looked at any more"""

PARTS: Final = (1, 2, 3)
"""Tiles are so many times smaller than the picture, and half of one lies over the next"""

IN_BOX_SPANS: Final = (1.3, 1.8, 2.6)
AGAIN_SPANS: Final = IN_BOX_SPANS[1:2]
IN_BOX_TURNS: Final = 12
"""Crops about a box in which a person sees a hand, and about a doubtful one: sides in units of its longer
one, and how many turns"""

IN_BOX_PRESENCE: Final = 0.1
"""Where a person says that there is a hand, the network need not be sure"""

IN_BOX_BEST: Final = 4
"""Hands found from the most crops that are looked at closely"""

WHOLE: Final = (
    (1.0, 0.0, False),
    (1.5, 0.0, False),
    (1.5, np.pi / 2.0, False),
    (1.5, -np.pi / 2.0, False),
    (1.5, -np.pi / 4.0, False),
    (1.5, np.pi / 4.0, True),
    (2.2, 0.0, False),
    (2.2, np.pi, False),
)
"""Views of the whole picture: side in units of its longer one, turn in radians, mirrored. Hands that fill the
picture need room around them, and the palm network has its favourite directions"""

LEAST_TILE: Final = 96
"""Pixels a side"""

SEEN_AT: Final = 8
"""The palm network sees hands from this part of its picture's side upwards"""

SIZES_APART: Final = 2.5
"""Hands of one picture are not expected to differ more than so many times in size"""

SETTLED: Final = 0.15
"""Landmarks nearer than this, in units of the hand's size, were found already"""

DOUBTFUL: Final = (0.1, 0.85)
"""Certainties between which a hand is looked for again from all sides"""

ENOUGH: Final = 1152
"""Pixels a side of a picture in which palms are looked for: tiles of a third need no more"""

FIRST_JUDGED: Final = (0.95, 0.75, -1.3)
"""How sure it is that something is a hand: the logit of that by the logits of presence and palm score, and a
constant. In photos of people and in rendered pictures, half a certainty has one false hand among twenty."""
AT_LAST: Final = (1.4, 0.75, -0.8)
OF_AGAIN, OF_FAR = 2.0, 0.3
"""The same for a doubtful one, where also the share of crops in which it is found again counts, and the logit
of its palm's best score from farther off. Chosen on 150 doubtful ones of rendered pictures and photos."""

FAR: Final = 7.0
"""Side of those views in units of the hand's size"""
FAR_TURNS: Final = (0.6, -0.6)
"""Radians by which they are turned, besides those as the picture is and as the hand"""
LEAST_FAR: Final = 0.01

NEAR: Final = 8.0
"""Side of the views about a hand in which others of its size show best, in units of that size"""
NEAR_TURNS: Final = (0.0, 0.75 * np.pi)
MOST_NEAR: Final = 4
"""Hands about which others are looked for"""


@dataclass(frozen=True, eq=False)
class Sighting:
    """What may be a hand."""

    hand: HandDetection
    presence: float
    """How likely the landmark network takes it for a hand, on average over the looks, 0..1"""
    palm: float
    """The best score of its palm, 0..1"""
    again: float | None = None
    """In which part of the crops about it, turned all around, it was found again; None: it was in no doubt"""
    far: float = 0.0
    """The best score of its palm in views that show much around it, 0..1"""

    @property
    def certainty(self) -> float:
        """How sure it is that this is a hand, 0..1."""
        presence, palm, logit = FIRST_JUDGED if self.again is None else AT_LAST
        logit += presence * _logit(self.presence) + palm * _logit(self.palm)
        if self.again is not None:
            logit += OF_AGAIN * self.again + OF_FAR * _logit(self.far)
        return float(1.0 / (1.0 + np.exp(-logit)))


def tiles(width: int, height: int, parts: int) -> Iterator[View]:
    """Views of a picture for the palm network, each that many times smaller than its longer side."""
    span = max(width, height) / parts
    if parts > 1 and span < LEAST_TILE:
        return
    columns, rows = (max(1, int(np.ceil(2.0 * (side / span - 1.0) + 1.0 - 1e-6))) for side in (width, height))
    for y in _middles(height, span, rows):
        for x in _middles(width, span, columns):
            yield View.of_square(np.array([x, y]), span, PALM_SIZE)


def _middles(side: float, span: float, count: int) -> np.ndarray:
    return np.linspace(span / 2.0, side - span / 2.0, count) if count > 1 else np.array([side / 2.0])


class Search:
    """Looks for hands with both networks; in a draft, one look at each hand is enough. So it is with
    `first_word`, and palms must be sure, and only the whole picture is searched."""

    def __init__(self, networks: Networks, threshold: float, *, first_word: bool = False) -> None:
        self._networks = networks
        self._threshold = threshold
        self._parts = PARTS[:1] if first_word else PARTS
        self._palm = FIRST_WORD if first_word else FIRST_SCORE
        self._looks = 1 if first_word or networks.quality == "draft" else ALL_LOOKS

    def every_hand(self, rgb: np.ndarray) -> list[HandDetection]:
        """The hands of a picture (H, W, 3) uint8 RGB, the surest first."""
        block = max(1, max(rgb.shape[:2]) // ENOUGH)
        small = shrunk(rgb, block, block)
        height, width = small.shape[:2]
        found: list[Sighting] = []
        for parts in self._parts:
            largest = max((s.hand.extent for s in found if s.certainty >= self._threshold), default=0.0)
            if largest * SEEN_AT * (parts - 1) > max(rgb.shape[:2]) * SIZES_APART:
                break
            views = list(tiles(width, height, parts))
            if parts == 1 and len(self._parts) > 1:
                middle, side = np.array([width, height]) / 2.0, max(width, height)
                views = [
                    View.of_square(middle, span * side, PALM_SIZE, turn=turn, mirrored=mirrored)
                    for span, turn, mirrored in WHOLE
                ]
            if views:
                found = self._with(rgb, self._palms_in(small, views).times(block), found)
        if len(self._parts) > 1:
            near = list(self._near([s.hand for s in found if s.certainty >= self._threshold], max(rgb.shape)))
            if near:
                found = self._with(rgb, self._palms_in(rgb, near), found)
        return [
            replace(sighting.hand, certainty=sighting.certainty)
            for sighting in self._judged(rgb, found)
            if sighting.certainty >= self._threshold
        ]

    def more_hands(
        self, rgb: np.ndarray, views: Sequence[View], known: Sequence[HandDetection]
    ) -> list[HandDetection]:
        """Those whose palms are in views, `PALM_SIZE` wide, of a picture (H, W, 3) uint8 RGB, but for the
        known ones; sure ones are looked at once, as those that are followed are."""
        sure = [Sighting(hand, 1.0, 1.0) for hand in known]
        found = self._with(rgb, self._palms_in(rgb, views), sure, once=True)
        return [s.hand for s in found if s.certainty >= self._threshold and s not in sure]

    def hand_in(self, rgb: np.ndarray, box: Sequence[float]) -> HandDetection | None:
        """The hand that a person sees in a box (x, y, width, height) of a picture (H, W, 3) uint8 RGB, at
        whatever angle; None where nothing is found there again and again."""
        corner, size = np.array(box[:2]), np.array(box[2:])
        middle, side = corner + size / 2.0, float(size.max())
        found: list[list[Look]] = []
        for look in self._all_around(rgb, middle, side, IN_BOX_SPANS):
            if look is not None and _fills(look.hand, middle, size):
                same = next((g for g in found if distance(g[0].hand, look.hand) < SETTLED), None)
                found.append([look]) if same is None else same.append(look)
        likely = sorted(found, key=len, reverse=True)[:IN_BOX_BEST]
        sighted = [(self._sighted(rgb, group[0], 0.5), len(group)) for group in likely]
        best = max(sighted, key=lambda each: each[0].presence * (1 + each[1]), default=None)
        if best is None or best[0].presence < IN_BOX_PRESENCE:
            return None
        return replace(best[0].hand, certainty=best[0].certainty)

    def _judged(self, rgb: np.ndarray, found: Sequence[Sighting]) -> list[Sighting]:
        """The same but for parts of surer ones, and doubtful ones looked for again; the surest first."""
        kept: list[Sighting] = []
        for sighting in found:
            if self._looks == ALL_LOOKS and DOUBTFUL[0] < sighting.certainty < DOUBTFUL[1]:
                hand = sighting.hand
                if any(of_one(hand, s.hand) for s in kept if s.certainty >= self._threshold):
                    continue
                sighting = self._again(rgb, replace(sighting, far=self._far(rgb, hand)))
            kept.append(sighting)
        return sorted(kept, key=lambda s: s.certainty, reverse=True)

    def _near(self, hands: Sequence[HandDetection], longer: int) -> Iterator[View]:
        """Views about the first hands in which others of about their size would be seen, in a picture with
        that longer side: of a pair, the second often has a palm that no tile of a chosen size shows."""
        shown: list[tuple[np.ndarray, float]] = []
        for hand in hands:
            centre, span = hand.keypoints_2d.mean(axis=0), NEAR * hand.extent
            again = any(np.abs(centre - c).max() < s / 4.0 and 0.7 < span / s < 1.4 for c, s in shown)
            if not again and span < WHOLE[-1][0] * longer and len(shown) < MOST_NEAR:
                shown.append((centre, span))
                for turn in NEAR_TURNS:
                    yield View.of_square(centre, span, PALM_SIZE, turn=turn)

    def _again(self, rgb: np.ndarray, seen: Sighting) -> Sighting:
        """The same with the part of crops about it in which it is found again, as long as that may matter."""
        points, found = seen.hand.keypoints_2d, 0
        middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
        for tried, look in enumerate(self._all_around(rgb, middle, seen.hand.extent, AGAIN_SPANS), start=1):
            found += look is not None and distance(look.hand, seen.hand) < SETTLED
            most = found + IN_BOX_TURNS - tried
            if replace(seen, again=most / IN_BOX_TURNS).certainty < self._threshold:
                break
        return replace(seen, again=found / IN_BOX_TURNS)

    def _far(self, rgb: np.ndarray, hand: HandDetection) -> float:
        """The best score of a hand's palm in views that show much around it: 0 where it is not seen."""
        centre, _, upwards = crop_of(hand.keypoints)
        best = 0.0
        turns = (0.0, upwards, *(upwards + more for more in FAR_TURNS))
        views = [View.of_square(centre, FAR * hand.extent, PALM_SIZE, turn=turn) for turn in turns]
        for palms in self._networks.each(lambda n, view: n.palms(rgb, view, LEAST_FAR), views):
            best = max(best, *(float(palms.score[i]) for i in range(len(palms)) if palms.is_of(i, hand)), 0.0)
        return best

    def _all_around(
        self, rgb: np.ndarray, middle: np.ndarray, side: float, spans: Sequence[float]
    ) -> Iterator[Look | None]:
        """What the landmark network settles on about a box with that longer side, whatever its angle."""
        turns = np.arange(IN_BOX_TURNS) * (2.0 * np.pi / IN_BOX_TURNS)
        views = [View.of_square(middle, span * side, HAND_SIZE, turn=t) for span in spans for t in turns]
        return self._networks.each(lambda n, view: settled(n, rgb, view, IN_BOX_PRESENCE), views)

    def _palms_in(self, rgb: np.ndarray, views: Sequence[View]) -> Palms:
        found = self._networks.each(lambda n, view: n.palms(rgb, view, self._palm), views)
        return Palms.of(list(found))

    def _with(
        self, rgb: np.ndarray, palms: Palms, known: Sequence[Sighting], *, once: bool = False
    ) -> list[Sighting]:
        """What is known, and the hands of those palms, each hand once, the surest first."""
        found = list(known)
        looks: dict[int, Look | None] = {}
        for i in range(len(palms)):
            palm = float(palms.score[i])
            again = next((s for s in found if palms.is_of(i, s.hand)), None)
            if again is None and i not in looks:
                others = (j for j in range(i, len(palms)) if not any(palms.is_of(j, s.hand) for s in found))
                ahead = list(islice(others, self._networks.threads))
                views = [palms.view(j) for j in ahead]
                seen = self._networks.each(lambda n, view: settled(n, rgb, view), views)
                looks |= dict(zip(ahead, seen, strict=True))
            look = None if again is not None else looks[i]
            if look is not None:
                again = next((s for s in found if distance(s.hand, look.hand) < SETTLED), None)
            if again is not None and palm > again.palm:
                found.append(replace(again, palm=palm))
            elif again is None and look is not None:
                first = Sighting(look.hand, look.presence, palm)
                found.append(
                    first if once and first.certainty > DOUBTFUL[1] else self._sighted(rgb, look, palm)
                )
        kept: list[Sighting] = []
        for sighting in sorted(found, key=lambda s: s.certainty, reverse=True):
            if not any(same_hand(sighting.hand, other.hand) for other in kept):
                kept.append(sighting)
        return kept

    def _sighted(self, rgb: np.ndarray, first: Look, palm: float) -> Sighting:
        """The mean of several looks at a hand that was found through a palm of that score."""
        looks, seen = [first], Sighting(first.hand, first.presence, palm)
        views = list(islice(around(first.hand.keypoints), 1, self._looks))
        for look in self._networks.each(lambda n, view: n.look(rgb, view), views):
            looks.append(look)
            seen = replace(seen, presence=float(np.mean([look.presence for look in looks])))
            if len(looks) == FEW_LOOKS and seen.certainty < HARDLY:
                break
        return replace(seen, hand=mean_of([look.hand for look in looks]))


def settled(networks: Networks, rgb: np.ndarray, view: View, least: float = LEAST_PRESENCE) -> Look | None:
    """What the landmark network finds in a view, once it finds it again where it was; None: no hand."""
    look = networks.look(rgb, view)
    for _ in range(PASSES - 1):
        if look.presence < HOPELESS:
            return None
        before, look = look, networks.look(rgb, view_of(look.hand.keypoints))
        if min(before.presence, look.presence) > SURE and distance(before.hand, look.hand) < STAYS:
            break
    return look if look.presence >= least else None


def _fills(hand: HandDetection, middle: np.ndarray, size: np.ndarray) -> bool:
    """Whether a hand is in a box, and about as large."""
    low, high = hand.keypoints_2d.min(axis=0), hand.keypoints_2d.max(axis=0)
    off, longer = np.abs((low + high) / 2.0 - middle), float(size.max())
    return bool((off < size / 2.0 + 0.1 * longer).all()) and 0.45 < hand.extent / longer < 2.0


def _logit(probability: float) -> float:
    within = min(max(probability, 0.01), 0.99)
    return float(np.log(within / (1.0 - within)))
