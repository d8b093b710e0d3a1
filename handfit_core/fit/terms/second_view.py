"""Reprojection error in a second camera, whose place and lens are known."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import POINTS, Rows
from handfit_core.hand_model.chain import Posed


def second_view(posed: Posed, seen: Observation) -> Rows:
    """Return two rows for each point: the pixels between its projection u = f x / z + c, of x = R p + t, in
    the second camera and where that camera saw it, over their expected error. `seen.second` must be there."""
    second = seen.second
    assert second is not None
    points = posed.points @ second.rotation.swapaxes(1, 2) + second.translation[:, None]
    inverse = 1.0 / np.maximum(points[..., 2:], TERMS.nearest)
    slope = points[..., :2] * inverse
    in_sigmas = second.focal[:, None] / second.pixel_sigma  # (B, 21, 2)
    by_place = np.zeros((*slope.shape, 3))
    by_place[..., [0, 1], [0, 1]] = in_sigmas * inverse
    by_place[..., 2] = -slope * in_sigmas * inverse
    columns = np.zeros((*slope.shape, 5))
    columns[..., :3] = by_place @ second.rotation[:, None]
    columns[..., 4] = slope * in_sigmas + (second.centre[:, None] - second.pixels) / second.pixel_sigma
    return Rows(POINTS, columns, np.zeros(slope.shape[:2], dtype=bool))
