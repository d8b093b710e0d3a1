"""From MANO's and OpenCV's axes to Blender's, and the axes of a rig's bones. They stand only here.

Four frames, all right-handed and in metres:

* **camera**: OpenCV's, x right, y down, z forward. Takes are in it.
* **world**: Blender's. The capture camera sits at its origin and looks along +Y, with Z up.
* **model**: MANO's flat hand. The right hand's fingers along -x (the left's along +x), back +y, thumb +z.
* **rest**: the armature's own space in Blender, where the flat hand lies like a T-pose's:
  the right hand's fingers along -X, back of the hand +Z, thumb -Y.

A **bone** frame has Y along the bone. A positive turn about X bends the bone towards the palm.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, Side
from handfit_core.geometry.rotations import (
    quat_to_rotmat,
    rotmat_to_quat,
    rotmat_to_rotvec,
    rotvec_to_rotmat,
    units,
)
from handfit_core.hand_model.data import HandModel, ShapedHand

WORLD_FROM_CAMERA: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""The rotation from the camera frame to Blender's world: (x, y, z) -> (x, z, -y)"""

REST_FROM_MODEL: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The rotation from the model frame to rest space: (x, y, z) -> (x, -z, y)"""

MIRROR_X: Final = np.diag([-1.0, 1.0, 1.0])
"""The mirror that exchanges left and right, in rest space as in the camera frame"""

_UP_OF_THUMB: Final = np.array([1.0, 1.0, 1.0])
"""(3,) direction out of the thumb's nail in the model frame of the right hand (manotorch's rest axes)"""

ANATOMICAL_IN_BONE: Final = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""(3, 3) the (twist, spread, bend) axes of a finger joint, see `anatomy`, in the frame of its bone: -Y, -Z
and X as columns"""


def points_to_world(points: np.ndarray) -> np.ndarray:
    """Return points (..., 3), metres in the camera frame, in Blender's world, also in metres."""
    return points @ WORLD_FROM_CAMERA.T


