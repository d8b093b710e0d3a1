"""What the solver fits to: landmarks of B detections with their expected errors, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from handfit_core.solvers.fast.chain import Index
from handfit_core.solvers.fast.keeping import Kept


@dataclass(frozen=True, eq=False)
class Observation:
    """Landmarks of B pictures of one model's hand. Pixels, camera frame."""

    pixels: np.ndarray
    """(B, 21, 2)"""
    pixel_sigma: np.ndarray
    """(B, 21, 2) expected errors, pixels"""
    depth: np.ndarray
    """(B, 21) along the line of sight about its mean, in pixels at the hand's distance"""
    depth_sigma: np.ndarray
    """(B, 21) pixels"""
    ray: np.ndarray
    """(B, 3) unit line of sight"""
    focal: np.ndarray
    """(B, 2) pixels"""
    centre: np.ndarray
    """(B, 2) pixels"""
    pinned: np.ndarray | None = None
    """(B, 21) bool: pixels that are true, put there by a person: their cost grows with the square, so that no
    number of other landmarks can outvote them. None: there are none"""
    world: np.ndarray | None = None
    """(B, 21, 3) world landmarks in metres; None where they are in `depth` already"""
    kept: Kept | None = None
    """Poses that the hands are to stay near; None: there are none"""

    def __len__(self) -> int:
        return len(self.pixels)

    def select(self, index: Index) -> Observation:
        """The detections of that index."""
        return replace(
            self, **{f.name: v[index] for f in fields(self) if (v := getattr(self, f.name)) is not None}
        )
