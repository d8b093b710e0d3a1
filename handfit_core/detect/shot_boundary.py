"""Shot-boundary detection: where a video cuts to another shot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np


@dataclass(frozen=True, eq=False)
class Thumbnail:
    """A picture's colors at some 400 evenly spread pixels."""

    pixels: np.ndarray
    """(h, w, 3) uint8 RGB"""

    @classmethod
    def of(cls, rgb: np.ndarray) -> Self:
        """Sample a picture (H, W, 3) uint8 RGB at every n-th row and column."""
        step = max(1, max(rgb.shape[:2]) // 24)  # about 24 pixels on the longer side
        top, left = (min(step, side) // 2 for side in rgb.shape[:2])
        return cls(rgb[top::step, left::step].copy())

    def is_cut_from(self, before: Thumbnail) -> bool:
        """Return True if there is a shot boundary between the earlier picture `before` and this one."""
        here, there = (each.pixels.astype(np.float64) for each in (self, before))
        # Mean absolute difference of two thumbnails, of 255, from which on there may be a cut between them
        if np.abs(here - there).mean() < 20.0:
            return False
        bright, other = (pixels.mean(axis=-1) - pixels.mean() for pixels in (here, there))
        norm = float(np.sqrt((bright**2).sum() * (other**2).sum()))
        # From this correlation of the brightness on, there is no cut for all that: a light went on
        return float((bright * other).sum()) < 0.6 * norm
