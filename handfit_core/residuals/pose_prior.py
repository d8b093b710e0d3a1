"""Distance of a finger's angles from what hands usually do."""

from __future__ import annotations

import torch

from handfit_core.residuals.rows import AngleRows


def pose_prior(angles: torch.Tensor, mean: torch.Tensor, whiten: torch.Tensor) -> AngleRows:
    """angles (B, 5, 9) radians; mean (5, 9); whiten (5, 9, 9), whose rows turn a deviation into independent
    units: the inverse of the Cholesky factor of its covariance. Nine rows: W (a - mean)."""
    residual = (whiten @ (angles - mean).unsqueeze(-1)).squeeze(-1)
    return AngleRows(residual, whiten.expand(len(angles), 5, 9, 9))
