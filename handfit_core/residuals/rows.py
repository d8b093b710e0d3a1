"""Weighted residual rows, as terms give them to the solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class PointRows:
    """Residuals of keypoints, each touching one keypoint only."""

    residual: np.ndarray
    """(B, 21, c)"""
    jacobian: np.ndarray
    """(B, 21, c, 3) by the keypoint, metres, camera frame"""
    by_offset: np.ndarray | None = None
    """(B, 21, c, m) by the term's own m offsets, which are solved for beside the hand; None: it has none"""


@dataclass(frozen=True, eq=False)
class AngleRows:
    """Residuals of the pose, each touching one finger only."""

    residual: np.ndarray
    """(B, 5, c)"""
    jacobian: np.ndarray
    """(B, 5, c, 9) by the finger's anatomical angles, radians"""
