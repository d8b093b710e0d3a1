"""Ordinal depth: which of two parts that cross in the picture is nearer to the camera."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import PairRows, between
from handfit_core.geometry.crossing import CROSSING
from handfit_core.hand_model.chain import Posed
from handfit_core.hand_model.surface import FINGER_OF_BONE, Surface


class OrdinalDepth:
    """The order in depth of crossing parts: one row for each crossing of `seen.self_contact`, r = (separation
    - distance in the observed order) / order_sigma where that is positive. Parts farther apart than that cost
    nothing, unless they are in contact: then r / contact_sigma with Geman and McClure's kernel, as in
    `contact`."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __call__(self, posed: Posed, seen: Observation) -> PairRows:
        """Return the rows of B posed hands, for those whose parts cross in the picture."""
        assert seen.self_contact is not None
        hand, pair = np.nonzero(seen.self_contact.front)
        front, along = seen.self_contact.front[hand, pair], seen.self_contact.along[hand, pair]
        bones = CROSSING[pair]
        ends = self.surface.capsules(posed).ends[hand[:, None], bones]  # (K, 2 bones, 2 ends, 3)
        places = ends[:, :, 0] + along[..., None] * (ends[:, :, 1] - ends[:, :, 0])
        sight = seen.ray[hand]
        behind = ((places[:, 0] - places[:, 1]) * sight).sum(axis=1) * front
        violation = seen.self_contact.separation[hand, pair] + behind
        in_contact = np.where(violation < 0.0, seen.self_contact.in_contact[hand, pair], 0.0)
        counts = (violation > 0.0) | (in_contact > 0.0)
        hand, bones, places, violation, in_contact = (
            v[counts] for v in (hand, bones, places, violation, in_contact)
        )
        robust = np.where(in_contact > 0.0, 1.0 / (1.0 + np.square(violation / TERMS.robust_scale)), 1.0)
        weight = np.where(
            in_contact > 0.0, robust * np.sqrt(in_contact) / TERMS.contact_sigma, 1.0 / TERMS.order_sigma
        )
        towards = (sight * front[:, None])[counts] * weight[:, None]
        slope = between(posed, hand, bones, places, towards)
        residual = violation * weight
        columns = np.concatenate([slope, residual[:, None]], axis=1)
        return PairRows(hand, FINGER_OF_BONE[bones], columns, np.square(residual) / robust)
