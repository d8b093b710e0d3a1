"""Relative depth of the landmarks along the line of sight against the observed depth."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import POINTS, Rows
from handfit_core.hand_model.chain import Posed


def depth(posed: Posed, seen: Observation) -> Rows:
    """Return one row for each point: r = f / d (ray . x - d) - depth, with d the distance at which depth is
    zero.

    Observed depth has no zero of its own: d is solved for where `seen.depth_zero` does not give it. It is the
    hand's distance, too, which turns metres into pixels.
    """
    zero, free = posed.state.depth_zero[:, None], 1.0
    if seen.depth_zero is not None:
        free = np.isnan(seen.depth_zero)[:, None]
        zero = np.where(free, zero, seen.depth_zero[:, None])
    distance = np.maximum(zero, TERMS.nearest)
    scale = seen.focal.mean(axis=1)[:, None] / distance / seen.depth_sigma  # (B, 21)
    along = (posed.points @ seen.ray[..., None])[..., 0]
    columns = np.empty((*scale.shape, 1, 5))
    columns[..., 0, :3] = scale[..., None] * seen.ray[:, None]
    columns[..., 0, 3] = -scale * np.where(zero > TERMS.nearest, along / distance, 1.0) * free
    columns[..., 0, 4] = (along - zero) * scale - seen.depth / seen.depth_sigma
    return Rows(POINTS, columns, np.zeros(scale.shape, dtype=bool))
