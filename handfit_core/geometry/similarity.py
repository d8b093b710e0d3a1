"""Rigid and similarity alignment of point sets (Umeyama 1991), in NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Similarity:
    """A similarity transform of points in space: x -> scale * rotation @ x + translation."""

    scale: float
    rotation: np.ndarray
    """(3, 3) rotation matrix, of determinant +1"""
    translation: np.ndarray
    """(3,) translation, in the unit of the transformed points"""

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Transform points (..., 3)."""
        return self.scale * np.asarray(points) @ self.rotation.T + self.translation

    def inverse(self) -> Similarity:
        """Return the transform that leads back."""
        rotation = self.rotation.T
        return Similarity(1.0 / self.scale, rotation, -rotation @ self.translation / self.scale)

    @property
    def matrix(self) -> np.ndarray:
        """The transform as a homogeneous matrix (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * self.rotation
        matrix[:3, 3] = self.translation
        return matrix


def laid_over(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotations (N, 3, 3) and scales (N,) that lay centred sources (N, K, 3) over centred targets
    (N, K, 3) with the least squared distance.

    Never mirror images: determinants are +1 even where a reflection would fit better. Points that are not
    finite get a meaningless rotation, and harm no other set.
    """
    # LAPACK raises on NaN.
    covariance = np.nan_to_num(np.swapaxes(target, 1, 2) @ source, posinf=0.0, neginf=0.0)
    u, singular, vt = np.linalg.svd(covariance)
    sign = np.ones_like(singular)
    sign[:, 2] = np.where(np.linalg.det(u @ vt) < 0.0, -1.0, 1.0)
    scale = (singular * sign).sum(axis=1) / np.maximum(np.square(source).sum(axis=(1, 2)), 1e-12)
    return (u * sign[:, None]) @ vt, scale


def align(source: np.ndarray, target: np.ndarray, *, with_scale: bool) -> Similarity:
    """Return the transform that brings `source` (K, 3) nearest to `target` (K, 3) in the least-squares sense,
    as `laid_over` does. Degenerate sets (all points equal) give the identity rotation and scale 1."""
    source, target = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    centred = source - source_mean
    rotations, scales = laid_over(centred[None], (target - target_mean)[None])
    rotation = rotations[0]
    scale = float(scales[0]) if with_scale else 1.0
    scale = scale or 1.0
    return Similarity(scale, rotation, target_mean - scale * rotation @ source_mean)
