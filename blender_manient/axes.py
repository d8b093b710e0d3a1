"""From MANO's and OpenCV's axes to Blender's, and the bones' own axes. They stand only here.

Four frames, all right-handed and in metres:

* **camera**: OpenCV's, x right, y down, z forward. Takes are in it.
* **world**: Blender's. The capture camera sits at its origin and looks along +Y, with Z up.
* **model**: MANO's flat hand. The right hand's fingers along -x (the left's along +x), back +y, thumb +z.
* **rest**: the armature's own space in Blender, where the flat hand lies like a T-pose's:
  the right hand's fingers along -X, back of the hand +Z, thumb -Y.

A **bone** frame has Y along the bone. A positive turn about X bends the bone towards the palm.
NumPy only, so that it can be tested without Blender.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_quat, rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import HandModel, ShapedHand
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, Side

WORLD_FROM_CAMERA: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""(x, y, z) -> (x, z, -y)"""

REST_FROM_MODEL: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""(x, y, z) -> (x, -z, y)"""

MIRROR_X: Final = np.diag([-1.0, 1.0, 1.0])
"""Left and right exchanged, in rest space as in the camera frame"""

BONE_SUFFIX: Final[dict[Side, str]] = {"right": ".R", "left": ".L"}
"""What Blender's mirror tools look for at the end of a bone's name."""

_UP_OF_FINGERS: Final = np.array([0.0, 1.0, 0.0])
"""Model frame: out of the back of the hand, for both sides"""
_UP_OF_THUMB: Final = np.array([1.0, 1.0, 1.0])
"""Model frame of the right hand: out of the thumb's nail (manotorch's rest axes)"""
_MIRROR: Final = np.array([-1.0, 1.0, 1.0])
"""What turns a direction of the right hand's model frame into the left hand's"""


def points_to_world(points: np.ndarray) -> np.ndarray:
    """(..., 3) metres in the camera frame -> (..., 3) metres in Blender's world."""
    return points @ WORLD_FROM_CAMERA.T


def points_to_rest(points: np.ndarray) -> np.ndarray:
    """(..., 3) metres in the model frame -> (..., 3) metres in the armature's rest space."""
    return points @ REST_FROM_MODEL.T


def bone_tails(shaped: ShapedHand) -> np.ndarray:
    """Where each of the 16 bones ends: (16, 3) metres in the model frame.

    A finger's bone ends at the next joint or at the fingertip, the wrist's at the middle knuckle.
    """
    tails = np.empty((NUM_JOINTS, 3))
    tails[0] = shaped.joints[FINGER_JOINTS["middle"][0]]
    for finger, tip in zip(FINGERS, shaped.tips, strict=True):
        first, second, third = FINGER_JOINTS[finger]
        tails[first], tails[second], tails[third] = shaped.joints[second], shaped.joints[third], tip
    return tails


def bone_frames(shaped: ShapedHand, side: Side) -> np.ndarray:
    """Each bone's axes in rest space: (16, 3, 3) rotations with the bone's X, Y and Z in columns.

    X is the axis about which a finger bends towards the palm: "back along the bone" x "up", made
    perpendicular to the bone. The left hand's frames are the right hand's as Blender mirrors bones,
    so that poses can be pasted from one to the other.
    """
    along = _unit(bone_tails(shaped) - shaped.joints)
    up = np.tile(_UP_OF_FINGERS, (NUM_JOINTS, 1))
    up[list(FINGER_JOINTS["thumb"])] = _UP_OF_THUMB if side == "right" else _UP_OF_THUMB * _MIRROR
    bend = _unit(np.cross(-along, up))
    axes = np.stack([bend, along, np.cross(bend, along)], axis=-1)  # (16, 3, 3), columns X Y Z
    return REST_FROM_MODEL @ axes


