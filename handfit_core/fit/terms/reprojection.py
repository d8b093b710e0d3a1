"""Reprojection error of the landmarks: the pixels between where they project and where they were seen."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import POINTS, Rows
from handfit_core.hand_model.chain import Posed


def reprojection(posed: Posed, seen: Observation) -> Rows:
    """Return two rows for each point: the pixels between its projection u = f x / z + c and where it was
    seen, over their expected error. Pinned points are certain: their rows have no robust kernel."""
    points = posed.points
    inverse = 1.0 / np.maximum(points[..., 2:], TERMS.nearest)
    slope = points[..., :2] * inverse
    in_sigmas = seen.focal[:, None] / seen.pixel_sigma  # (B, 21, 2)
    by_place = in_sigmas * inverse
    pinned = np.zeros(points.shape[:2], dtype=bool) if seen.pinned is None else seen.pinned
    columns = np.zeros((*slope.shape, 5))
    columns[..., 0, 0], columns[..., 1, 1] = by_place[..., 0], by_place[..., 1]
    columns[..., 2] = -slope * by_place
    columns[..., 4] = slope * in_sigmas + (seen.centre[:, None] - seen.pixels) / seen.pixel_sigma
    return Rows(POINTS, columns, pinned)
