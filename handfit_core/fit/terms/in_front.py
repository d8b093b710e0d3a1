"""Which of two parts that cross in the picture is nearer to the camera."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.terms.rows import PairRows, between
from handfit_core.geometry.crossing import CROSSING
from handfit_core.hand_model.chain import Posed
from handfit_core.hand_model.surface import FINGER_OF_BONE, Surface

SIGMA: Final = 0.004
"""metres along the line of sight that cost as much as one sigma"""


class InFront:
    """One row for each crossing of `seen.meeting`: (apart - distance in the right order) / SIGMA, where that
    is positive. Parts that are farther apart than need be cost nothing."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __call__(self, posed: Posed, seen: Observation) -> PairRows:
        """The rows of B posed hands."""
        assert seen.meeting is not None
        hand, pair = np.nonzero(seen.meeting.front)
        front, along = seen.meeting.front[hand, pair], seen.meeting.along[hand, pair]
        bones = CROSSING[pair]
        ends = self.surface.capsules(posed).ends[hand[:, None], bones]  # (K, 2 bones, 2 ends, 3)
        places = ends[:, :, 0] + along[..., None] * (ends[:, :, 1] - ends[:, :, 0])
        sight = seen.ray[hand]
        behind = ((places[:, 0] - places[:, 1]) * sight).sum(axis=1) * front
        residual = (seen.meeting.apart[hand, pair] + behind) / SIGMA
        wrong = residual > 0.0
        hand, bones, residual = hand[wrong], bones[wrong], residual[wrong]
        slope = between(posed, hand, bones, places[wrong], (sight * front[:, None])[wrong] / SIGMA)
        columns = np.concatenate([slope, residual[:, None]], axis=1)
        return PairRows(hand, FINGER_OF_BONE[bones], columns, np.square(residual))
