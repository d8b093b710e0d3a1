"""Interpenetration of a hand's fingers, thumb and palm."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import PairRows, between
from handfit_core.hand_model.chain import Posed
from handfit_core.hand_model.surface import FINGER_OF_BONE, Surface


class Interpenetration:
    """The overlap of a hand's parts: one row for each pair that overlaps, r = (depth - compression) /
    penetration_sigma, or / edit_penetration_sigma where an artist corrects the pose."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __call__(self, posed: Posed, seen: Observation) -> PairRows:
        """Return the rows of B posed hands, for those whose parts overlap."""
        near = self.surface.near(self.surface.capsules(posed), within=-TERMS.compression)
        # The places are the nearest ones: to first order the gap does not change as they move on.
        corrected = seen.anchor is not None and np.isfinite(seen.anchor.limits_sigma)[near.hand]
        sigma = np.where(corrected, TERMS.edit_penetration_sigma, TERMS.penetration_sigma)
        slope = between(posed, near.hand, near.bones, near.places, -near.towards / sigma[..., None])
        residual = -(near.gap + TERMS.compression) / sigma
        columns = np.concatenate([slope, residual[:, None]], axis=1)
        return PairRows(near.hand, FINGER_OF_BONE[near.bones], columns, np.square(residual))