def camera_in_world(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Return the matrix_world (4, 4), in metres, of Blender's camera that sees points x of the capture
    camera's frame at rotation (3, 3) x + translation (3,). Blender's cameras look along their own -Z, with Y
    up."""
    matrix = np.eye(4)
    matrix[:3, :3] = WORLD_FROM_CAMERA @ rotation.T @ np.diag([1.0, -1.0, -1.0])
    matrix[:3, 3] = points_to_world(-rotation.T @ translation)
    return matrix


def points_to_rest(points: np.ndarray) -> np.ndarray:
    """Return points (..., 3), metres in the model frame, in the armature's rest space, also in metres."""
    return points @ REST_FROM_MODEL.T


def bone_tails(shaped: ShapedHand) -> np.ndarray:
    """Return where each of the 16 bones ends: (16, 3) metres in the model frame.

    A finger's bone ends at the next joint or at the fingertip, the wrist's at the middle knuckle.
    """
    tails = np.empty((NUM_JOINTS, 3))
    tails[0] = shaped.joints[FINGER_JOINTS["middle"][0]]
    for finger, tip in zip(FINGERS, shaped.tips, strict=True):
        first, second, third = FINGER_JOINTS[finger]
        tails[first], tails[second], tails[third] = shaped.joints[second], shaped.joints[third], tip
    return tails


def bone_frames(shaped: ShapedHand, side: Side) -> np.ndarray:
    """Return each bone's axes in rest space: rotations (16, 3, 3) with the bone's X, Y and Z in columns.

    X is the axis about which a finger bends towards the palm: "back along the bone" x "up", made
    perpendicular to the bone. The left hand's frames are the right hand's as Blender mirrors bones, so that
    poses can be pasted from one to the other.
    """
    along = units(bone_tails(shaped) - shaped.joints)
    # Out of the back of the hand, for both sides; the thumb's is mirrored for the left one.
    up = np.tile(np.array([0.0, 1.0, 0.0]), (NUM_JOINTS, 1))
    up[list(FINGER_JOINTS["thumb"])] = _UP_OF_THUMB * (1.0 if side == "right" else np.array([-1.0, 1.0, 1.0]))
    bend = units(np.cross(-along, up))
    axes = np.stack([bend, along, np.cross(bend, along)], axis=-1)  # (16, 3, 3), columns X Y Z
    return REST_FROM_MODEL @ axes


@dataclass(frozen=True, eq=False)
class RestPose:
    """The 16 bones of a rig at rest, in MANO's joint order, and the frames that their poses are told in.

    Poses of bones are quaternions (N, 16, 4) as (w, x, y, z), each relative to its bone's rest, and the wrist
    bone's locations (N, 3) in metres along its own axes.
    """

    side: Side
    frames: np.ndarray
    """(16, 3, 3) each bone's axes in rest space, with X, Y and Z in columns"""
    wrist: np.ndarray
    """(3,) metres in rest space: where the wrist bone begins"""
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) metres: where the origin of rest space lies, seen from that of the world that the capture camera
    stands in"""

    def to_bones(
        self, shaped: ShapedHand, global_orient: np.ndarray, hand_pose: np.ndarray, transl: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose of the bones, with which the rig stands where a take has the hand: quaternions
        (N, 16, 4) and the wrist's locations (N, 3) in metres.

        `shaped` is the hand that the rig has; global_orient (N, 3) and hand_pose (N, 45) axis-angle in
        radians, model frame to camera frame; transl (N, 3) metres, camera frame.
        """
        fingers = rotvec_to_rotmat(np.reshape(hand_pose, (-1, NUM_JOINTS - 1, 3)))
        turned = np.empty((len(fingers), NUM_JOINTS, 3, 3))
        turned[:, 1:] = REST_FROM_MODEL @ fingers @ REST_FROM_MODEL.T
        turned[:, 0] = WORLD_FROM_CAMERA @ rotvec_to_rotmat(global_orient) @ REST_FROM_MODEL.T
        local = np.swapaxes(self.frames, -1, -2) @ turned @ self.frames
        wrist = shaped.joints[0]
        moved = points_to_world(wrist + transl) - self.origin - points_to_rest(wrist)
        return rotmat_to_quat(local), moved @ self.frames[0]

    def from_bones(
        self, shaped: ShapedHand, quats: np.ndarray, locations: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the take's global_orient (N, 3), hand_pose (N, 45) and transl (N, 3) of a pose of the bones:
        the inverse of `to_bones`."""
        turned = self.frames @ quat_to_rotmat(quats) @ np.swapaxes(self.frames, -1, -2)
        global_orient = rotmat_to_rotvec(WORLD_FROM_CAMERA.T @ turned[:, 0] @ REST_FROM_MODEL)
        hand_pose = rotmat_to_rotvec(REST_FROM_MODEL.T @ turned[:, 1:] @ REST_FROM_MODEL)
        wrist = shaped.joints[0]
        moved = locations @ self.frames[0].T + points_to_rest(wrist) + self.origin
        return global_orient, hand_pose.reshape(-1, 3 * (NUM_JOINTS - 1)), moved @ WORLD_FROM_CAMERA - wrist

    def turned_to(self, other: RestPose, quats: np.ndarray) -> np.ndarray:
        """Return the quaternions (..., 16, 4) that do to another rig's bones what `quats` do to those of this
        rig; to a hand of the other side, as a mirror at x = 0 of rest space shows it.

        About a bone's axes B a rotation R of rest space is B^T R B, so the quaternion's vector turns by D =
        B_other^T B. A mirror M turns R into M R M, which is D R_bone D^T with D = B_other^T M B; since det D
        = -1 then, the vector turns by -D.
        """
        mirror = np.eye(3) if other.side == self.side else -MIRROR_X
        turn = np.swapaxes(other.frames, -1, -2) @ mirror @ self.frames
        return np.concatenate([quats[..., :1], (turn @ quats[..., 1:, None])[..., 0]], axis=-1)

    def moved_to(self, other: RestPose, locations: np.ndarray, plane: float = 0.0) -> np.ndarray:
        """Return the locations (..., 3), in metres, that put another rig's wrist where `locations` put that
        of this rig; a wrist of the other side, where a mirror at x = `plane` metres of rest space shows
        it."""
        place = self.wrist + self.origin + locations @ self.frames[0].T
        if other.side != self.side:
            place = place @ MIRROR_X + np.array([2.0 * plane, 0.0, 0.0])
        return (place - other.wrist - other.origin) @ other.frames[0]


def mirrored_pose(global_orient: np.ndarray, hand_pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a take's global_orient (N, 3) and hand_pose (N, 45), in radians, in a mirror at x = 0, which
    turns the axis-angle (a, b, c) into (a, -b, -c)."""
    turn = np.array([1.0, -1.0, -1.0])
    return global_orient * turn, hand_pose * np.tile(turn, NUM_JOINTS - 1)


QUATERNION_PRODUCTS: Final = ("w*x", "w*y", "w*z", "x*x", "y*y", "z*z", "y*z", "x*z", "x*y")
"""The nine products of a unit quaternion's components (w, x, y, z) whose sum, each times its matrix of
`_PRODUCT_MATRICES`, is R - I for its rotation R"""


def _matrices_of_products() -> np.ndarray:
    """Return the matrices (9, 3, 3) whose sum, each times its product of a quaternion's components, is R -
    I."""
    matrices = np.zeros((9, 3, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        matrices[i, k, j], matrices[i, j, k] = 2.0, -2.0
        matrices[3 + i, j, j] = matrices[3 + i, k, k] = -2.0
        matrices[6 + i, j, k] = matrices[6 + i, k, j] = 2.0
    return matrices


_PRODUCT_MATRICES: Final = _matrices_of_products()


def corrective_offsets(model: HandModel, frames: np.ndarray) -> np.ndarray:
    """Return the pose blend shapes per product of a bone's own quaternion: (15, 9, V, 3) metres, rest space.

    MANO adds posedirs * (R - I), with R the joint's rotation in model axes. Drivers see the bone's rotation
    R_bone = B^T R B instead, B being the bone's axes in the model frame, and R_bone - I is the sum of the
    quaternion's products times M_p. So the offset of product p is posedirs * (B M_p B^T). Row j is joint j +
    1, columns are as `QUATERNION_PRODUCTS`: a joint that only bends needs two of them, w*x and x*x.

    Products that move hardly anything (0.2 mm at 1) in the mean hand are zero in all others: betas turn bones
    by half a degree, and a hinge would need all nine for hundredths of a millimetre.
    """
    return _by_product(model, frames, _used_products(model))


@lru_cache(maxsize=8)
def _used_products(model: HandModel) -> np.ndarray:
    """Tell for each joint which of the nine products move the skin of the mean hand: (15, 9) bool."""
    every = np.ones((NUM_JOINTS - 1, 9), dtype=bool)
    mean = _by_product(model, bone_frames(model.shaped(), model.side), every)
    return np.abs(mean).max(axis=(2, 3)) > 2e-4


def _by_product(model: HandModel, frames: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return the offsets (15, 9, V, 3), in metres, of the products that `used` (15, 9) marks, zero for all
    others."""
    posedirs = model.posedirs.reshape(-1, 3, NUM_JOINTS - 1, 9)
    offsets = np.zeros((NUM_JOINTS - 1, 9, len(posedirs), 3))
    for joint, elements in enumerate(_products_to_elements(frames)):
        turned = points_to_rest(np.moveaxis(posedirs[:, :, joint], -1, 0))
        offsets[joint, used[joint]] = np.tensordot(elements[used[joint]], turned, axes=1)
    return offsets


def posedirs_of(offsets: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return the posedirs (V, 3, 135) of a model from offsets (15, 9, V, 3) in metres: the inverse of
    `corrective_offsets`."""
    elements = np.linalg.inv(_products_to_elements(frames))
    posedirs = np.einsum("jpvc,jep->vcje", offsets @ REST_FROM_MODEL, elements, optimize=True)
    return posedirs.reshape(len(posedirs), 3, -1)


def _products_to_elements(frames: np.ndarray) -> np.ndarray:
    """Return for each joint a matrix (15, 9, 9) whose row p is B M_p B^T, with B the bone's axes, row by
    row."""
    basis = REST_FROM_MODEL.T @ frames[1:]
    return np.einsum("jak,pkl,jbl->jpab", basis, _PRODUCT_MATRICES, basis).reshape(NUM_JOINTS - 1, 9, 9)
