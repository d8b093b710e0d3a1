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
LYING_SIGMA: Final = 0.0025
"""metres between the skins of parts that lie on each other"""
FAR: Final = 0.02
"""metres; parts that stay farther apart were taken for lying on each other by mistake, and pull hardly"""


class InFront:
    """One row for each crossing of `seen.meeting`: r = apart - distance in the right order, over SIGMA where
    it is positive. Parts farther apart than need be cost nothing, unless they lie on each other: then
    r / LYING_SIGMA with Geman and McClure's kernel, as of `touch`."""

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
        lacks = seen.meeting.apart[hand, pair] + behind
        lying = np.where(lacks < 0.0, seen.meeting.lying[hand, pair], 0.0)
        counts = (lacks > 0.0) | (lying > 0.0)
        hand, bones, places, lacks, lying = (v[counts] for v in (hand, bones, places, lacks, lying))
        flat = np.where(lying > 0.0, 1.0 / (1.0 + np.square(lacks / FAR)), 1.0)
        weight = np.where(lying > 0.0, flat * np.sqrt(lying) / LYING_SIGMA, 1.0 / SIGMA)
        towards = (sight * front[:, None])[counts] * weight[:, None]
        slope = between(posed, hand, bones, places, towards)
        residual = lacks * weight
        columns = np.concatenate([slope, residual[:, None]], axis=1)
        return PairRows(hand, FINGER_OF_BONE[bones], columns, np.square(residual) / flat)
