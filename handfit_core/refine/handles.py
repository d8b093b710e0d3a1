"""The points that an artist drags: a model's 21 landmarks, in NumPy, for Blender too."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model.data import HandModel, forward_kinematics
from handfit_core.hand_model.landmarks import LANDMARK_BONES, bone_axes, detector_landmarks
from handfit_core.skeleton import KEYPOINT_SOURCE, NUM_JOINTS

_BONES = list(LANDMARK_BONES)


def landmark_points(
    model: HandModel,
    betas: np.ndarray,
    global_orient: np.ndarray,
    hand_pose: np.ndarray,
    transl: np.ndarray,
) -> np.ndarray:
    """(T, 21, 3) where the detector sees its points on a posed hand, metres, camera frame.

    betas (10,), global_orient (T, 3), hand_pose (T, 45), transl (T, 3). These are the solver's
    points (`solvers.fast.chain`), each fixed to one bone. They are not `model.keypoints`: the detector's
    fingertips lie 2 to 9 mm short of the mesh's.
    """
    shaped = model.shaped(betas)
    rest = np.concatenate([shaped.joints, shaped.tips])[list(KEYPOINT_SOURCE)]
    arms = rest - shaped.joints[_BONES] + _offsets(model)
    pose = np.concatenate([global_orient, hand_pose], axis=-1)
    rotmats = rotvec_to_rotmat(pose.reshape(*pose.shape[:-1], NUM_JOINTS, 3))
    turned, places = forward_kinematics(rotmats, shaped.joints)
    points = places[..., _BONES, :] + np.einsum("...kab,kb->...ka", turned[..., _BONES, :, :], arms)
    return points + np.asarray(transl)[..., None, :]


@lru_cache(maxsize=8)
def _offsets(model: HandModel) -> np.ndarray:
    """(21, 3) metres, from the model's keypoints to its landmarks in the flat pose."""
    return np.einsum("kab,kb->ka", bone_axes(model)[_BONES], detector_landmarks().in_metres(model))
