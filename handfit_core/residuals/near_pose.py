"""How far a finger's angles have left a pose that is to be kept."""

from __future__ import annotations

import numpy as np

from handfit_core.residuals.rows import AngleRows


def near_pose(angles: np.ndarray, start: np.ndarray, sigma: np.ndarray) -> AngleRows:
    """angles (B, 5, 9) and start (B, 5, 9) radians; sigma (B, 5) radians by finger, infinite where nothing is
    kept. Nine rows: the shorter way round from `start`."""
    away = np.remainder(angles - start + np.pi, 2.0 * np.pi) - np.pi
    weight = (1.0 / sigma)[..., None]
    return AngleRows(away * weight, weight[..., None] * np.eye(9))
