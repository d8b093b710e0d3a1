"""A hand's 21 landmarks and their analytic Jacobian, batched.

Each joint j has a world frame F_j whose columns are its anatomical axes (twist, spread, bend) after
posing. With Q_j the joint's own rotation in those axes and C_j the constant turn from its parent's axes,

    F_j = F_parent C_j Q_j,    p_j = p_parent + F_parent o_j(betas),    x_k = p_j + F_j l_k(betas).

Rotations change by increments on the right, Q <- Q exp(w), so that a point beyond joint j moves by
(F_j e_i) x (x - p_j) per unit of w_i: one cross product for all of a hand's derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import Landmarks, bone_axes
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, NUM_BETAS, NUM_KEYPOINTS

_JOINTS = torch.tensor([FINGER_JOINTS[f] for f in FINGERS])
"""(5, 3) MANO's joints, finger by finger as keypoints go"""
_BONE_OF_POINT = [0, 1, 2, 2]
"""The level of the bone that carries each of a finger's four points"""
_ROOT = 3
"""The root comes after the three joints among a finger's frames"""
_CROSSED = np.array(
    [
        [[0, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[0, 0, -1], [0, 0, 0], [1, 0, 0]],
        [[0, 1, 0], [-1, 0, 0], [0, 0, 0]],
    ],
    dtype=float,
)
"""a @ _CROSSED: the matrix (3, 3) with which v becomes v x a"""


@dataclass(frozen=True, eq=False)
class State:
    """Pose and place of B hands."""

    root: torch.Tensor
    """(B, 3, 3) global_orient"""
    local: torch.Tensor
    """(B, 5, 3, 3, 3) the finger joints' rotations in their anatomical axes, finger by finger"""
    wrist: torch.Tensor
    """(B, 3) the wrist joint, metres, camera frame"""
    betas: torch.Tensor
    """(B, 10)"""
    offsets: torch.Tensor
    """(B, m) the terms' own unknowns, metres: where depth is zero, where the world landmarks' centre lies"""

    def __len__(self) -> int:
        return len(self.root)

    def select(self, index: torch.Tensor) -> State:
        """The hands of that index."""
        return State(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def where(self, chosen: torch.Tensor, other: State) -> State:
        """This state where `chosen` (B,) says so, else the other."""

        def pick(name: str) -> torch.Tensor:
            mine, theirs = getattr(self, name), getattr(other, name)
            return torch.where(chosen.view(-1, *[1] * (mine.ndim - 1)), mine, theirs)

        return State(*(pick(name) for name in self.__dataclass_fields__))


def joined(states: Sequence[State]) -> State:
    """The hands of all states, one after the other."""
    return State(*(torch.cat([getattr(s, name) for s in states]) for name in State.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class Posed:
    """Where the landmarks are, and what their derivatives are made of."""

    points: torch.Tensor
    """(B, 21, 3) metres, camera frame"""
    joints: torch.Tensor
    """(B, 5, 3, 3) finger joints"""
    frames: torch.Tensor
    """(B, 5, 4, 3, 3) the axes of the three joints and of the root, in columns"""
    state: State


class Chain:
    """One hand model's kinematics with its landmarks."""

    def __init__(
        self, model: HandModel, landmarks: Landmarks, dtype: torch.dtype, device: torch.device | str = "cpu"
    ) -> None:
        self.model = model
        self.dtype, self.device = dtype, torch.device(device)
        axes = bone_axes(model)
        joints = model.joint_regressor @ model.v_template
        joint_dirs = np.einsum("jv,vcb->jcb", model.joint_regressor, model.shapedirs)
        tips = model.v_template[model.tip_vertices]
        tip_dirs = model.shapedirs[model.tip_vertices]
        offsets = landmarks.in_metres(model)

        turn = np.empty((5, 3, 3, 3))
        # What each frame (three joints, then the root) adds to where four points and three joints are.
        part, part_dirs = np.zeros((5, 4, 3, 7)), np.zeros((5, 4, 3, 7, NUM_BETAS))
        for f, finger in enumerate(FINGERS):
            parent, frame = 0, _ROOT
            for level, joint in enumerate(FINGER_JOINTS[finger]):
                turn[f, level] = axes[parent].T @ axes[joint]
                # This joint, and all that lies beyond it.
                beyond = [*range(level, 4), *range(4 + level, 7)]
                part[f, frame][:, beyond] = (axes[parent].T @ (joints[joint] - joints[parent]))[:, None]
                part_dirs[f, frame][:, beyond] = (axes[parent].T @ (joint_dirs[joint] - joint_dirs[parent]))[
                    :, None
                ]
                part[f, level, :, level] = offsets[1 + 4 * f + level]
                parent, frame = joint, level
            part[f, 2, :, 3] = axes[parent].T @ (tips[f] - joints[parent]) + offsets[4 + 4 * f]
            part_dirs[f, 2, :, 3] = axes[parent].T @ (tip_dirs[f] - joint_dirs[parent])
        self._axes = self._tensor(axes[1:][np.array(_JOINTS) - 1])  # (5, 3, 3, 3)
        self._turn = self._tensor(turn)
        self._part = self._tensor(part.reshape(-1))
        self._part_dirs = self._tensor(part_dirs.reshape(-1, NUM_BETAS).T)
        self._point_dirs = self._tensor(part_dirs[:, :, :, :4].reshape(5, 12, 4 * NUM_BETAS))
        self._wrist_offset = self._tensor(offsets[0][:, None])
        # The wrist's landmark by the root's increment, in the root's axes: e x l.
        self._wrist_turned = self._tensor(np.cross(np.eye(3), offsets[0]).T)
        # A joint moves the points from its own bone outwards, the root all.
        moves = [[level <= _BONE_OF_POINT[k] for k in range(4)] for level in range(3)] + [[True] * 4]
        self._moves = self._tensor(np.array(moves, dtype=float))[..., None]  # (4 frames, 4 points, 1)
        self._crossed = self._tensor(_CROSSED.reshape(3, 9))
        self._identity = self._tensor(np.eye(3))
        self._wrist_template, self._wrist_dirs = joints[0], joint_dirs[0]

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.tensor(np.ascontiguousarray(array), dtype=self.dtype, device=self.device)

    def pose(self, state: State) -> Posed:
        """Place the landmarks."""
        batch = len(state)
        turned = (self._turn @ state.local).view(batch * 5, 3, 3, 3)
        root = state.root[:, None].expand(batch, 5, 3, 3).reshape(batch * 5, 3, 3)
        first = torch.bmm(root, turned[:, 0])
        second = torch.bmm(first, turned[:, 1])
        third = torch.bmm(second, turned[:, 2])
        side_by_side = torch.cat([first, second, third, root], dim=2)  # (5 B, 3, 12)
        parts = torch.addmm(self._part, state.betas, self._part_dirs).view(batch * 5, 12, 7)
        placed = torch.bmm(side_by_side, parts).view(batch, 5, 3, 7) + state.wrist[:, None, :, None]
        placed = placed.mT  # (B, 5, 4 points and 3 joints, 3)
        frames = side_by_side.view(batch, 5, 3, 4, 3).transpose(2, 3).contiguous()
        wrist = state.wrist + (state.root @ self._wrist_offset).squeeze(-1)
        points = torch.cat([wrist[:, None], placed[:, :, :4].reshape(batch, 20, 3)], dim=1)
        return Posed(points, placed[:, :, 4:], frames, state)

    def jacobian(self, posed: Posed, *, shape: bool) -> torch.Tensor:
        """(B, 21, 3, 15 or 25) of the landmarks by the nine increments of their own finger (zero for the
        wrist's), the root's three, the wrist's place and, with `shape`, betas (which leave the wrist's)."""
        batch = len(posed.state)
        whole = posed.points.new_zeros(batch, NUM_KEYPOINTS, 3, 15 + NUM_BETAS * shape)
        of_fingers = whole[:, 1:].view(batch, 5, 4, 3, -1)
        points = posed.points[:, 1:].view(batch, 5, 1, 4, 3)
        wrist = posed.state.wrist[:, None, None].expand(batch, 5, 1, 3)
        origins = torch.cat([posed.joints, wrist], dim=2).unsqueeze(3)
        arms = (points - origins) * self._moves  # (B, 5, 4 frames, 4 points, 3)
        crossed = (arms @ self._crossed).view(batch * 20, 12, 3)
        turning = torch.bmm(crossed, posed.frames.view(batch * 20, 3, 3)).view(batch, 5, 4, 4, 3, 3)
        of_fingers[..., :12].unflatten(-1, (4, 3)).copy_(turning.permute(0, 1, 3, 4, 2, 5))
        whole[:, 0, :, 9:12] = posed.state.root @ self._wrist_turned
        whole[..., 12:15] = self._identity
        if shape:
            # Finger by finger, since the linear maps are every hand's.
            frames = posed.frames.permute(1, 0, 3, 2, 4).reshape(5, batch * 3, 12)
            growing = torch.bmm(frames, self._point_dirs).view(5, batch, 3, 4, NUM_BETAS)
            of_fingers[..., 15:] = growing.permute(1, 0, 3, 2, 4)
        return whole

    def moved(self, state: State, of_hand: torch.Tensor, of_fingers: torch.Tensor) -> State:
        """Apply increments: of_hand (B, 6 + m or 6 + m + 10) and of_fingers (B, 5, 9)."""
        batch, own = len(state), 6 + state.offsets.shape[1]
        turns = torch.cat([of_hand[:, None, :3], of_fingers.view(batch, 15, 3)], dim=1)
        increments = exp(turns)
        return State(
            root=state.root @ increments[:, 0],
            local=state.local @ increments[:, 1:].view(batch, 5, 3, 3, 3),
            wrist=state.wrist + of_hand[:, 3:6],
            betas=state.betas if of_hand.shape[1] == own else state.betas + of_hand[:, own:],
            offsets=state.offsets + of_hand[:, 6:own],
        )

    def local_from_pose(self, hand_pose: np.ndarray) -> torch.Tensor:
        """(B, 45) axis-angle -> (B, 5, 3, 3, 3) rotations in anatomical axes, finger by finger."""
        from handfit_core.geometry.rotations import rotvec_to_rotmat

        rotmats = self._tensor(rotvec_to_rotmat(hand_pose.reshape(-1, 15, 3)))[:, _JOINTS - 1]
        return self._axes.mT @ rotmats @ self._axes

    def state(
        self,
        betas: np.ndarray,
        global_orient: np.ndarray,
        hand_pose: np.ndarray,
        transl: np.ndarray,
        offsets: np.ndarray,
    ) -> State:
        """The inverse of `parameters`: betas (B, 10), global_orient (B, 3), hand_pose (B, 45), transl (B, 3)
        in MANO's convention; offsets (B, m) metres."""
        from handfit_core.geometry.rotations import rotvec_to_rotmat

        return State(
            root=self._tensor(rotvec_to_rotmat(global_orient)),
            local=self.local_from_pose(hand_pose),
            wrist=self._tensor(transl + self._wrist_template + betas @ self._wrist_dirs.T),
            betas=self._tensor(betas),
            offsets=self._tensor(offsets),
        )

    def parameters(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """betas (B, 10), global_orient (B, 3), hand_pose (B, 45) and transl (B, 3) in MANO's convention."""
        from handfit_core.geometry.rotations import rotmat_to_rotvec

        rotmats = (self._axes @ state.local @ self._axes.mT).double().cpu().numpy()
        pose = np.empty((len(state), 15, 3))
        pose[:, np.array(_JOINTS) - 1] = rotmat_to_rotvec(rotmats)
        betas = state.betas.double().cpu().numpy()
        rest_wrist = self._wrist_template + betas @ self._wrist_dirs.T
        orient = rotmat_to_rotvec(state.root.double().cpu().numpy())
        return betas, orient, pose.reshape(-1, 45), state.wrist.double().cpu().numpy() - rest_wrist


def exp(rotvec: torch.Tensor) -> torch.Tensor:
    """(..., 3) -> (..., 3, 3) rotation matrices, exact near zero too (Rodrigues)."""
    squared = rotvec.square().sum(dim=-1, keepdim=True).clamp_min(1e-12)
    angle = squared.sqrt()
    sine, cosine = angle.sin() / angle, angle.cos()
    half = (0.5 * angle).sin() / angle
    x, y, z = (sine * rotvec).unbind(-1)
    outer = (rotvec * (2 * half * half)).unsqueeze(-1) * rotvec.unsqueeze(-2)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).view_as(outer)
    return outer + skew + cosine.unsqueeze(-1) * torch.eye(3, dtype=rotvec.dtype, device=rotvec.device)
