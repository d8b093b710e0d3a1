"""A take as players of animations want it: one hand a side, a pose in every frame, frames in equal steps."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import Take

log = logging.getLogger("handfit")


@dataclass(frozen=True, eq=False)
class EveryFrame:
    """The hands of a take on frames in equal steps, without gaps: where a hand was not seen, it is as it was
    last, or will be first."""

    numbers: np.ndarray
    """(F,) int: the take's frame numbers, and those between that it lacks"""
    fps: float
    """Frames per second of the frames in equal steps"""
    hands: Mapping[Side, HandMotion]
    present: Mapping[Side, np.ndarray]
    """For each side, (F,) bool: the frames in which the take has that hand"""

    @classmethod
    def of(cls, take: Take) -> EveryFrame:
        """Make the hands of a take on frames in equal steps. Of several hands of one side the one that is
        seen longest is taken, and a warning says so."""
        given = np.asarray(take.frame_numbers)
        step = int(np.gcd.reduce(np.diff(given))) if len(given) > 1 else 1
        count = (int(given[-1]) - int(given[0])) // step + 1
        # A single number that is far off, as names of pictures may have, makes no million of frames.
        even = count <= max(100 * len(given), 1000)
        numbers = np.arange(given[0], given[-1] + 1, step) if even else given
        hands: dict[Side, HandMotion] = {}
        present: dict[Side, np.ndarray] = {}
        for side in SIDES:
            tracks = [hand for hand in take.hands if hand.side == side and hand.present.any()]
            if len(tracks) > 1:
                log.warning(
                    "%d %s hands are in the take, and this format has one: the one that is seen longest",
                    len(tracks),
                    side,
                )
            if tracks:
                longest = max(tracks, key=lambda hand: int(hand.present.sum()))
                rows = np.flatnonzero(longest.present)
                last = np.maximum(np.searchsorted(given[rows], numbers, side="right") - 1, 0)
                held = rows[last]
                hands[side] = HandMotion(side, longest.betas, *(each[held] for each in longest.pose))
                present[side] = given[held] == numbers
        return cls(numbers, take.fps / step, hands, present)
