"""How far a finger's angles have left a pose that is to be kept."""

from __future__ import annotations

import math

import torch

from handfit_core.residuals.rows import AngleRows


def near_pose(angles: torch.Tensor, start: torch.Tensor, sigma: torch.Tensor) -> AngleRows:
    """angles (B, 5, 9) and start (B, 5, 9) radians; sigma (B, 5) radians by finger, infinite where nothing is
    kept. Nine rows: the shorter way round from `start`."""
    turn = 2.0 * math.pi
    away = torch.remainder(angles - start + math.pi, turn) - math.pi
    weight = sigma.reciprocal()[..., None]
    identity = torch.eye(9, dtype=angles.dtype, device=angles.device)
    return AngleRows(away * weight, weight[..., None] * identity)
