"""Rigid and similarity alignment of point sets (Umeyama 1991), in NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Similarity:
    """x -> scale * rotation @ x + translation."""

    scale: float
    rotation: np.ndarray
    """(3, 3), determinant +1"""
    translation: np.ndarray
    """(3,)"""

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Transform (..., 3) points."""
        return self.scale * np.asarray(points) @ self.rotation.T + self.translation

    def inverse(self) -> Similarity:
        """The transform back."""
        rotation = self.rotation.T
        return Similarity(1.0 / self.scale, rotation, -rotation @ self.translation / self.scale)

    @property
    def matrix(self) -> np.ndarray:
        """(4, 4) homogeneous matrix."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * self.rotation
        matrix[:3, 3] = self.translation
        return matrix


def align(source: np.ndarray, target: np.ndarray, *, with_scale: bool) -> Similarity:
    """The transform that brings (N, 3) `source` nearest to (N, 3) `target` in the least-squares sense.

    Never a mirror image: the rotation's determinant is +1 even where a reflection would fit better.
    Degenerate sets (all points equal) give the identity rotation and scale 1.
    """
    source, target = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    centred = source - source_mean
    u, singular, vt = np.linalg.svd((target - target_mean).T @ centred)
    sign = np.ones(3)
    sign[2] = np.sign(np.linalg.det(u @ vt)) or 1.0
    rotation = (u * sign) @ vt
    scale = 1.0
    variance = float(np.sum(centred**2))
    if with_scale and variance > 0.0:
        scale = float(np.sum(singular * sign)) / variance or 1.0
    return Similarity(scale, rotation, target_mean - scale * rotation @ source_mean)
