"""Contact between the skins of two parts: pinches that are seen, and touches that an artist asks for."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.self_contact import PINCH_BONES
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import PairRows, between
from handfit_core.hand_model.chain import Posed
from handfit_core.hand_model.surface import FINGER_OF_BONE, PAIRS, Near, Surface

_PAIRS: Final = np.array([int(np.flatnonzero((tips == PAIRS).all(axis=1))[0]) for tips in PINCH_BONES])


class Contact:
    """The gaps between skins that touch: one row for each pair of `seen.self_contact.pinch`, of the gap g
    between its skins, with Geman and McClure's kernel, s / (1 + s (touch_sigma / robust_scale)^2) of s = (g /
    touch_sigma)^2; and one row for each of `seen.touches`: g / user_touch_sigma."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __call__(self, posed: Posed, seen: Observation) -> PairRows:
        """Return the rows of B posed hands, for those whose parts touch."""
        capsules = self.surface.capsules(posed)
        found: list[PairRows] = []
        if seen.self_contact is not None:
            hand, pair = np.nonzero(seen.self_contact.pinch)
            near = self.surface.gaps(capsules, hand, _PAIRS[pair])
            robust = 1.0 / (1.0 + np.square(near.gap / TERMS.robust_scale))
            confidence = seen.self_contact.pinch[hand, pair]
            # The kernel's slope is flat ** 2.
            found.append(_rows(posed, near, TERMS.touch_sigma, robust * np.sqrt(confidence), 1.0 / robust))
        if seen.touches is not None:
            hand, point = np.nonzero(np.isfinite(seen.touches))
            points = np.stack([point, seen.touches[hand, point].astype(int)], axis=1)
            near = self.surface.gaps_at(capsules, hand, points)
            found.append(_rows(posed, near, TERMS.user_touch_sigma, np.ones(len(hand)), np.ones(len(hand))))
        return PairRows.concatenate(found)


def _rows(posed: Posed, near: Near, sigma: float, weight: np.ndarray, excess: np.ndarray) -> PairRows:
    """Return rows of K gaps in sigmas times `weight` (K,), whose costs are `excess` (K,) times their
    squares."""
    slope = between(posed, near.hand, near.bones, near.places, near.towards / sigma)
    columns = np.concatenate([slope, near.gap[:, None] / sigma], axis=1) * weight[:, None]
    return PairRows(near.hand, FINGER_OF_BONE[near.bones], columns, excess * np.square(columns[:, -1]))
