"""Deviation of a finger's angles from the pose that the hand is anchored to."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.terms.rows import FINGERS, Rows
from handfit_core.hand_model.chain import Posed


def near_pose(posed: Posed, seen: Observation) -> Rows:
    """Return nine rows for each finger: r = (a - anchor) / sigma, the difference of angles taken the shorter
    way round.

    `seen.anchor` must be there.
    """
    assert seen.anchor is not None
    angles = posed.state.angles
    weight = 1.0 / seen.anchor.angle_sigma[..., None]
    rows = Rows.zeros(FINGERS, len(angles), 9)
    np.einsum("...ii->...i", rows.jacobian)[...] = weight
    rows.residual[...] = (np.remainder(angles - seen.anchor.angles + np.pi, 2.0 * np.pi) - np.pi) * weight
    return rows
