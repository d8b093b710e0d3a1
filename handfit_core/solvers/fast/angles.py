"""Anatomical angles of joint rotations, and how increments change them.

A joint's rotation in its anatomical axes is Rx(twist) Ry(spread) Rz(bend). An increment on the right,
Q <- Q exp(w), changes the angles by

    d twist  = (cos b wx - sin b wy) / cos s
    d spread = sin b wx + cos b wy
    d bend   = wz - sin s d twist
"""

from __future__ import annotations

import numpy as np

_FLATTEST = 0.2
"""cos(spread) counts as at least this: no hand comes near the pole"""


def angles_of(local: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations in anatomical axes -> (..., 3) twist, spread, bend in radians."""
    twist = np.arctan2(-local[..., 1, 2], local[..., 2, 2])
    spread = np.arcsin(np.clip(local[..., 0, 2], -1.0, 1.0))
    bend = np.arctan2(-local[..., 0, 1], local[..., 0, 0])
    return np.stack([twist, spread, bend], axis=-1)


def rates_of(angles: np.ndarray) -> np.ndarray:
    """(..., 3) angles -> (..., 3, 3) derivatives of the angles (rows) by the increment (columns)."""
    spread, bend = angles[..., 1], angles[..., 2]
    sine, cosine = np.sin(bend), np.cos(bend)
    per_cos = 1.0 / np.maximum(np.cos(spread), _FLATTEST)
    rates = np.zeros((*angles.shape, 3))
    rates[..., 0, 0], rates[..., 0, 1] = cosine * per_cos, -sine * per_cos
    rates[..., 1, 0], rates[..., 1, 1] = sine, cosine
    rates[..., 2, :2] = -np.sin(spread)[..., None] * rates[..., 0, :2]
    rates[..., 2, 2] = 1.0
    return rates


def rotation_of(angles: np.ndarray) -> np.ndarray:
    """(..., 3) twist, spread, bend -> (..., 3, 3): Rx Ry Rz."""
    (st, ss, sb), (ct, cs, cb) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    rows = [
        cs * cb, -cs * sb, ss,
        ct * sb + st * ss * cb, ct * cb - st * ss * sb, -st * cs,
        st * sb - ct * ss * cb, st * cb + ct * ss * sb, ct * cs,
    ]  # fmt: skip
    return np.stack(rows, axis=-1).reshape(*angles.shape, 3)
