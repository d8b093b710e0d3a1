"""Distance of a finger's angles from what hands usually do."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.terms.rows import FINGERS, Rows
from handfit_core.hand_model.chain import Posed
from handfit_core.skeleton import Side

WEIGHT = 0.7


class PosePrior:
    """Nine rows for each finger: W (a - mean), whose squares are the Mahalanobis distance, times `WEIGHT`."""

    def __init__(self, mean: np.ndarray, covariance: np.ndarray, side: Side = "right") -> None:
        """mean (5, 9) radians and covariance (5, 9, 9) of right hands' angles."""
        if side == "left":
            sign = np.tile([-1.0, -1.0, 1.0], 3)  # twist and spread change theirs
            mean, covariance = mean * sign, covariance * sign[:, None] * sign
        self.mean = np.asarray(mean, dtype=np.float64)
        self._whiten = np.linalg.inv(np.linalg.cholesky(covariance)) * np.sqrt(WEIGHT)

    def __call__(self, posed: Posed, seen: Observation) -> Rows:  # noqa: ARG002 (a term)
        """The rows of B posed hands."""
        angles = posed.state.angles
        rows = Rows.zeros(FINGERS, len(angles), 9)
        rows.jacobian[...] = self._whiten
        rows.residual[...] = (self._whiten @ (angles - self.mean)[..., None])[..., 0]
        return rows
