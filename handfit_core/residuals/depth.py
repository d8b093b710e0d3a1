"""Relative depth along the line of sight against the detector's z."""

from __future__ import annotations

import torch

from handfit_core.residuals.rows import PointRows

NEAREST = 0.02
"""metres; a hand counts as no nearer than this, so that a wild step cannot divide by zero"""


def depth(
    points: torch.Tensor,
    target: torch.Tensor,
    sigma: torch.Tensor,
    ray: torch.Tensor,
    focal: torch.Tensor,
    offset: torch.Tensor,
) -> PointRows:
    """points (B, 21, 3) metres, camera frame; target (B, 21) and sigma (B, 21) in pixels; ray (B, 3) the unit
    line of sight; focal (B,) pixels; offset (B, 1) metres, the distance along the ray where target is zero.

    One row: r = f / offset (ray . x - offset) - target. The detector's depth has no zero of its own: the
    offset is solved for. It is the hand's distance too, which turns metres into pixels.
    """
    distance = offset.clamp_min(NEAREST)
    scale = (focal[:, None] / distance) / sigma  # (B, 21)
    along = (points @ ray.unsqueeze(-1)).squeeze(-1)
    beyond = along - offset
    by_offset = -scale * torch.where(offset > NEAREST, along / distance, 1.0)
    return PointRows(
        (beyond * scale - target / sigma).unsqueeze(-1),
        scale[..., None, None] * ray[:, None, None, :],
        by_offset[..., None, None],
    )
