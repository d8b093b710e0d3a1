"""Crossings of the thumb with fingers in the picture, and which of both lies deeper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

CROSSING: Final = np.array([(a, b) for a in (1, 2) for b in range(3, 15)])
"""(Q, 2) bones of the thumb and of the fingers, three each and thumb first, that can lie over each other"""
CROSSING_STARTS: Final = 1 + 4 * (CROSSING // 3) + CROSSING % 3
"""(Q, 2) the keypoints at which the bones of `CROSSING` begin; each ends at the keypoint that follows"""


@dataclass(frozen=True, eq=False)
class Crossing:
    """The crossings, in the picture, of the Q pairs of bones in `CROSSING`, of B hands."""

    along: np.ndarray
    """(B, Q, 2) how far along each of the two bones it is nearest to the other one, from 0 at its beginning
    to 1 at its end"""
    across: np.ndarray
    """(B, Q) the distance of the two bones where they are nearest to each other, in the unit of the
    keypoints"""
    crossed: np.ndarray
    """(B, Q) bool: true for pairs of bones that cross"""

    @classmethod
    def of(cls, points: np.ndarray) -> Self:
        """Find the crossings of B hands from their keypoints (B, 21, 2) in the picture."""
        starts = points[:, CROSSING_STARTS]
        ends = points[:, CROSSING_STARTS + 1]
        along, across = _nearest(starts[:, :, 0], ends[:, :, 0], starts[:, :, 1], ends[:, :, 1])
        size = np.ptp(points, axis=1).max(axis=1)
        # Distance in the picture up to which two bones cross, in parts of the hand's size
        return cls(along, across, across <= 0.08 * np.maximum(size, 1e-9)[:, None])

    def deeper(self, depth: np.ndarray) -> np.ndarray:
        """Return by how much the second bone of each pair lies deeper than the first, (B, Q), where they are
        nearest to each other, from the keypoints' depths (B, 21) and in their unit."""
        starts, ends = depth[:, CROSSING_STARTS], depth[:, CROSSING_STARTS + 1]
        there = starts * (1.0 - self.along) + ends * self.along
        return np.asarray(there[..., 1] - there[..., 0])


@np.errstate(all="ignore")
def _nearest(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find where segments a-b and c-d, of ends (..., 2), are nearest to each other: how far along both
    (..., 2), 0..1, and how near (...,)."""
    ab, cd, off = b - a, d - c, c - a

    def foot(point: np.ndarray, start: np.ndarray, axis: np.ndarray) -> np.ndarray:
        return np.clip(((point - start) * axis).sum(axis=-1) / np.square(axis).sum(axis=-1), 0.0, 1.0)

    zero, one = np.zeros(a.shape[:-1]), np.ones(a.shape[:-1])
    tried = [(zero, foot(a, c, cd)), (one, foot(b, c, cd)), (foot(c, a, ab), zero), (foot(d, a, ab), one)]
    turn = ab[..., 0] * cd[..., 1] - ab[..., 1] * cd[..., 0]
    s = (off[..., 0] * cd[..., 1] - off[..., 1] * cd[..., 0]) / turn
    t = (off[..., 0] * ab[..., 1] - off[..., 1] * ab[..., 0]) / turn
    inside = (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    tried.append((np.where(inside, s, 0.0), np.where(inside, t, foot(a, c, cd))))
    shares = np.stack([np.stack(pair, axis=-1) for pair in tried])
    there = a + shares[..., :1] * ab - c - shares[..., 1:] * cd
    distance = np.linalg.norm(there, axis=-1)
    best = distance.argmin(axis=0)[None]
    return np.take_along_axis(shares, best[..., None], axis=0)[0], np.take_along_axis(distance, best, axis=0)[
        0
    ]
