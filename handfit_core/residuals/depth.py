"""Relative depth along the line of sight against the detector's z."""

from __future__ import annotations

import torch

from handfit_core.residuals.rows import PointRows


def depth(
    points: torch.Tensor,
    target: torch.Tensor,
    sigma: torch.Tensor,
    ray: torch.Tensor,
    pixels_per_metre: torch.Tensor,
    offset: torch.Tensor,
) -> PointRows:
    """points (B, 21, 3) metres, camera frame; target (B, 21) and sigma (B, 21) in pixels; ray (B, 3) the unit
    line of sight; pixels_per_metre (B,) at the hand, taken as constant; offset (B, 1) metres, the distance
    along the ray at which target is zero.

    One row: r = p (ray . x - offset) - target. The detector's depth has no zero of its own: the offset
    is solved for.
    """
    along = (points @ ray.unsqueeze(-1)).squeeze(-1) - offset
    scale = pixels_per_metre[:, None] / sigma
    jacobian = scale[..., None, None] * ray[:, None, None, :]
    by_offset = -scale[..., None, None]
    return PointRows((along * scale - target / sigma).unsqueeze(-1), jacobian, by_offset)
