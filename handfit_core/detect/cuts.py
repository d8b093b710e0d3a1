"""Where a video changes to another shot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

FINENESS = 24
"""Pixels of a glance's longer side, about"""

CHANGED = 20.0
"""Mean difference of two glances, of 255, above which the picture may be of another shot"""

ALIKE = 0.6
"""Correlation of their brightness above which it is none for all that: a light went on"""


@dataclass(frozen=True, eq=False)
class Glance:
    """A picture as if seen for a moment."""

    pixels: np.ndarray
    """(h, w, 3) uint8: every so many of the picture's"""

    @classmethod
    def at(cls, rgb: np.ndarray) -> Self:
        """Of a picture (H, W, 3) uint8 RGB."""
        step = max(1, max(rgb.shape[:2]) // FINENESS)
        top, left = (min(step, side) // 2 for side in rgb.shape[:2])
        return cls(rgb[top::step, left::step].copy())

    def is_cut_from(self, before: Glance) -> bool:
        """Whether the picture before this one was of another shot."""
        here, there = (look.pixels.astype(np.float64) for look in (self, before))
        if np.abs(here - there).mean() < CHANGED:
            return False
        bright, other = (look.mean(axis=-1) - look.mean() for look in (here, there))
        size = float(np.sqrt((bright**2).sum() * (other**2).sum()))
        return float((bright * other).sum()) < ALIKE * size
