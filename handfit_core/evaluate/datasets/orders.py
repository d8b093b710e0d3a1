"""The joint orders of all data sets, mapped to MediaPipe's 21 keypoints. They stand only here.

Each order is a tuple of 21 indices: keypoints[k] = points_of_the_set[ORDER[k]]. All are bijections.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.skeleton import FINGERS, KEYPOINT_SOURCE, NUM_KEYPOINTS, TIP_KEYPOINTS, Side

FREIHAND: Final = tuple(range(NUM_KEYPOINTS))
"""Wrist, then thumb to little finger, each from the palm outwards: MediaPipe's own order."""

HO3D: Final = KEYPOINT_SOURCE
"""MANO's 16 joints, then the fingertips from thumb to little finger."""

RHD: Final = (0, *(1 + 4 * finger + 3 - joint for finger in range(len(FINGERS)) for joint in range(4)))
"""Of one hand: wrist, then thumb to little finger, each from the tip to the palm."""

RHD_HANDS: Final[dict[Side, slice]] = {
    "left": slice(0, NUM_KEYPOINTS),
    "right": slice(NUM_KEYPOINTS, 2 * NUM_KEYPOINTS),
}
"""Which of RHD's 42 points belong to which hand."""

FINGERTIPS: Final = TIP_KEYPOINTS
"""keypoints[FINGERTIPS[i]] = tips[i]: EgoDexter and Dexter+Object name tips from thumb to little finger."""


def keypoints_of_tips(tips: np.ndarray) -> np.ndarray:
    """(5, D) fingertips -> (21, D) keypoints; all others NaN."""
    tips = np.asarray(tips, dtype=np.float64)
    keypoints = np.full((NUM_KEYPOINTS, tips.shape[1]), np.nan)
    keypoints[list(FINGERTIPS)] = tips
    return keypoints
