"""The hand model in torch: batched and differentiable, the twin of `HandModel.posed`.

A solver evaluates `HandLayer.keypoints` hundreds of times per picture with a batch of one, where the
count of small torch operations is the cost, not the arithmetic. Hence its form: the five fingers,
whose joints stand as 5 x 3 in MANO's order, are chained together, one matrix product per level; all
that depends on the shape alone (bone offsets, every point relative to every joint) is one linear map
of betas; and the 21 points are one product of that map with the 16 joint transforms.

Points are rows here, so a transform is the transpose of the usual one: (x, 1) @ T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from handfit_core.common.skeleton import KEYPOINT_SOURCE, NUM_BETAS, NUM_JOINTS, PARENTS
from handfit_core.hand_model.data import HandModel

_LEVEL_ORDER = (0, *(1 + 3 * finger + level for level in range(3) for finger in range(5)))
"""The 16 joints in the order in which the chain yields them: the wrist, all first joints, all second, all
third."""

_SMALLEST_ANGLE = 1e-18
"""Half angles in radians below this count as this: sin(t)/t is exactly 1 long before, and t^2 fits
float32."""


@dataclass(frozen=True, eq=False)
class HandOutput:
    """The result of `HandLayer.forward`, in metres, in the frame that global_orient and transl lead to."""

    vertices: torch.Tensor
    """(B, V, 3) metres: the vertices of the mesh"""
    joints: torch.Tensor
    """(B, 16, 3) metres: the joints in MANO's order"""
    keypoints: torch.Tensor
    """(B, 21, 3) metres: the keypoints in MediaPipe's order"""


