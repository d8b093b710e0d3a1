"""Where keypoints project against where the detector saw them, in pixels."""

from __future__ import annotations

import torch

from handfit_core.residuals.rows import PointRows

NEAREST = 0.02
"""metres; points are projected as if no nearer than this, so that a wild step cannot divide by zero"""


def reprojection(
    points: torch.Tensor, pixels: torch.Tensor, sigma: torch.Tensor, focal: torch.Tensor, centre: torch.Tensor
) -> PointRows:
    """points (B, 21, 3) metres, camera frame; pixels (B, 21, 2) and sigma (B, 21, 2) their expected errors;
    focal (B, 2) and centre (B, 2) pixels. Two rows: u = f x / z + c."""
    inverse = points[..., 2:].clamp_min(NEAREST).reciprocal()
    slope = points[..., :2] * inverse
    in_sigmas = focal[:, None] / sigma  # (B, 21, 2)
    residual = slope * in_sigmas + (centre[:, None] - pixels) / sigma
    identity = torch.eye(2, dtype=points.dtype, device=points.device).expand(*slope.shape, 2)
    directions = torch.cat([identity, -slope.unsqueeze(-1)], dim=-1)  # (B, 21, 2, 3)
    return PointRows(residual, directions * (in_sigmas * inverse).unsqueeze(-1))
