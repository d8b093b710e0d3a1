"""Interpenetration of a hand's fingers, thumb and palm."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.terms.rows import PairRows, between
from handfit_core.hand_model.chain import Posed
from handfit_core.hand_model.surface import FINGER_OF_BONE, Surface

SIGMA: Final = 0.001
"""metres of penetration depth that cost as much as one sigma"""
EDIT_SIGMA: Final = 0.00025
"""metres, in place of SIGMA where an artist corrects a pose: pins are surer than landmarks, and would push
parts into each other"""
COMPRESSION: Final = 0.00075
"""metres by which flesh is compressed where parts touch"""


class Interpenetration:
    """One row for each pair of parts that overlap: r = (depth - COMPRESSION) / SIGMA, or / EDIT_SIGMA."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __call__(self, posed: Posed, seen: Observation) -> PairRows:
        """The rows of those of B posed hands whose parts overlap."""
        near = self.surface.near(self.surface.capsules(posed), within=-COMPRESSION)
        # The places are the nearest ones: to first order the gap does not change as they move on.
        corrected = seen.kept is not None and np.isfinite(seen.kept.limits_sigma)[near.hand]
        sigma = np.where(corrected, EDIT_SIGMA, SIGMA)
        slope = between(posed, near.hand, near.bones, near.places, -near.towards / sigma[..., None])
        residual = -(near.gap + COMPRESSION) / sigma
        columns = np.concatenate([slope, residual[:, None]], axis=1)
        return PairRows(near.hand, FINGER_OF_BONE[near.bones], columns, np.square(residual))
