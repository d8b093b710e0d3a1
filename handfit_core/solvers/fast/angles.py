"""Anatomical angles of joint rotations, and how increments change them.

A joint's rotation in its anatomical axes is Rx(twist) Ry(spread) Rz(bend). An increment on the right,
Q <- Q exp(w), changes the angles by

    d twist  = (cos b wx - sin b wy) / cos s
    d spread = sin b wx + cos b wy
    d bend   = wz - sin s d twist
"""

from __future__ import annotations

import torch

_FLATTEST = 0.2
"""cos(spread) counts as at least this: no hand comes near the pole"""


def angles_of(local: torch.Tensor) -> torch.Tensor:
    """(..., 3, 3) rotations in anatomical axes -> (..., 3) twist, spread, bend in radians."""
    twist = torch.atan2(-local[..., 1, 2], local[..., 2, 2])
    spread = torch.asin(local[..., 0, 2].clamp(-1.0, 1.0))
    bend = torch.atan2(-local[..., 0, 1], local[..., 0, 0])
    return torch.stack([twist, spread, bend], dim=-1)


def rates_of(angles: torch.Tensor) -> torch.Tensor:
    """(..., 3) angles -> (..., 3, 3) derivatives of the angles (rows) by the increment (columns)."""
    _, spread, bend = angles.unbind(-1)
    sin_b, cos_b = bend.sin(), bend.cos()
    zero, one = torch.zeros_like(bend), torch.ones_like(bend)
    per_cos = spread.cos().clamp_min(_FLATTEST).reciprocal()
    tx, ty = cos_b * per_cos, -sin_b * per_cos
    sin_s = spread.sin()
    rows = [tx, ty, zero, sin_b, cos_b, zero, -sin_s * tx, -sin_s * ty, one]
    return torch.stack(rows, dim=-1).view(*angles.shape, 3)


def rotation_of(angles: torch.Tensor) -> torch.Tensor:
    """(..., 3) twist, spread, bend -> (..., 3, 3): Rx Ry Rz."""
    (st, ss, sb), (ct, cs, cb) = angles.sin().unbind(-1), angles.cos().unbind(-1)
    rows = [
        cs * cb, -cs * sb, ss,
        ct * sb + st * ss * cb, ct * cb - st * ss * sb, -st * cs,
        st * sb - ct * ss * cb, st * cb + ct * ss * sb, ct * cs,
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).view(*angles.shape, 3)
