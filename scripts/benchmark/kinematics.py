"""From anatomical angles to poses and keypoints of one shaped hand, in batches.

Poses are drawn for a right hand; a left hand gets the mirror image. Angles are (..., 15, 3) twist,
spread and bend in radians, joints in MANO's order without the wrist (`handfit_core.hand_model.anatomy`).
"""

from __future__ import annotations

import functools

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, Side, keypoints_from_joints
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model import HandModel, forward_kinematics, load_model
from handfit_core.hand_model.anatomy import JointLimits, anatomical_axes, joint_limits, rotmats_from_angles

MIRROR_ROTVEC = np.array([1.0, -1.0, -1.0])
"""Mirroring in x turns a rotation vector (a, b, c) into (a, -b, -c)"""


@functools.cache
def model_of(side: Side) -> HandModel:
    """The bundled open hand, read once."""
    return load_model(None, side)


@functools.cache
def right_axes() -> np.ndarray:
    """(15, 3, 3) anatomical axes of the right hand."""
    return anatomical_axes(model_of("right"))


@functools.cache
def first_limits() -> JointLimits:
    """The ranges when the first kinds of poses were drawn: their seeds give the same poses for ever."""
    limits = joint_limits("right")
    upper = limits.upper.copy()
    upper[FINGER_JOINTS["thumb"][0] - 1, 1:] = np.radians([21.0, 33.0])
    return JointLimits(limits.lower, upper)


def within_limits(angles: np.ndarray) -> np.ndarray:
    """Clip (..., 15, 3) angles to `first_limits`."""
    return np.clip(angles, first_limits().lower, first_limits().upper)


def hand_pose_from_angles(angles: np.ndarray, side: Side) -> np.ndarray:
    """(..., 15, 3) angles of a right hand -> (..., 45) axis-angle of that hand or its mirror image."""
    rotvecs = rotmat_to_rotvec(rotmats_from_angles(angles, right_axes()))
    if side == "left":
        rotvecs = rotvecs * MIRROR_ROTVEC
    return rotvecs.reshape(*angles.shape[:-2], 45)


class RightHand:
    """The right hand of one shape; its wrist joint does not move."""

    def __init__(self, betas: np.ndarray) -> None:
        """`betas` (10,)."""
        self.betas = betas
        shaped = model_of("right").shaped(betas)
        self._joints = shaped.joints
        self._distal = [FINGER_JOINTS[finger][2] for finger in FINGERS]
        self._tips = shaped.tips - shaped.joints[self._distal]
        mean = model_of("right").shaped()
        self.scale = float(
            np.linalg.norm(self._joints[4] - self._joints[0])
            / np.linalg.norm(mean.joints[4] - mean.joints[0])
        )
        """Palm length over the mean hand's"""

    def keypoints(self, angles: np.ndarray) -> np.ndarray:
        """(..., 15, 3) angles -> (..., 21, 3) metres, model frame. Fingertips ride on their last bones."""
        batch = angles.shape[:-2]
        root = np.broadcast_to(np.eye(3), (*batch, 1, 3, 3))
        rotmats = np.concatenate([root, rotmats_from_angles(angles, right_axes())], axis=-3)
        rotations, joints = forward_kinematics(rotmats, self._joints)
        tips = joints[..., self._distal, :] + np.einsum(
            "...fab,fb->...fa", rotations[..., self._distal, :, :], self._tips
        )
        return keypoints_from_joints(joints, tips)
