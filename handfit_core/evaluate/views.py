"""How the camera sees a hand's palm, from its labels alone."""

from __future__ import annotations

import math

import numpy as np

from handfit_core.skeleton import Side

_WRIST, _INDEX_KNUCKLE, _LITTLE_KNUCKLE = 0, 5, 17
EDGE_DEGREES = 30.0
"""The palm's plane within so many degrees of the line of sight is an edge."""


def view_of(joints_3d: np.ndarray, side: Side | None) -> str:
    """`palm`, `back`, `edge` or `unknown` for (21, 3) labels in the camera frame.

    The palm's plane is that of wrist, index knuckle and little finger's knuckle; `unknown` where one of
    them has no label or the side is not known.
    """
    wrist, index, little = joints_3d[[_WRIST, _INDEX_KNUCKLE, _LITTLE_KNUCKLE]]
    # Out of the palm, for a right hand.
    normal = np.cross(index - wrist, little - wrist)
    sight = (wrist + index + little) / 3.0
    size = np.linalg.norm(normal) * np.linalg.norm(sight)
    if side is None or not np.isfinite(size) or size == 0.0:
        return "unknown"
    towards_camera = -float(normal @ sight) / size * (1.0 if side == "right" else -1.0)
    if abs(towards_camera) < math.sin(math.radians(EDGE_DEGREES)):
        return "edge"
    return "palm" if towards_camera > 0.0 else "back"
