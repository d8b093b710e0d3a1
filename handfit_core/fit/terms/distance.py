"""Deviation of the wrist's distance from the camera from that of the anchor."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.terms.rows import HAND, Rows
from handfit_core.hand_model.chain import PLACE, Posed


def distance(posed: Posed, seen: Observation) -> Rows:
    """Return one row for each hand: r = (w . s / |s|^2 - 1) / sigma, with the anchor s of the wrist w in
    `seen.anchor`.

    Only the distance along the line of sight is held; across it the wrist is free.
    """
    assert seen.anchor is not None
    start, sigma = seen.anchor.wrist, seen.anchor.distance_sigma
    slope = start / (np.square(start).sum(axis=1) * sigma)[:, None]
    rows = Rows.zeros(HAND, len(start), 1)
    rows.jacobian[:, 0, 0, PLACE] = slope
    rows.residual[:, 0, 0] = (posed.state.wrist * slope).sum(axis=1) - 1.0 / sigma
    return rows
