"""The last joint of a finger follows the one before: it cannot be bent alone."""

from __future__ import annotations

import numpy as np

from handfit_core.residuals.rows import AngleRows

MIDDLE_BEND, LAST_BEND = 5, 8
"""Among a finger's nine angles"""


def coupling(angles: np.ndarray, slope: np.ndarray, offset: np.ndarray, sigma: np.ndarray) -> AngleRows:
    """angles (B, 5, 9) radians; slope (5,), offset (5,) radians and sigma (5,) radians, infinite where a
    finger has no such rule (the thumb). One row: last - (slope * middle - offset)."""
    weight = 1.0 / sigma
    residual = (angles[..., LAST_BEND] - slope * angles[..., MIDDLE_BEND] + offset) * weight
    jacobian = np.zeros((5, 9))
    jacobian[:, MIDDLE_BEND] = -slope * weight
    jacobian[:, LAST_BEND] = weight
    return AngleRows(residual[..., None], np.broadcast_to(jacobian[:, None], (len(angles), 5, 1, 9)))
