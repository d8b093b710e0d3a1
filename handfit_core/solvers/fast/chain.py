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
_FIRST_NUMBERS = 3
"""The wrist's landmark comes first among the linear maps of betas"""


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
    """(B, 5, 3, 3, 3) their axes, in columns"""
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
        offset, offset_dirs = np.empty((5, 3, 3)), np.empty((5, 3, 3, NUM_BETAS))
        point, point_dirs = np.empty((5, 4, 3)), np.zeros((5, 4, 3, NUM_BETAS))
        for f, finger in enumerate(FINGERS):
            parent = 0
            for level, joint in enumerate(FINGER_JOINTS[finger]):
                turn[f, level] = axes[parent].T @ axes[joint]
                offset[f, level] = axes[parent].T @ (joints[joint] - joints[parent])
                offset_dirs[f, level] = axes[parent].T @ (joint_dirs[joint] - joint_dirs[parent])
                point[f, level] = offsets[1 + 4 * f + level]
                parent = joint
            point[f, 3] = axes[parent].T @ (tips[f] - joints[parent]) + offsets[4 + 4 * f]
            point_dirs[f, 3] = axes[parent].T @ (tip_dirs[f] - joint_dirs[parent])
        base = np.concatenate([offsets[0], offset.reshape(-1), point.reshape(-1)])
        maps = np.concatenate(
            [np.zeros((3, NUM_BETAS)), offset_dirs.reshape(45, -1), point_dirs.reshape(60, -1)]
        )
        self._axes = self._tensor(axes[1:][np.array(_JOINTS) - 1])  # (5, 3, 3, 3)
        self._turn = self._tensor(turn)
        self._base, self._maps = self._tensor(base), self._tensor(maps.T)  # (108,), (10, 108)
        self._offset_dirs = self._tensor(offset_dirs)
        self._point_dirs = self._tensor(point_dirs)
        # A joint moves the points from its own bone outwards.
        beyond = np.array([[level <= _BONE_OF_POINT[k] for level in range(3)] for k in range(4)], dtype=float)
        self._beyond = self._tensor(beyond)[None, None, :, :, None, None]
        self._wrist_template, self._wrist_dirs = joints[0], joint_dirs[0]

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.tensor(np.ascontiguousarray(array), dtype=self.dtype, device=self.device)

    def pose(self, state: State) -> Posed:
        """Place the landmarks."""
        batch = len(state)
        sizes = torch.addmm(self._base, state.betas, self._maps)
        wrist_point, offset, point = sizes.split([_FIRST_NUMBERS, 45, 60], dim=1)
        offset = offset.reshape(batch, 5, 3, 3, 1)
        turned = self._turn @ state.local
        root = state.root[:, None]
        first = root @ turned[:, :, 0]
        second = first @ turned[:, :, 1]
        third = second @ turned[:, :, 2]
        at_first = state.wrist[:, None] + (root @ offset[:, :, 0]).squeeze(-1)
        at_second = at_first + (first @ offset[:, :, 1]).squeeze(-1)
        at_third = at_second + (second @ offset[:, :, 2]).squeeze(-1)
        frames = torch.stack([first, second, third], dim=2)
        joints = torch.stack([at_first, at_second, at_third], dim=2)
        carrier = frames[:, :, _BONE_OF_POINT]
        points = joints[:, :, _BONE_OF_POINT] + (carrier @ point.view(batch, 5, 4, 3, 1)).squeeze(-1)
        wrist = state.wrist + (state.root @ wrist_point.unsqueeze(-1)).squeeze(-1)
        all_points = torch.cat([wrist[:, None], points.reshape(batch, 20, 3)], dim=1)
        return Posed(all_points, joints, frames, state)

    def jacobian_of_hand(self, posed: Posed, *, shape: bool) -> torch.Tensor:
        """(B, 21, 6 or 16, 3) by the root's increment, the wrist's place and, with `shape`, betas."""
        state, batch = posed.state, len(posed.state)
        arm = (posed.points - state.wrist[:, None]).unsqueeze(2)
        by_root = _cross(state.root.mT[:, None], arm)
        by_place = torch.eye(3, dtype=self.dtype, device=self.device).expand(batch, NUM_KEYPOINTS, 3, 3)
        if not shape:
            return torch.cat([by_root, by_place], dim=2)
        frames = posed.frames
        first = state.root[:, None] @ self._offset_dirs[:, 0]
        second = first + frames[:, :, 0] @ self._offset_dirs[:, 1]
        third = second + frames[:, :, 1] @ self._offset_dirs[:, 2]
        tip = third + frames[:, :, 2] @ self._point_dirs[:, 3]
        of_fingers = torch.stack([first, second, third, tip], dim=2).mT.reshape(batch, 20, NUM_BETAS, 3)
        of_wrist = torch.zeros(batch, 1, NUM_BETAS, 3, dtype=self.dtype, device=self.device)
        return torch.cat([by_root, by_place, torch.cat([of_wrist, of_fingers], dim=1)], dim=2)

    def jacobian_of_fingers(self, posed: Posed) -> torch.Tensor:
        """(B, 5, 4, 9, 3) of each finger's four points by the increments of its three joints."""
        batch = len(posed.state)
        points = posed.points[:, 1:].view(batch, 5, 4, 1, 3)
        arm = points - posed.joints[:, :, None]  # (B, 5, 4, 3, 3)
        moved = _cross(posed.frames.mT[:, :, None], arm.unsqueeze(-2))
        return (moved * self._beyond).reshape(batch, 5, 4, 9, 3)

    def moved(self, state: State, of_hand: torch.Tensor, of_fingers: torch.Tensor) -> State:
        """Apply increments: of_hand (B, 6 + m or 6 + m + 10) and of_fingers (B, 5, 9)."""
        batch, own = len(state), 6 + state.offsets.shape[1]
        turns = torch.cat([of_hand[:, None, :3], of_fingers.reshape(batch, 15, 3)], dim=1)
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
        from handfit_core.rotations import rotvec_to_rotmat

        rotmats = self._tensor(rotvec_to_rotmat(hand_pose.reshape(-1, 15, 3)))[:, _JOINTS - 1]
        return self._axes.mT @ rotmats @ self._axes

    def parameters(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """betas (B, 10), global_orient (B, 3), hand_pose (B, 45) and transl (B, 3) in MANO's convention."""
        from handfit_core.rotations import rotmat_to_rotvec

        rotmats = (self._axes @ state.local @ self._axes.mT).double().cpu().numpy()
        pose = np.empty((len(state), 15, 3))
        pose[:, np.array(_JOINTS) - 1] = rotmat_to_rotvec(rotmats)
        betas = state.betas.double().cpu().numpy()
        rest_wrist = self._wrist_template + betas @ self._wrist_dirs.T
        orient = rotmat_to_rotvec(state.root.double().cpu().numpy())
        return betas, orient, pose.reshape(-1, 45), state.wrist.double().cpu().numpy() - rest_wrist


def _cross(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """The cross product over the last dimension, with broadcasting."""
    a0, a1, a2 = a.unbind(-1)
    b0, b1, b2 = b.unbind(-1)
    return torch.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], dim=-1)


def exp(rotvec: torch.Tensor) -> torch.Tensor:
    """(..., 3) -> (..., 3, 3) rotation matrices, exact near zero too (Rodrigues)."""
    squared = rotvec.square().sum(dim=-1)[..., None, None].clamp_min(1e-12)
    angle = squared.sqrt()
    x, y, z = rotvec.unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).view(*rotvec.shape, 3)
    identity = torch.eye(3, dtype=rotvec.dtype, device=rotvec.device)
    half = (angle / 2).sin()
    return identity + (angle.sin() / angle) * skew + (2 * half * half / squared) * (skew @ skew)
