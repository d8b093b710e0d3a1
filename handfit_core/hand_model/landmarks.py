"""The places on a hand model where the detector sees its 21 keypoints.

A landmark is not a joint: MediaPipe's points lie where its annotators clicked, MANO's joints inside the hand.
Each landmark is attached to one bone, at an offset from the model's own keypoint. Offsets are kept in
anatomical axes (twist, spread, bend: back along the bone, towards the back of the hand, and across) in parts
of the hand's length, so that one calibration serves every model in MANO's format.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, NUM_KEYPOINTS
from handfit_core.hand_model.anatomy import LANDMARKS_FILE, anatomical_axes
from handfit_core.hand_model.data import HandModel


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Offsets of a model's 21 landmarks from its keypoints, in the flat pose."""

    offsets: np.ndarray
    """(21, 3) in the bone's anatomical axes (the wrist's: the model frame's, as a right hand's), as parts
    of the length from wrist to middle knuckle"""

    def in_metres(self, model: HandModel) -> np.ndarray:
        """Return the offsets (21, 3) in metres, in the bones' anatomical axes of `model` (the wrist's: in the
        model frame)."""
        offsets = self.offsets * hand_length(model)
        if model.side == "left":
            # In a mirror image what points along the bone and towards its back stays, what points across
            # turns round; the model frame's x turns round.
            offsets = offsets * np.array([1.0, 1.0, -1.0])
            offsets[0] *= np.array([-1.0, 1.0, -1.0])
        return offsets


def hand_length(model: HandModel) -> float:
    """Return the metres from the wrist to the middle knuckle of a model's mean shape."""
    joints = model.shaped().joints
    return float(np.linalg.norm(joints[FINGER_JOINTS["middle"][0]] - joints[0]))


@lru_cache(maxsize=8)
def bone_axes(model: HandModel) -> np.ndarray:
    """Return the anatomical axes of every joint in the flat pose as columns (16, 3, 3); those of the wrist
    are the model frame's. They are cached, and read-only."""
    axes = np.concatenate([np.eye(3)[None], anatomical_axes(model)])
    axes.setflags(write=False)
    return axes


NO_OFFSETS: Final = Landmarks(np.zeros((NUM_KEYPOINTS, 3)))
"""Landmarks without offsets, which are the model's own keypoints"""


@lru_cache(maxsize=1)
def detector_landmarks() -> Landmarks:
    """Load the landmarks that MediaPipe's hand landmarker sees, as calibrated by the training at commit
    2ca2c99."""
    with np.load(LANDMARKS_FILE, allow_pickle=False) as arrays:
        return Landmarks(arrays["offsets"])
