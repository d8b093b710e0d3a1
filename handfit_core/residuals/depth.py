"""Relative depth along the line of sight against the detector's z."""

from __future__ import annotations

import numpy as np

from handfit_core.residuals.rows import PointRows

NEAREST = 0.02
"""metres; a hand counts as no nearer than this, so that a wild step cannot divide by zero"""


def depth(
    points: np.ndarray,
    target: np.ndarray,
    sigma: np.ndarray,
    ray: np.ndarray,
    focal: np.ndarray,
    offset: np.ndarray,
) -> PointRows:
    """points (B, 21, 3) metres, camera frame; target (B, 21) and sigma (B, 21) in pixels; ray (B, 3) the unit
    line of sight; focal (B,) pixels; offset (B, 1) metres, the distance along the ray where target is zero.

    One row: r = f / offset (ray . x - offset) - target. The detector's depth has no zero of its own: the
    offset is solved for. It is the hand's distance too, which turns metres into pixels.
    """
    distance = np.maximum(offset, NEAREST)
    scale = (focal[:, None] / distance) / sigma  # (B, 21)
    along = (points @ ray[..., None])[..., 0]
    beyond = along - offset
    by_offset = -scale * np.where(offset > NEAREST, along / distance, 1.0)
    return PointRows(
        (beyond * scale - target / sigma)[..., None],
        scale[..., None, None] * ray[:, None, None, :],
        by_offset[..., None, None],
    )
