"""The anatomy of the 15 finger joints: their axes, angles and ranges of motion.

Each joint has three axes in the flat pose, after manotorch (Yang et al. 2021): **twist** along the bone back
towards the wrist, **spread** towards the back of the hand, and **bend** = twist x spread. A positive bend
closes the hand. Angles are the intrinsic Euler angles XYZ about (twist, spread, bend) relative to the flat
pose, in radians.

The joint order is MANO's without the wrist: index, middle, little, ring, thumb, three each.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, Side
from handfit_core.geometry.rotations import euler_to_rotmat, rotmat_to_euler, rotmat_to_rotvec
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.files import OPEN_HAND

SPREAD, BEND, MIDDLE_BEND, LAST_BEND = 1, 2, 5, 8
"""Indices among a finger's nine angles: spread and bend of the knuckle, and the bends of the two joints
beyond it"""
LANDMARKS_FILE: Final = Path(__file__).parent / "data" / "landmarks.npz"
"""The file of the calibration: landmark offsets, and the pose prior that belongs to them"""


def anatomical_axes(model: HandModel) -> np.ndarray:
    """Return the axes of a model's 15 finger joints, model frame: rotations (15, 3, 3) whose columns are
    (twist, spread, bend).

    Taken from the mean shape; shape moves them by a degree or two at most.
    """
    shaped = model.shaped()
    return axes_of(shaped.joints, shaped.tips, model.side)


def axes_of(joints: np.ndarray, tips: np.ndarray, side: Side) -> np.ndarray:
    """Return the axes of a flat hand's 15 finger joints, model frame, as rotations (15, 3, 3) whose columns
    are (twist, spread, bend), from joints (16, 3) and fingertips (5, 3) in metres."""
    axes = np.empty((15, 3, 3))
    for finger, chain in FINGER_JOINTS.items():
        points = [*joints[list(chain)], tips[FINGERS.index(finger)]]
        for joint, here, beyond in zip(chain, points[:-1], points[1:], strict=True):
            axes[joint - 1] = _frame(here - beyond, _towards_back(finger, side))
    return axes


def _towards_back(finger: str, side: Side) -> np.ndarray:
    """Return the direction (3,), in the model frame, that leads roughly away from the palm; the thumb's is
    turned against the fingers'."""
    if finger != "thumb":
        return np.array([0.0, 1.0, 0.0])
    return np.array([1.0 if side == "right" else -1.0, 1.0, 1.0])


def _frame(twist: np.ndarray, towards_back: np.ndarray) -> np.ndarray:
    twist = twist / np.linalg.norm(twist)
    spread = towards_back - twist * (twist @ towards_back)
    spread /= np.linalg.norm(spread)
    return np.stack([twist, spread, np.cross(twist, spread)], axis=-1)


def anatomical_angles(rotmats: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the anatomical angles (..., 15, 3), twist, spread and bend in radians, of local joint rotations
    (..., 15, 3, 3) about axes (15, 3, 3)."""
    return rotmat_to_euler(np.swapaxes(axes, -1, -2) @ rotmats @ axes)


def rotmats_from_angles(angles: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return local joint rotations (..., 15, 3, 3), Rx(twist) Ry(spread) Rz(bend) about each joint's own axes
    (15, 3, 3), from anatomical angles (..., 15, 3) in radians: the inverse of `anatomical_angles`."""
    return axes @ euler_to_rotmat(np.asarray(angles, dtype=np.float64)) @ np.swapaxes(axes, -1, -2)


def relaxed_pose(model: HandModel) -> np.ndarray:
    """Return the hand_pose (45,) of a relaxed hand, axis-angle in radians: the mean of many detected hands'
    joint angles.

    The numbers come with the landmarks' calibration (data/landmarks.npz, pose_mean: five fingers in the order
    of `FINGERS`, three joints each of twist, spread, bend, for the right hand).
    """
    with np.load(LANDMARKS_FILE, allow_pickle=False) as arrays:
        by_finger = np.asarray(arrays["pose_mean"], dtype=np.float64).reshape(len(FINGERS), 3, 3)
    angles = np.empty((15, 3))
    for finger, rows in zip(FINGERS, by_finger, strict=True):
        angles[np.array(FINGER_JOINTS[finger]) - 1] = rows
    if model.side == "left":
        angles[:, :2] *= -1.0  # mirrored, as in `joint_limits`
    return rotmat_to_rotvec(rotmats_from_angles(angles, anatomical_axes(model))).reshape(45)


@dataclass(frozen=True, eq=False)
class JointLimits:
    """The active range of motion of the 15 finger joints: how far a person can move them without help."""

    lower: np.ndarray
    """(15, 3) radians: the least twist, spread and bend of each joint"""
    upper: np.ndarray
    """(15, 3) radians: the greatest twist, spread and bend of each joint"""


# Degrees, right hand. Bends: Bain et al. 2015, active range. The knuckles' spread of +-20 and the
# thumb's rotation of 17 are laid about the rest pose; hinges get the few degrees of play that real ones have
# too. Bain's totals of the thumb's flexion and abduction (53, 42), laid so, did not take its tip beyond the
# middle finger nor around a fist: fits of fists go to 48 and 28 where nothing holds them.
_BENDS: dict[str, tuple[tuple[float, float], ...]] = {
    "index": ((-13, 86), (-5, 102), (-5, 77)),
    "middle": ((-18, 92), (-7, 100), (-6, 85)),
    "ring": ((-20, 92), (-7, 104), (-5, 86)),
    "little": ((-25, 90), (-7, 99), (-6, 89)),
    "thumb": ((-20, 50), (-10, 55), (-15, 80)),
}


def joint_limits(side: Side, model: str = OPEN_HAND) -> JointLimits:
    """Return the range of every anatomical angle of a hand of that side, for the hand model of that name."""
    limits = np.empty((15, 3, 2))
    for finger, joints in FINGER_JOINTS.items():
        for place, (joint, bend) in enumerate(zip(joints, _BENDS[finger], strict=True)):
            if place > 0:
                twist, spread = ((-3.0, 3.0), (-5.0, 5.0))
            elif finger == "thumb":
                twist, spread = ((-8.5, 8.5), (-21.0, 30.0))
            else:
                twist, spread = ((-5.0, 5.0), (-20.0, 20.0))
            limits[joint - 1] = (twist, spread, bend)
    if model == OPEN_HAND:
        # Degrees by which the open hand's thumb spreads and bends farther: its metacarpal's flat pose is
        # turned more to the hand's back. Fits of fists go to 41 and 63 where nothing holds them
        limits[FINGER_JOINTS["thumb"][0] - 1, 1:, 1] += (9.0, 9.0)
    limits = np.radians(limits)
    if side == "left":
        # In a mirror image a bend keeps its sign about the mirrored axis, twist and spread change it.
        limits[:, :2] = -limits[:, :2, ::-1]
    return JointLimits(limits[..., 0], limits[..., 1])