def bone_pose(
    shaped: ShapedHand,
    frames: np.ndarray,
    global_orient: np.ndarray,
    hand_pose: np.ndarray,
    transl: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """What to set on the pose bones so that the rig stands where the take has the hand.

    frames (16, 3, 3) from `bone_frames`; global_orient (T, 3) and hand_pose (T, 45) axis-angle in
    radians, model frame to camera frame; transl (T, 3) metres, camera frame.
    Returns quaternions (T, 16, 4) as (w, x, y, z), each relative to its bone's rest, and the wrist
    bone's locations (T, 3) in metres along its own axes.
    """
    fingers = rotvec_to_rotmat(np.reshape(hand_pose, (-1, NUM_JOINTS - 1, 3)))
    rest_rotation = np.empty((len(fingers), NUM_JOINTS, 3, 3))
    rest_rotation[:, 1:] = REST_FROM_MODEL @ fingers @ REST_FROM_MODEL.T
    rest_rotation[:, 0] = WORLD_FROM_CAMERA @ rotvec_to_rotmat(global_orient) @ REST_FROM_MODEL.T
    local = np.swapaxes(frames, -1, -2) @ rest_rotation @ frames

    wrist = shaped.joints[0]
    moved = points_to_world(wrist + transl) - points_to_rest(wrist)
    return rotmat_to_quat(local), moved @ frames[0]


def pose_from_bones(
    shaped: ShapedHand, frames: np.ndarray, quats: np.ndarray, locations: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The inverse of `bone_pose`: what a take would say of a rig that stands like this.

    frames (16, 3, 3); quats (T, 16, 4) as (w, x, y, z); locations (T, 3) metres. Returns global_orient
    (T, 3) and hand_pose (T, 45) axis-angle in radians, and transl (T, 3) metres, camera frame.
    """
    rest_rotation = frames @ quat_to_rotmat(quats) @ np.swapaxes(frames, -1, -2)
    global_orient = rotmat_to_rotvec(WORLD_FROM_CAMERA.T @ rest_rotation[:, 0] @ REST_FROM_MODEL)
    hand_pose = rotmat_to_rotvec(REST_FROM_MODEL.T @ rest_rotation[:, 1:] @ REST_FROM_MODEL)

    wrist = shaped.joints[0]
    moved = locations @ frames[0].T + points_to_rest(wrist)
    return global_orient, hand_pose.reshape(-1, 3 * (NUM_JOINTS - 1)), moved @ WORLD_FROM_CAMERA - wrist


def mirrored_bones(source: np.ndarray, target: np.ndarray, quats: np.ndarray) -> np.ndarray:
    """A pose for the hand of the other side, as a mirror at x = 0 of rest space shows it.

    source, target (16, 3, 3): `bone_frames` of the hand that has the pose and of the one that gets it;
    quats (..., 16, 4) as (w, x, y, z). A mirror M turns a rotation R into M R M, so that about the
    target's bones it is D R_bone D^T with D = B_target^T M B_source. Since det D = -1 the quaternion's
    vector turns by -D.
    """
    turn = -np.swapaxes(target, -1, -2) @ MIRROR_X @ source
    return np.concatenate([quats[..., :1], (turn @ quats[..., 1:, None])[..., 0]], axis=-1)


def turned_bones(source: np.ndarray, target: np.ndarray, quats: np.ndarray) -> np.ndarray:
    """The same rotations about other bone axes.

    source, target (16, 3, 3): the axes before and after; quats (..., 16, 4) as (w, x, y, z). About a bone's
    axes B a rotation R of rest space is B^T R B, so the quaternion's vector turns by B_target^T B_source.
    """
    turn = np.swapaxes(target, -1, -2) @ source
    return np.concatenate([quats[..., :1], (turn @ quats[..., 1:, None])[..., 0]], axis=-1)


def corrective_offsets(model: HandModel, frames: np.ndarray) -> np.ndarray:
    """The pose blend shapes per element of a bone's own rotation: (15, 3, 3, V, 3) metres, rest space.

    MANO adds posedirs * (R - I), with R the joint's rotation in model axes. Drivers see the bone's
    rotation R_bone = B^T R B instead, B being the bone's axes in the model frame. Since
    R - I = B (R_bone - I) B^T, the offset of element (k, l) of R_bone - I is the sum over a, b of
    B[a, k] B[b, l] posedirs[a, b]. Row j is joint j + 1.
    """
    basis = REST_FROM_MODEL.T @ frames[1:]  # (15, 3, 3)
    posedirs = model.posedirs.reshape(-1, 3, NUM_JOINTS - 1, 3, 3)
    turned = np.einsum("vcjab,jak,jbl->jklvc", posedirs, basis, basis, optimize=True)
    return points_to_rest(turned)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
