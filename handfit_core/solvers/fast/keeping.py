"""Poses that hands are to stay near, softly. What is held exactly: `holding`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from handfit_core.solvers.fast.chain import Index


@dataclass(frozen=True, eq=False)
class Kept:
    """What B hands are to stay near, and how firmly; a sigma that is infinite keeps nothing."""

    wrist: np.ndarray
    """(B, 3) metres, camera frame, of which the distance counts"""
    distance_sigma: np.ndarray
    """(B,) as a part of that distance"""
    angles: np.ndarray
    """(B, 5, 9) radians, finger by finger"""
    angle_sigma: np.ndarray
    """(B, 5) radians"""
    limits_sigma: float | None = None
    """radians beyond what joints can do when they are pressed (`energy.PASSIVE_RANGE`), or beyond the kept
    angles where these go further, that cost as much as one sigma; None: as hands without a pose to keep have
    it"""

    def __getitem__(self, index: Index) -> Kept:
        """The hands of that index."""
        arrays = ("wrist", "distance_sigma", "angles", "angle_sigma")
        return replace(self, **{name: getattr(self, name)[index] for name in arrays})
