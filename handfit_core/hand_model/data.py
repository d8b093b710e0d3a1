"""The arrays of a hand model in MANO's format, whoever made it, and its NumPy forward pass.

Everything here needs NumPy only: Blender builds rigs from it. The differentiable, batched twin in
torch is `handfit_core.paper.layer`; a test holds the two together.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from handfit_core.common.arrays import array, array_dataclass
from handfit_core.common.skeleton import FINGERS, NUM_BETAS, NUM_JOINTS, PARENTS, Side, keypoints_from_joints
from handfit_core.geometry import rotations


@dataclass(frozen=True)
class ModelLimits:
    """Limits of what a model and its file may hold."""

    vertices: int = 50_000
    """Most vertices of a model's mesh; MANO's has 778, the open hand's 1609"""
    faces: int = 2 * vertices
    """Most faces of a model's mesh; MANO's has 1538, the open hand's 1598"""
    number: float = 1e4
    """Largest size of any number of a model, be it metres, weights or radians"""
    min_hand: float = 0.01
    """metres that a hand model must be across at least"""
    max_hand: float = 10.0
    """metres that a hand model may be across at most"""
    file_bytes: int = 64_000_000
    """Most bytes of a model file; MANO's have 4 MB, and larger meshes in its format 10 MB"""
    name_length: int = 200
    memory_bytes: int = 200_000_000
    """Most bytes of a model's arrays: twelve times those of the open hand's"""


LIMITS: Final = ModelLimits()


@dataclass(frozen=True)
class ShapedHand:
    """A hand model after the shape is applied, in metres: in its zero pose (flat hand, model frame), or posed
    and placed, in the frame that global_orient and transl lead to."""

    vertices: np.ndarray
    """(..., V, 3) metres: the vertices of the mesh"""
    joints: np.ndarray
    """(..., 16, 3) metres: the joints, in MANO's order"""
    tips: np.ndarray
    """(..., 5, 3) metres: the fingertips of thumb, index, middle, ring and little finger"""

    @property
    def keypoints(self) -> np.ndarray:
        """(..., 21, 3) metres: the keypoints, in MediaPipe's order."""
        return keypoints_from_joints(self.joints, self.tips)


