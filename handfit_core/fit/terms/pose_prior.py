"""Mahalanobis distance of a finger's angles from a Gaussian of usual poses."""

from __future__ import annotations

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import FINGERS, Rows
from handfit_core.hand_model.chain import Posed


class PosePrior:
    """The distance of fingers from usual poses: nine rows for each finger, W (a - mean), whose squares are
    the Mahalanobis distance, times `pose_weight`, or `pinned_pose_weight` where an artist has pinned
    points."""

    def __init__(self, mean: np.ndarray, covariance: np.ndarray, side: Side = "right") -> None:
        """Take the mean (5, 9), in radians, and the covariance (5, 9, 9) of right hands' angles, for hands of
        `side`."""
        if side == "left":
            sign = np.tile([-1.0, -1.0, 1.0], 3)  # twist and spread change theirs
            mean, covariance = mean * sign, covariance * sign[:, None] * sign
        self.mean = np.asarray(mean, dtype=np.float64)
        self._whiten = np.linalg.inv(np.linalg.cholesky(covariance))

    def __call__(self, posed: Posed, seen: Observation) -> Rows:
        """Return the rows of B posed hands: nine for each finger."""
        angles = posed.state.angles
        pinned = np.zeros(len(angles), dtype=bool) if seen.pinned is None else seen.pinned.any(axis=1)
        if seen.anchor is not None:
            pinned = pinned | np.isfinite(seen.anchor.limits_sigma)  # a finger that goes for its pin alone
        whiten = (
            np.sqrt(np.where(pinned, TERMS.pinned_pose_weight, TERMS.pose_weight))[:, None, None, None]
            * self._whiten
        )
        rows = Rows.zeros(FINGERS, len(angles), 9)
        rows.jacobian[...] = whiten
        rows.residual[...] = (whiten @ (angles - self.mean)[..., None])[..., 0]
        return rows
