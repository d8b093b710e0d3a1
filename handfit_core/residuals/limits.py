"""How far a finger's angles lie outside of what joints can do."""

from __future__ import annotations

import numpy as np

from handfit_core.residuals.rows import AngleRows

SPREAD, BEND = 1, 2
SPREAD_LEFT = 0.3
"""Of a knuckle's spread when it is bent by 90 degrees: collateral ligaments tighten"""


def limits(
    angles: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    sigma: float,
    knuckles: np.ndarray,
    more: np.ndarray | None = None,
) -> AngleRows:
    """angles (B, 5, 9) radians, finger by finger (twist, spread, bend) x 3; lower and upper (5, 9); sigma
    in radians; knuckles (5,) 1 where a finger's first joint is a knuckle whose spread shrinks with its
    bend (not the thumb's), else 0.

    Nine rows, zero inside the range: r = (a - upper) / sigma above, (a - lower) / sigma below. A knuckle's
    range of spread is scaled by 1 - (1 - SPREAD_LEFT) * bend / 90 degrees, bend within 0..90. `more`
    (B, 5, 9) radians widens every range on both sides; None: by nothing.
    """
    per_radian = (1.0 - SPREAD_LEFT) / (np.pi / 2) * knuckles
    bend = angles[..., BEND]
    within = np.clip(bend, 0.0, np.pi / 2)
    left = np.ones_like(angles)
    left[..., SPREAD] -= per_radian * within
    least, most = lower * left, upper * left
    if more is not None:
        least, most = least - more, most + more
    outside = angles - np.clip(angles, least, most)
    slope = (outside != 0.0) / sigma
    jacobian = slope[..., None] * np.eye(9)
    edge = np.where(outside[..., SPREAD] > 0, upper[:, SPREAD], lower[:, SPREAD])
    jacobian[..., SPREAD, BEND] = slope[..., SPREAD] * edge * per_radian * (bend == within)
    return AngleRows(outside / sigma, jacobian)
