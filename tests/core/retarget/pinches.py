"""Captured hands whose thumb touches another fingertip."""

from __future__ import annotations

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, Side
from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import anatomical_axes, rotmats_from_angles
from handfit_core.hand_model.axes import REST_FROM_MODEL

PINCHES = {
    "index": (4, 26, 16, 20, 51, 55, 25),
    "middle": (0, 44, 13, 27, 47, 70, 23),
    "ring": (1, 56, 23, 20, 46, 71, 13),
}
"""degrees: the thumb's root's spread and bend, the bends of its other joints, and those of the finger's"""
HELD = slice(30, 40)
"""Frames of `pinching` in which tips touch"""


def bends(side: Side, finger: str | None) -> np.ndarray:
    """(15, 3) radians: a half open hand, or one that pinches."""
    angles = np.zeros((NUM_JOINTS - 1, 3))
    for other in FINGERS[1:]:
        angles[np.array(FINGER_JOINTS[other]) - 1, 2] = np.radians([25.0, 30.0, 20.0])
    angles[np.array(FINGER_JOINTS["thumb"]) - 1, 2] = np.radians([5.0, 10.0, 10.0])
    if finger is not None:
        spread, *thumb = np.radians(PINCHES[finger][:4])
        angles[np.array(FINGER_JOINTS["thumb"]) - 1, 2] = thumb
        angles[FINGER_JOINTS["thumb"][0] - 1, 1] = spread if side == "right" else -spread
        angles[np.array(FINGER_JOINTS[finger]) - 1, 2] = np.radians(PINCHES[finger][4:])
    return angles


def turns_of(side: Side, angles: np.ndarray) -> np.ndarray:
    """(T, 16, 3, 3) of angles (T, 15, 3)."""
    turns = np.broadcast_to(np.eye(3), (len(angles), NUM_JOINTS, 3, 3)).copy()
    fingers = rotmats_from_angles(angles, anatomical_axes(load_model(None, side)))
    turns[:, 1:] = REST_FROM_MODEL @ fingers @ REST_FROM_MODEL.T
    return turns


def pinching(side: Side, finger: str) -> np.ndarray:
    """(70, 16, 3, 3) half open, closed in half a second, held, and opened again."""
    share = np.interp(np.arange(70), [15, 30, 39, 54], [0.0, 1.0, 1.0, 0.0])[:, None, None]
    return turns_of(side, (1.0 - share) * bends(side, None) + share * bends(side, finger))
