"""Which hands of a picture are chosen; nothing here draws."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from handfit_core.capturing.options import CROWD, region_of
from handfit_core.common.arrays import unpack
from handfit_core.common.skeleton import SIDES, HandChoice, Side, other_side
from handfit_core.detect.detector import Region

SAME_HAND_DISTANCE: Final = 0.25
"""The distance of points, in units of the hands' size, below which two hands are one"""
FOUND_AGAIN: Final = (
    "The box shows no other hand than the one that is found already, which stays: draw it around the other "
    "hand alone, or lay that one there yourself with Add Hand"
)
FOUND_BETTER: Final = "The hand that was found here is replaced by a better one (Ctrl Z: as it was)"
HOVER_DISTANCE: Final = 0.3
"""The distance from one of a hand's points, as a share of its size, within which the mouse points at it"""


@dataclass(frozen=True, eq=False)
class FoundHand:
    """One hand that was found in the picture."""

    points: np.ndarray
    """(21, 2) pixels of the upright picture"""
    certainty: float
    detected_side: Side
    """The side that the detector named"""
    side: Side
    """The side to capture the hand as, which the artist may change"""
    box: tuple[float, ...]
    """x, y, width and height in pixels by which a capture finds it again: about its points, or as the artist
    has drawn it"""
    chosen: bool = False

    @classmethod
    def of(cls, hand: dict[str, Any], drawn: tuple[float, ...] | None = None) -> FoundHand:
        """Return a hand of the answer to a `find` request; `drawn`: the box in which it was searched."""
        points, side = unpack(hand["keypoints"]).astype(float), hand["side"]
        low = points.min(axis=0)
        box = drawn or (*low.tolist(), *np.maximum(points.max(axis=0) - low, 1.0).tolist())
        return cls(points, hand["certainty"], side, side, box, drawn is not None)

    @property
    def extent(self) -> float:
        """Return the longer side of the box of the hand's points, in pixels of the picture."""
        return float(np.ptp(self.points, axis=0).max())

    def is_same_hand(self, other: FoundHand) -> bool:
        """True if this hand and the other are detections of one hand."""
        apart = np.linalg.norm(self.points - other.points, axis=-1).mean()
        return bool(apart < SAME_HAND_DISTANCE * max(self.extent, other.extent))


class Choice:
    """The hands that are shown, the surest first; each step can be taken back."""

    def __init__(self) -> None:
        self.hands: tuple[FoundHand, ...] = ()
        self._undo_steps: list[tuple[FoundHand, ...]] = []

    @property
    def chosen(self) -> tuple[FoundHand, ...]:
        """Return the hands that are to be built."""
        return tuple(hand for hand in self.hands if hand.chosen)

    def show(self, found: Iterable[dict[str, Any]], wanted: HandChoice) -> None:
        """Begin with the hands of a worker's answer; chosen are the surest of those that are wanted, and no
        more than are built without asking."""
        hands = [FoundHand.of(hand) for hand in found]
        likely = [hand for hand in hands if wanted not in SIDES or hand.side == wanted][:CROWD]
        self.hands = tuple(replace(hand, chosen=hand in likely) for hand in hands)
        self._undo_steps.clear()

    def add(self, hand: FoundHand) -> str:
        """Add the hand that a search in a box found beside those that are shown, or in place of a worse
        detection of it; the search returns one that is shown where there is nothing better. Returns a
        sentence about what was not added or was replaced; empty for a new hand."""
        if any(np.array_equal(hand.points, other.points) for other in self.hands):
            return FOUND_AGAIN
        others = tuple(other for other in self.hands if not other.is_same_hand(hand))
        replaced = len(others) < len(self.hands)
        self._set_hands((*others, hand))
        return FOUND_BETTER if replaced else ""

    def toggle(self, hand: FoundHand) -> None:
        """Choose a hand, or leave it."""
        self._change(hand, chosen=not hand.chosen)

    def flip_side(self, hand: FoundHand) -> None:
        """Make a left hand a right one, or back, and choose it."""
        self._change(hand, side=other_side(hand.side), chosen=True)

    def remove(self, hand: FoundHand) -> None:
        """Remove a detection that is no hand."""
        self._set_hands(tuple(other for other in self.hands if other is not hand))

    def toggle_all(self) -> None:
        """Choose all; none where all are chosen."""
        every = len(self.chosen) < len(self.hands)
        self._set_hands(tuple(replace(hand, chosen=every) for hand in self.hands))

    def undo(self) -> bool:
        """Take the last step back; return whether there was one."""
        if self._undo_steps:
            self.hands = self._undo_steps.pop()
            return True
        return False

    def regions(self, frame: int | None) -> tuple[Region, ...]:
        """Return the chosen hands as a capture's regions; `frame` of the source, None for a photo."""
        return tuple(
            replace(
                region_of(hand.box), frame=frame, side=hand.side if hand.side != hand.detected_side else None
            )
            for hand in self.chosen
        )

    def hand_at(self, place: np.ndarray, scale: float, reach: float) -> FoundHand | None:
        """Return the hand with the point nearest to a place (2,) in the picture, if it is near enough:
        `reach` pixels of the region, or more where the hand is large; else None.

        `scale`: pixels of the region for one of the picture."""
        away = {hand: float(np.linalg.norm(hand.points - place, axis=-1).min()) for hand in self.hands}
        near = [hand for hand in self.hands if away[hand] <= max(reach / scale, HOVER_DISTANCE * hand.extent)]
        return min(near, key=away.__getitem__, default=None)

    def _change(self, hand: FoundHand, **fields: Any) -> None:
        self._set_hands(tuple(replace(other, **fields) if other is hand else other for other in self.hands))

    def _set_hands(self, hands: tuple[FoundHand, ...]) -> None:
        self._undo_steps.append(self.hands)
        self.hands = hands