@array_dataclass
class HandModel:
    """A hand in MANO's format, in metres; zero pose is the flat hand.

    Model frame: the right hand's fingers point along -x (the left hand's along +x), the back of the
    hand along +y, the thumb along +z. Arrays are float64 and read-only.
    """

    name: str
    """The model's name: `open-hand`, or the stem of the user's file"""
    side: Side
    v_template: np.ndarray = array("V", 3, finite="all", most=LIMITS.number)
    faces: np.ndarray = array("F", 3, kind="i", most_rows=LIMITS.faces)
    """(F, 3) vertex indices of the triangles, counter-clockwise seen from outside"""
    shapedirs: np.ndarray = array("V", 3, NUM_BETAS, finite="all", most=LIMITS.number)
    posedirs: np.ndarray = array("V", 3, 9 * (NUM_JOINTS - 1), finite="all", most=LIMITS.number)
    """(V, 3, 135) metres: the vertices' offsets per element of R - I of the rotations of joints 1..15,
    row-major"""
    joint_regressor: np.ndarray = array(NUM_JOINTS, "V", finite="all", most=LIMITS.number)
    weights: np.ndarray = array("V", NUM_JOINTS, finite="all", most=LIMITS.number)
    """(V, 16) skin weights of each vertex by joint; rows sum to 1"""
    hands_mean: np.ndarray = array(45, finite="all", most=LIMITS.number)
    """(45,) the relaxed pose, axis-angle in radians; never added by us: hand_pose is always relative to the
    flat hand"""
    hands_components: np.ndarray = array(45, 45, finite="all", most=LIMITS.number)
    """(45, 45) principal directions of the pose, in rows"""
    tip_vertices: np.ndarray = array(len(FINGERS), kind="i")
    """(5,) vertex numbers of the fingertips: thumb, index, middle, ring, little"""
    quads: np.ndarray | None = array("Q", 4, kind="i", most_rows=LIMITS.faces, default=None)
    """(Q, 4) vertex indices of the faces for artists; None where the model has only triangles"""
    uv: np.ndarray | None = array("U", 2, finite="all", most=LIMITS.number, default=None)
    """(U, 2) texture coordinates; None where the model has none"""
    uv_faces: np.ndarray | None = array("P", "C", kind="i", most_rows=LIMITS.faces, default=None)
    """Indices of texture coordinates in `uv`, for each corner of quads (or of faces where quads is None);
    None where the model has none"""
    source: str = field(default="")
    """Path of the file that the model was read from; empty for the bundled open hand"""

    @property
    def polygons(self) -> np.ndarray:
        """The polygons of the mesh by their vertices: quads (Q, 4) where the model has them, else triangles
        (F, 3)."""
        return self.faces if self.quads is None else self.quads

    @cached_property
    def has_pose_blendshapes(self) -> bool:
        """True if posing changes the mesh beyond skinning."""
        return bool(np.any(self.posedirs))

    @cached_property
    def digest(self) -> str:
        """A short fingerprint of the arrays that decide where joints and vertices go.

        In 32 bits, which is what `.npz` files keep of `.pkl` files; without the skin weights, which are
        normalised again on every reading.
        """
        sha = hashlib.sha256(self.side.encode())
        for numbers in (self.v_template, self.shapedirs, self.posedirs, self.joint_regressor):
            sha.update(np.ascontiguousarray(numbers, dtype=np.float32).tobytes())
        return sha.hexdigest()[:16]

    def shaped(self, betas: np.ndarray | None = None) -> ShapedHand:
        """Apply shape coefficients (10,) to the zero pose; None is the mean shape."""
        betas = np.zeros(NUM_BETAS) if betas is None else np.asarray(betas, dtype=np.float64)
        vertices = self.v_template + self.shapedirs @ betas
        return ShapedHand(vertices, self.joint_regressor @ vertices, vertices[self.tip_vertices])

    def posed(
        self, betas: np.ndarray | None, global_orient: np.ndarray, hand_pose: np.ndarray, transl: np.ndarray
    ) -> ShapedHand:
        """Pose the mesh by linear blend skinning as MANO (Romero, Tzionas, Black 2017) defines it.

        betas (10,) or None; global_orient (..., 3) and hand_pose (..., 45) axis-angle in radians; transl
        (..., 3) metres. The root rotates about the wrist joint, then transl is added, so the wrist ends at
        shaped(betas).joints[0] + transl.
        """
        vertices, joints = self.skinned(slice(None), betas, global_orient, hand_pose, transl)
        return ShapedHand(vertices, joints, vertices[..., self.tip_vertices, :])

    def keypoints(
        self, betas: np.ndarray | None, global_orient: np.ndarray, hand_pose: np.ndarray, transl: np.ndarray
    ) -> np.ndarray:
        """Return the keypoints (..., 21, 3), in metres, of `posed`, without the cost of the mesh."""
        tips, joints = self.skinned(self.tip_vertices, betas, global_orient, hand_pose, transl)
        return keypoints_from_joints(joints, tips)

    def skinned(
        self,
        chosen: np.ndarray | slice,
        betas: np.ndarray | None,
        global_orient: np.ndarray,
        hand_pose: np.ndarray,
        transl: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the `chosen` vertices (..., N, 3) and all joints (..., 16, 3) of a posed hand, in metres."""
        shaped = self.shaped(betas)
        pose = np.concatenate([global_orient, hand_pose], axis=-1)
        batch = pose.shape[:-1]
        rotmats = rotations.rotvec_to_rotmat(pose.reshape(*batch, NUM_JOINTS, 3))
        world_rot, world_pos = forward_kinematics(rotmats, shaped.joints)

        vertices = shaped.vertices[chosen]
        vertices = np.broadcast_to(vertices, (*batch, *vertices.shape))
        if self.has_pose_blendshapes:
            feature = (rotmats[..., 1:, :, :] - np.eye(3)).reshape(*batch, 135)
            vertices = vertices + np.tensordot(feature, self.posedirs[chosen], (-1, -1))
        offsets = world_pos - np.einsum("...jab,jb->...ja", world_rot, shaped.joints)
        weights = self.weights[chosen]
        skin_rot = np.einsum("vj,...jab->...vab", weights, world_rot)
        skinned = np.einsum("...vab,...vb->...va", skin_rot, vertices)
        skinned = skinned + np.einsum("vj,...ja->...va", weights, offsets)
        transl = np.asarray(transl, dtype=np.float64)[..., None, :]
        return skinned + transl, world_pos + transl


def forward_kinematics(rotmats: np.ndarray, rest_joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Chain local joint rotations (..., 16, 3, 3) over rest joints (16, 3) in metres.

    Returns each joint's rotation from the rest pose (..., 16, 3, 3) and position (..., 16, 3); the
    root turns about its own joint.
    """
    world_rot: list[np.ndarray] = [rotmats[..., 0, :, :]]
    world_pos: list[np.ndarray] = [np.broadcast_to(rest_joints[0], (*rotmats.shape[:-3], 3))]
    for joint in range(1, NUM_JOINTS):
        parent = PARENTS[joint]
        offset = rest_joints[joint] - rest_joints[parent]
        world_pos.append(world_pos[parent] + world_rot[parent] @ offset)
        world_rot.append(world_rot[parent] @ rotmats[..., joint, :, :])
    return np.stack(world_rot, axis=-3), np.stack(world_pos, axis=-2)
