"""The last joint of a finger follows the one before: it cannot be bent alone."""

from __future__ import annotations

import torch

from handfit_core.residuals.rows import AngleRows

MIDDLE_BEND, LAST_BEND = 5, 8
"""Among a finger's nine angles"""


def coupling(
    angles: torch.Tensor, slope: torch.Tensor, offset: torch.Tensor, sigma: torch.Tensor
) -> AngleRows:
    """angles (B, 5, 9) radians; slope (5,), offset (5,) radians and sigma (5,) radians, infinite where a
    finger has no such rule (the thumb). One row: last - (slope * middle - offset)."""
    weight = sigma.reciprocal()
    residual = (angles[..., LAST_BEND] - slope * angles[..., MIDDLE_BEND] + offset) * weight
    jacobian = torch.zeros(5, 9, dtype=angles.dtype, device=angles.device)
    jacobian[:, MIDDLE_BEND] = -slope * weight
    jacobian[:, LAST_BEND] = weight
    return AngleRows(residual.unsqueeze(-1), jacobian[:, None].expand(len(angles), 5, 1, 9))
