"""People's bodies in pictures, by MediaPipe's body networks: no more of them than arms need."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.arrays import array, array_dataclass

NUM_BODY_POINTS: Final = 33
"""of MediaPipe's body, in its order; the subject's left has odd numbers from 11 on"""
SHOULDERS, ELBOWS, WRISTS = (
    {"left": 11, "right": 12},
    {"left": 13, "right": 14},
    {"left": 15, "right": 16},
)


@array_dataclass
class BodyTrack:
    """One person over T frames, as the networks see them; NaN in frames without."""

    keypoints: np.ndarray = array("T", NUM_BODY_POINTS, 2, finite="present")
    """pixels"""
    visibility: np.ndarray = array("T", NUM_BODY_POINTS, finite="present")
    """Probability that a point is in the picture and not hidden, 0..1"""
    world: np.ndarray = array("T", NUM_BODY_POINTS, 3, finite="present")
    """metres about the middle of the hips, axes of the camera frame. Directions can be used, lengths not"""
    score: np.ndarray = array("T")
    """The detector's, 0..1; NaN in frames in which it was not asked"""
    present: np.ndarray = array("T", kind="b")
