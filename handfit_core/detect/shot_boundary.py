"""Shot-boundary detection: where a video cuts to another shot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

THUMBNAIL_SIDE_PX = 24
"""About the longer side of a thumbnail"""

MIN_CUT_DIFFERENCE = 20.0
"""Mean absolute difference of two thumbnails, of 255, from which on there may be a cut between them"""

MAX_CUT_CORRELATION = 0.6
"""Correlation of the thumbnails' brightness from which on there is no cut for all that: a light went on"""


@dataclass(frozen=True, eq=False)
class Thumbnail:
    """A picture's colors at some 400 evenly spread pixels."""

    pixels: np.ndarray
    """(h, w, 3) uint8 RGB"""

    @classmethod
    def of(cls, rgb: np.ndarray) -> Self:
        """Sample a picture (H, W, 3) uint8 RGB at every n-th row and column."""
        step = max(1, max(rgb.shape[:2]) // THUMBNAIL_SIDE_PX)
        top, left = (min(step, side) // 2 for side in rgb.shape[:2])
        return cls(rgb[top::step, left::step].copy())

    def is_cut_from(self, before: Thumbnail) -> bool:
        """Whether there is a shot boundary between the picture before and this one."""
        here, there = (each.pixels.astype(np.float64) for each in (self, before))
        if np.abs(here - there).mean() < MIN_CUT_DIFFERENCE:
            return False
        bright, other = (pixels.mean(axis=-1) - pixels.mean() for pixels in (here, there))
        norm = float(np.sqrt((bright**2).sum() * (other**2).sum()))
        return float((bright * other).sum()) < MAX_CUT_CORRELATION * norm