class HandLayer(torch.nn.Module):
    """Linear blend skinning of one `HandModel` as MANO defines it.

    Angles are axis-angle in radians relative to the flat hand (hands_mean is not added); the root
    rotates about the wrist joint, then transl (metres) is added. Everything is differentiable, also
    at exactly zero rotation.
    """

    _transform_base: torch.Tensor
    _transform_of_betas: torch.Tensor
    _transform_of_quat: torch.Tensor
    _point_base: torch.Tensor
    _point_map: torch.Tensor
    _tip_posedirs: torch.Tensor
    _joint_template: torch.Tensor
    _joint_shapedirs: torch.Tensor
    _v_template: torch.Tensor
    _shapedirs: torch.Tensor
    _posedirs: torch.Tensor
    _weights: torch.Tensor
    _tip_vertices: torch.Tensor
    _keypoint_source: torch.Tensor
    _mano_order: torch.Tensor
    faces: torch.Tensor
    """(F, 3) int64: vertex indices of the triangles"""

    def __init__(
        self, model: HandModel, dtype: torch.dtype = torch.float64, device: torch.device | str | None = None
    ) -> None:
        super().__init__()
        self.model = model
        self.has_pose_blendshapes = model.has_pose_blendshapes
        # The open hand's leave its fingertips alone.
        self._tips_have_blendshapes = bool(model.posedirs[model.tip_vertices].any())
        count = len(model.v_template)
        joints = model.joint_regressor @ model.v_template  # (16, 3)
        joint_dirs = np.einsum("jv,vcb->jcb", model.joint_regressor, model.shapedirs)  # (16, 3, 10)
        arrays = {
            "_transform_base": _transform_map(joints[..., None], corner=1.0)[:, 0],  # (256,)
            "_transform_of_betas": _transform_map(joint_dirs).T,  # (10, 256)
            "_transform_of_quat": _quat_products_to_transform(),  # (16, 16)
            "_joint_template": joints.reshape(-1),  # (48,)
            "_joint_shapedirs": joint_dirs.reshape(48, NUM_BETAS).T,  # (10, 48)
            "_v_template": model.v_template.reshape(-1),  # (3V,)
            "_shapedirs": model.shapedirs.reshape(3 * count, NUM_BETAS).T,  # (10, 3V)
            "_weights": model.weights[:, _LEVEL_ORDER],  # (V, 16), joints in level order
        }
        tips = model.tip_vertices
        tip_weights = model.weights[tips]
        rest = model.v_template[tips][:, None, :] - joints  # (5, 16, 3)
        rest_dirs = model.shapedirs[tips][:, None, :, :] - joint_dirs  # (5, 16, 3, 10)
        point_base = np.zeros((NUM_JOINTS + 5, NUM_JOINTS, 4))
        point_base[range(NUM_JOINTS), range(NUM_JOINTS), 3] = 1.0
        point_base[NUM_JOINTS:, :, :3] = tip_weights[..., None] * rest
        point_base[NUM_JOINTS:, :, 3] = tip_weights
        point_dirs = np.zeros((NUM_JOINTS + 5, NUM_JOINTS, 4, NUM_BETAS))
        point_dirs[NUM_JOINTS:, :, :3] = tip_weights[..., None, None] * rest_dirs
        arrays["_point_base"] = _points(point_base[..., None])[:, 0]  # (21*64,)
        arrays["_point_map"] = _points(point_dirs).T  # (10, 21*64), with blend shapes (25, 21*64)
        if self.has_pose_blendshapes:
            # From the 15 transforms' 16 elements to the 15 tip coordinates; the pose feature R - I is
            # row-major, our transforms are transposed.
            per_joint = model.posedirs.reshape(count, 3, 15, 3, 3)
            posedirs = np.zeros((count, 3, 15, 4, 4))
            posedirs[..., :3, :3] = per_joint.swapaxes(-1, -2)
            rest_feature = np.einsum("vcjaa->vc", per_joint)  # what R = I would add
            arrays["_posedirs"] = posedirs.reshape(3 * count, 240).T  # (240, 3V)
            arrays["_v_template"] = arrays["_v_template"] - rest_feature.reshape(-1)
            if self._tips_have_blendshapes:
                arrays["_tip_posedirs"] = posedirs[tips].reshape(15, 240).T  # (240, 15)
                tip_map = np.zeros((NUM_JOINTS + 5, NUM_JOINTS, 4, 5, 3))
                for tip in range(5):
                    for axis in range(3):
                        tip_map[NUM_JOINTS + tip, :, axis, tip, axis] = tip_weights[tip]
                tip_rows = _points(tip_map.reshape(NUM_JOINTS + 5, NUM_JOINTS, 4, 15))
                arrays["_point_base"] = arrays["_point_base"] - tip_rows @ rest_feature[tips].reshape(-1)
                arrays["_point_map"] = np.concatenate([arrays["_point_map"], tip_rows.T])
        for name, array in arrays.items():
            tensor = torch.tensor(np.ascontiguousarray(array), dtype=dtype, device=device)
            self.register_buffer(name, tensor, persistent=False)
        for name, indices in (
            ("_tip_vertices", tips),
            ("_keypoint_source", KEYPOINT_SOURCE),
            ("_mano_order", np.argsort(_LEVEL_ORDER)),
            ("faces", model.faces),
        ):
            tensor = torch.tensor(np.array(indices), dtype=torch.int64, device=device)
            self.register_buffer(name, tensor, persistent=False)

    def forward(
        self,
        betas: torch.Tensor,
        global_orient: torch.Tensor,
        hand_pose: torch.Tensor,
        transl: torch.Tensor | None = None,
    ) -> HandOutput:
        """Pose the whole mesh.

        betas (B, 10), or (10,) or (1, 10) for all; global_orient (B, 3) and hand_pose (B, 45) in
        radians; transl (B, 3) in metres or None for zero. Dtype and device are the layer's.
        """
        batch = hand_pose.shape[0]
        betas = betas.expand(batch, NUM_BETAS)
        local = self._local_transforms(betas, global_orient, hand_pose)
        world = _chained(local).reshape(batch, NUM_JOINTS, 4, 3)  # in level order

        vertices = torch.addmm(self._v_template, betas, self._shapedirs)
        if self.has_pose_blendshapes:
            vertices = vertices + local[:, 1:].reshape(batch, 240) @ self._posedirs
        vertices = vertices.reshape(batch, -1, 3)
        rest = torch.addmm(self._joint_template, betas, self._joint_shapedirs)
        rest = rest.reshape(batch, NUM_JOINTS, 3)[:, _LEVEL_ORDER]

        rotation, position = world[:, :, :3], world[:, :, 3]
        offset = position - (rest.unsqueeze(-2) @ rotation).squeeze(-2)
        skin = self._weights @ torch.cat([rotation, offset.unsqueeze(-2)], dim=-2).reshape(batch, 16, 12)
        skin = skin.reshape(batch, -1, 4, 3)
        skinned = (vertices.unsqueeze(-2) @ skin[:, :, :3]).squeeze(-2) + skin[:, :, 3]
        joints = position[:, self._mano_order]
        if transl is not None:
            skinned = skinned + transl.unsqueeze(-2)
            joints = joints + transl.unsqueeze(-2)
        keypoints = torch.cat([joints, skinned[:, self._tip_vertices]], dim=1)[:, self._keypoint_source]
        return HandOutput(skinned, joints, keypoints)

    def keypoints(
        self,
        betas: torch.Tensor,
        global_orient: torch.Tensor,
        hand_pose: torch.Tensor,
        transl: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Return the keypoints (B, 21, 3) in MediaPipe's order, metres: those of `forward`, without the cost
        of the mesh.

        Arguments are as in `forward`.
        """
        batch = hand_pose.shape[0]
        betas = betas.expand(batch, NUM_BETAS)
        local = self._local_transforms(betas, global_orient, hand_pose)
        world = _chained(local)
        weighing = betas
        if self._tips_have_blendshapes:
            weighing = torch.cat([betas, local[:, 1:].reshape(batch, 240) @ self._tip_posedirs], dim=1)
        points = torch.addmm(self._point_base, weighing, self._point_map).reshape(batch, 21, 64)
        keypoints = torch.bmm(points, world)
        return keypoints if transl is None else keypoints + transl.unsqueeze(-2)

    def _local_transforms(
        self, betas: torch.Tensor, global_orient: torch.Tensor, hand_pose: torch.Tensor
    ) -> torch.Tensor:
        """Return each joint's rotation and its offset from its parent, in metres, as transposed transforms
        (B, 16, 4, 4)."""
        batch = hand_pose.shape[0]
        pose = torch.cat([global_orient, hand_pose], dim=1).reshape(batch * NUM_JOINTS, 3)
        offsets = torch.addmm(self._transform_base, betas, self._transform_of_betas)
        offsets = offsets.reshape(batch * NUM_JOINTS, 16)
        return torch.addmm(offsets, _quat_products(pose), self._transform_of_quat).reshape(
            batch, NUM_JOINTS, 4, 4
        )


def rotvec_to_rotmat(rotvec: torch.Tensor) -> torch.Tensor:
    """Convert axis-angle (..., 3) in radians to rotation matrices (..., 3, 3); value and gradient are exact
    at zero too."""
    table = torch.tensor(_QUAT_PRODUCTS_TO_ROTMAT, dtype=rotvec.dtype, device=rotvec.device)
    return (_quat_products(rotvec) @ table).reshape(*rotvec.shape, 3)


def _quat_products(rotvec: torch.Tensor) -> torch.Tensor:
    """Return all products of two elements of the quaternion (w, x, y, z), (..., 16), of axis-angle (..., 3)
    in radians.

    A rotation matrix is linear in these. Neither the norm's gradient (zero at zero by torch's convention) nor
    sin(t)/t, kept off zero by the clamp, can yield NaN.
    """
    half = rotvec * 0.5
    angle = torch.linalg.vector_norm(half, dim=-1, keepdim=True).clamp_min(_SMALLEST_ANGLE)
    quat = torch.cat([angle.cos(), half * (angle.sin() / angle)], dim=-1)
    return (quat.unsqueeze(-1) * quat.unsqueeze(-2)).flatten(-2)


def _chained(local: torch.Tensor) -> torch.Tensor:
    """Chain local transforms (B, 16, 4, 4) to the joints' world transforms (B, 64, 3) in level order,
    stacked."""
    batch = local.shape[0]
    # Split and unbind, not indexing: their gradients are one concatenation, not a zero-fill each.
    # bmm, not matmul: it spares the broadcasting, which costs more than the product.
    root, fingers = local.split([1, NUM_JOINTS - 1], dim=1)
    first, second, third = fingers.reshape(batch, 5, 3, 4, 4).unbind(2)
    root = root[:, 0, :, :3]
    first = torch.bmm(first.reshape(batch, 20, 4), root)
    second = torch.bmm(second.reshape(batch * 5, 4, 4), first.view(batch * 5, 4, 3))
    third = torch.bmm(third.reshape(batch * 5, 4, 4), second)
    return torch.cat([root, first, second.view(batch, 20, 3), third.view(batch, 20, 3)], dim=1)


def _quat_products_to_rotmat() -> np.ndarray:
    """Return the map (16, 9) from products q_i q_j (at 4i + j) of a unit quaternion (w, x, y, z) to the
    row-major rotation matrix."""
    elements = (
        "+ww +xx -yy -zz",
        "+xy +xy -wz -wz",
        "+xz +xz +wy +wy",
        "+xy +xy +wz +wz",
        "+ww -xx +yy -zz",
        "+yz +yz -wx -wx",
        "+xz +xz -wy -wy",
        "+yz +yz +wx +wx",
        "+ww -xx -yy +zz",
    )
    table = np.zeros((16, 9))
    for element, terms in enumerate(elements):
        for sign, i, j in terms.split():
            table[4 * "wxyz".index(i) + "wxyz".index(j), element] += 1.0 if sign == "+" else -1.0
    return table


_QUAT_PRODUCTS_TO_ROTMAT = _quat_products_to_rotmat()


def _quat_products_to_transform() -> np.ndarray:
    """Return the map (16, 16) from products of quaternion elements to the rotation part of a flattened,
    transposed 4x4 transform."""
    table = np.zeros((16, 4, 4))
    table[:, :3, :3] = _QUAT_PRODUCTS_TO_ROTMAT.reshape(16, 3, 3).swapaxes(1, 2)
    return table.reshape(16, 16)


def _transform_map(joints: np.ndarray, corner: float = 0.0) -> np.ndarray:
    """Return the joints' offsets from their parents inside flat transforms, (256, n), from joints (16, 3, n),
    column by column.

    `corner` goes into the transforms' last element, which is 1 in a whole transform.
    """
    parents = [max(parent, 0) for parent in PARENTS]
    offsets = joints - joints[parents]
    offsets[0] = joints[0]
    transforms = np.zeros((NUM_JOINTS, 4, 4, joints.shape[-1]))
    transforms[:, 3, :3] = offsets
    transforms[:, 3, 3] = corner
    return transforms.reshape(NUM_JOINTS * 16, -1)


def _points(rows: np.ndarray) -> np.ndarray:
    """Reorder rows (21 points, 16 joints, 4, n) in MANO's order to (21*64, n) in MediaPipe's and level
    order."""
    return rows[list(KEYPOINT_SOURCE)][:, list(_LEVEL_ORDER)].reshape(21 * 64, -1)
