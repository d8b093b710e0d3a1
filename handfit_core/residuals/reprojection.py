"""Where keypoints project against where the detector saw them, in pixels."""

from __future__ import annotations

import numpy as np

from handfit_core.residuals.rows import PointRows

NEAREST = 0.02
"""metres; points are projected as if no nearer than this, so that a wild step cannot divide by zero"""


def reprojection(
    points: np.ndarray, pixels: np.ndarray, sigma: np.ndarray, focal: np.ndarray, centre: np.ndarray
) -> PointRows:
    """points (B, 21, 3) metres, camera frame; pixels (B, 21, 2) and sigma (B, 21, 2) their expected errors;
    focal (B, 2) and centre (B, 2) pixels. Two rows: u = f x / z + c."""
    inverse = 1.0 / np.maximum(points[..., 2:], NEAREST)
    slope = points[..., :2] * inverse
    in_sigmas = focal[:, None] / sigma  # (B, 21, 2)
    residual = slope * in_sigmas + (centre[:, None] - pixels) / sigma
    directions = np.zeros((*slope.shape, 3))
    directions[..., 0, 0] = directions[..., 1, 1] = 1.0
    directions[..., 2] = -slope
    return PointRows(residual, directions * (in_sigmas * inverse)[..., None])
