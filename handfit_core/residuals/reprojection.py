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
    scale = focal[:, None] * inverse / sigma  # (B, 21, 2)
    slope = points[..., :2] * inverse
    residual = slope * focal[:, None] + (centre[:, None] - pixels)
    diagonal = torch.diag_embed(scale)
    return PointRows(residual / sigma, torch.cat([diagonal, (-scale * slope).unsqueeze(-1)], dim=-1))
