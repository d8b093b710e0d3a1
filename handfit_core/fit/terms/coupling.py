"""The last joint of a finger follows the one before: it cannot be bent alone."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import FINGERS, Rows
from handfit_core.hand_model.anatomy import LAST_BEND, MIDDLE_BEND
from handfit_core.hand_model.chain import Posed

SLOPE = np.array([0.0, 0.87, 0.79, 0.73, 0.73])
OFFSET = np.radians([0.0, 25.0, 18.0, 20.5, 20.5])
"""(5,) and (5,) radians: the last joint's bend is SLOPE times the middle one's less OFFSET. Measured on
index, middle and ring finger; the little finger's is taken as the ring's"""
_WEIGHT = np.array([0.0, 1.0, 1.0, 1.0, 1.0]) / TERMS.coupling_sigma
"""(5,) weight of the rule per radian, by finger; 0 for the thumb, which has no such rule"""


def coupling(posed: Posed, seen: Observation) -> Rows:  # noqa: ARG001 (a term)
    """Return one row for each finger: last - (slope * middle - offset), of the bends of its last and middle
    joints, over the expected deviation."""
    angles = posed.state.angles
    rows = Rows.zeros(FINGERS, len(angles), 1)
    rows.jacobian[..., 0, MIDDLE_BEND], rows.jacobian[..., 0, LAST_BEND] = -SLOPE * _WEIGHT, _WEIGHT
    rows.residual[..., 0] = (angles[..., LAST_BEND] - SLOPE * angles[..., MIDDLE_BEND] + OFFSET) * _WEIGHT
    return rows
