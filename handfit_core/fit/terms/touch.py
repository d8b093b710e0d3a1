"""Fingertips that are seen to touch do so with their skins."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.fit.meeting import TIPS
from handfit_core.fit.observation import Observation
from handfit_core.fit.terms.rows import PairRows, between
from handfit_core.hand_model.chain import Posed
from handfit_core.hand_model.surface import FINGER_OF_BONE, PAIRS, Surface

SIGMA: Final = 0.0015
"""metres between skins that cost as much as one sigma"""
FAR: Final = 0.02
"""metres; tips that stay farther apart were taken for touching by mistake, and pull hardly"""

_PAIRS: Final = [int(np.flatnonzero((tips == PAIRS).all(axis=1))[0]) for tips in TIPS]


class Touch:
    """One row for each pair of `seen.meeting.touching`: the gap g between their skins, with Geman and
    McClure's kernel, s / (1 + s (SIGMA / FAR)^2) of s = (g / SIGMA)^2."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __call__(self, posed: Posed, seen: Observation) -> PairRows:
        """The rows of B posed hands."""
        assert seen.meeting is not None
        touching = np.zeros((len(posed.points), len(PAIRS)))
        touching[:, _PAIRS] = seen.meeting.touching
        near = self.surface.gaps(self.surface.capsules(posed), *np.nonzero(touching))
        slope = between(posed, near.hand, near.bones, near.places, near.towards / SIGMA)
        squared = np.square(near.gap / SIGMA)
        flat = 1.0 / (1.0 + squared * (SIGMA / FAR) ** 2)
        sure = touching[near.hand, near.pair]
        columns = np.concatenate([slope, near.gap[:, None] / SIGMA], axis=1)
        columns *= (flat * np.sqrt(sure))[:, None]  # the kernel's slope is flat ** 2
        return PairRows(near.hand, FINGER_OF_BONE[near.bones], columns, sure * squared * flat)
