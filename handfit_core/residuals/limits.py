"""How far a finger's angles lie outside of what joints can do."""

from __future__ import annotations

import torch

from handfit_core.residuals.rows import AngleRows

SPREAD, BEND = 1, 2
SPREAD_LEFT = 0.3
"""Of a knuckle's spread when it is bent by 90 degrees: collateral ligaments tighten"""


def limits(
    angles: torch.Tensor,
    lower: torch.Tensor,
    upper: torch.Tensor,
    sigma: float,
    knuckles: torch.Tensor,
    more: torch.Tensor | None = None,
) -> AngleRows:
    """angles (B, 5, 9) radians, finger by finger (twist, spread, bend) x 3; lower and upper (5, 9); sigma
    in radians; knuckles (5,) 1 where a finger's first joint is a knuckle whose spread shrinks with its
    bend (not the thumb's), else 0.

    Nine rows, zero inside the range: r = (a - upper) / sigma above, (a - lower) / sigma below. A knuckle's
    range of spread is scaled by 1 - (1 - SPREAD_LEFT) * bend / 90 degrees, bend within 0..90. `more`
    (B, 5, 9) radians widens every range on both sides; None: by nothing.
    """
    per_radian = (1.0 - SPREAD_LEFT) / (torch.pi / 2) * knuckles
    bend = angles[..., BEND]
    within = bend.clamp(0.0, torch.pi / 2)
    left = torch.ones_like(angles)
    left[..., SPREAD] -= per_radian * within
    least, most = lower * left, upper * left
    if more is not None:
        least, most = least - more, most + more
    outside = angles - angles.clamp(least, most)
    slope = outside.sign().abs() / sigma
    jacobian = torch.diag_embed(slope)
    edge = torch.where(outside[..., SPREAD] > 0, upper[:, SPREAD], lower[:, SPREAD])
    jacobian[..., SPREAD, BEND] = slope[..., SPREAD] * edge * per_radian * (bend == within)
    return AngleRows(outside / sigma, jacobian)
