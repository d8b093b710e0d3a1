"""Distance of a finger's angles from what hands usually do."""

from __future__ import annotations

import numpy as np

from handfit_core.residuals.rows import AngleRows


def pose_prior(angles: np.ndarray, mean: np.ndarray, whiten: np.ndarray) -> AngleRows:
    """angles (B, 5, 9) radians; mean (5, 9); whiten (5, 9, 9), whose rows turn a deviation into independent
    units: the inverse of the Cholesky factor of its covariance. Nine rows: W (a - mean)."""
    residual = (whiten @ (angles - mean)[..., None])[..., 0]
    return AngleRows(residual, np.broadcast_to(whiten, (len(angles), 5, 9, 9)))
