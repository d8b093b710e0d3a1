"""Parts that touch do so with their skins: fingertips that are seen to, and what a person says."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.fit.meeting import TIPS
from handfit_core.fit.observation import Observation
from handfit_core.fit.terms.rows import PairRows, between
from handfit_core.hand_model.chain import Posed
from handfit_core.hand_model.surface import FINGER_OF_BONE, PAIRS, Near, Surface

SIGMA: Final = 0.0015
"""metres between skins that cost as much as one sigma"""
FAR: Final = 0.02
"""metres; tips that stay farther apart were taken for touching by mistake, and pull hardly"""
CERTAIN_SIGMA: Final = 0.0001
"""metres, of what a person says, which is no mistake however far it is"""

_PAIRS: Final = np.array([int(np.flatnonzero((tips == PAIRS).all(axis=1))[0]) for tips in TIPS])


class Touch:
    """One row for each pair of `seen.meeting.touching`: the gap g between their skins, with Geman and
    McClure's kernel, s / (1 + s (SIGMA / FAR)^2) of s = (g / SIGMA)^2. One for each of `seen.touches`:
    g / CERTAIN_SIGMA."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __call__(self, posed: Posed, seen: Observation) -> PairRows:
        """The rows of B posed hands."""
        capsules = self.surface.capsules(posed)
        found: list[PairRows] = []
        if seen.meeting is not None:
            hand, pair = np.nonzero(seen.meeting.touching)
            near = self.surface.gaps(capsules, hand, _PAIRS[pair])
            flat = 1.0 / (1.0 + np.square(near.gap / FAR))
            sure = seen.meeting.touching[hand, pair]
            # The kernel's slope is flat ** 2.
            found.append(_rows(posed, near, SIGMA, flat * np.sqrt(sure), 1.0 / flat))
        if seen.touches is not None:
            hand, point = np.nonzero(np.isfinite(seen.touches))
            points = np.stack([point, seen.touches[hand, point].astype(int)], axis=1)
            near = self.surface.gaps_at(capsules, hand, points)
            found.append(_rows(posed, near, CERTAIN_SIGMA, np.ones(len(hand)), np.ones(len(hand))))
        return PairRows(
            *(np.concatenate([getattr(r, n) for r in found]) for n in PairRows.__dataclass_fields__)
        )


def _rows(posed: Posed, near: Near, sigma: float, weight: np.ndarray, excess: np.ndarray) -> PairRows:
    """Gaps in sigmas times weights (K,), and costs that are `excess` (K,) times their squares."""
    slope = between(posed, near.hand, near.bones, near.places, near.towards / sigma)
    columns = np.concatenate([slope, near.gap[:, None] / sigma], axis=1) * weight[:, None]
    return PairRows(near.hand, FINGER_OF_BONE[near.bones], columns, excess * np.square(columns[:, -1]))
