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

from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat, skew
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import Landmarks, bone_axes
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, NUM_BETAS, NUM_KEYPOINTS

_JOINTS = np.array([FINGER_JOINTS[f] for f in FINGERS])
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


Index = np.ndarray | slice
"""Which of a batch's hands: numbers, booleans or a slice"""


@dataclass(frozen=True, eq=False)
class State:
    """Pose and place of B hands."""

    root: np.ndarray
    """(B, 3, 3) global_orient"""
    local: np.ndarray
    """(B, 5, 3, 3, 3) the finger joints' rotations in their anatomical axes, finger by finger"""
    wrist: np.ndarray
    """(B, 3) the wrist joint, metres, camera frame"""
    betas: np.ndarray
    """(B, 10)"""
    offsets: np.ndarray
    """(B, m) the terms' own unknowns, metres: where depth is zero, where the world landmarks' centre lies"""

    def __len__(self) -> int:
        return len(self.root)

    def select(self, index: Index) -> State:
        """The hands of that index."""
        return State(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def where(self, chosen: np.ndarray, other: State) -> State:
        """This state where `chosen` (B,) says so, else the other."""

        def pick(name: str) -> np.ndarray:
            mine, theirs = getattr(self, name), getattr(other, name)
            return np.where(chosen.reshape(-1, *[1] * (mine.ndim - 1)), mine, theirs)

        return State(*(pick(name) for name in self.__dataclass_fields__))


def joined(states: Sequence[State]) -> State:
    """The hands of all states, one after the other."""
    return State(*(np.concatenate([getattr(s, name) for s in states]) for name in State.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class Posed:
    """Where the landmarks are, and what their derivatives are made of."""

    points: np.ndarray
    """(B, 21, 3) metres, camera frame"""
    joints: np.ndarray
    """(B, 5, 3, 3) finger joints"""
    frames: np.ndarray
    """(B, 5, 4, 3, 3) the axes of the three joints and of the root, in columns"""
    state: State


class Chain:
    """One hand model's kinematics with its landmarks."""

    def __init__(self, model: HandModel, landmarks: Landmarks) -> None:
        self.model = model
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
        self._axes = axes[1:][_JOINTS - 1]  # (5, 3, 3, 3)
        self._turn = turn
        self._part = part.reshape(-1)
        self._part_dirs = np.ascontiguousarray(part_dirs.reshape(-1, NUM_BETAS).T)
        self._point_dirs = part_dirs[:, :, :, :4].reshape(5, 12, 4 * NUM_BETAS)
        self._wrist_offset = offsets[0]
        # The wrist's landmark by the root's increment, in the root's axes: e x l.
        self._wrist_turned = np.cross(np.eye(3), offsets[0]).T
        # A joint moves the points from its own bone outwards, the root all.
        moves = [[level <= _BONE_OF_POINT[k] for k in range(4)] for level in range(3)] + [[True] * 4]
        self._moves = np.array(moves, dtype=float)[..., None]  # (4 frames, 4 points, 1)
        self._wrist_template, self._wrist_dirs = joints[0], joint_dirs[0]

    def pose(self, state: State) -> Posed:
        """Place the landmarks."""
        batch = len(state)
        turned = self._turn @ state.local
        frames = np.empty((batch, 5, 4, 3, 3))
        frames[:, :, _ROOT] = state.root[:, None]
        parent = frames[:, :, _ROOT]
        for level in range(3):
            parent = np.matmul(parent, turned[:, :, level], out=frames[:, :, level])
        side_by_side = np.swapaxes(frames, 2, 3).reshape(batch, 5, 3, 12)
        parts = (self._part + state.betas @ self._part_dirs).reshape(batch, 5, 12, 7)
        # (B, 5, 4 points and 3 joints, 3)
        placed = np.swapaxes(side_by_side @ parts, 2, 3) + state.wrist[:, None, None]
        points = np.empty((batch, NUM_KEYPOINTS, 3))
        points[:, 0] = state.wrist + state.root @ self._wrist_offset
        points[:, 1:] = placed[:, :, :4].reshape(batch, 20, 3)
        return Posed(points, placed[:, :, 4:], frames, state)

    def jacobian(self, posed: Posed, *, shape: bool) -> np.ndarray:
        """(B, 21, 3, 15 or 25) of the landmarks by the nine increments of their own finger (zero for the
        wrist's), the root's three, the wrist's place and, with `shape`, betas (which leave the wrist's)."""
        batch = len(posed.state)
        whole = np.zeros((batch, NUM_KEYPOINTS, 3, 15 + NUM_BETAS * shape))
        of_fingers = whole[:, 1:].reshape(batch, 5, 4, 3, -1)
        points = posed.points[:, 1:].reshape(batch, 5, 1, 4, 3)
        wrist = np.broadcast_to(posed.state.wrist[:, None, None], (batch, 5, 1, 3))
        origins = np.concatenate([posed.joints, wrist], axis=2)[:, :, :, None]
        arms = (points - origins) * self._moves  # (B, 5, 4 frames, 4 points, 3)
        crossed = (arms @ _CROSSED.reshape(3, 9)).reshape(batch, 5, 4, 12, 3)
        turning = (crossed @ posed.frames).reshape(batch, 5, 4, 4, 3, 3)
        of_fingers[..., :12] = turning.transpose(0, 1, 3, 4, 2, 5).reshape(batch, 5, 4, 3, 12)
        whole[:, 1:] = of_fingers.reshape(batch, 20, 3, -1)
        whole[:, 0, :, 9:12] = posed.state.root @ self._wrist_turned
        whole[..., 12:15] = np.eye(3)
        if shape:
            # Finger by finger, since the linear maps are every hand's.
            frames = posed.frames.transpose(1, 0, 3, 2, 4).reshape(5, batch * 3, 12)
            growing = (frames @ self._point_dirs).reshape(5, batch, 3, 4, NUM_BETAS)
            whole[:, 1:, :, 15:] = growing.transpose(1, 0, 3, 2, 4).reshape(batch, 20, 3, NUM_BETAS)
        return whole

    def moved(self, state: State, of_hand: np.ndarray, of_fingers: np.ndarray) -> State:
        """Apply increments: of_hand (B, 6 + m or 6 + m + 10) and of_fingers (B, 5, 9)."""
        batch, own = len(state), 6 + state.offsets.shape[1]
        turns = np.concatenate([of_hand[:, None, :3], of_fingers.reshape(batch, 15, 3)], axis=1)
        increments = exp(turns)
        return State(
            root=state.root @ increments[:, 0],
            local=state.local @ increments[:, 1:].reshape(batch, 5, 3, 3, 3),
            wrist=state.wrist + of_hand[:, 3:6],
            betas=state.betas if of_hand.shape[1] == own else state.betas + of_hand[:, own:],
            offsets=state.offsets + of_hand[:, 6:own],
        )

    def local_from_pose(self, hand_pose: np.ndarray) -> np.ndarray:
        """(B, 45) axis-angle -> (B, 5, 3, 3, 3) rotations in anatomical axes, finger by finger."""
        rotmats = rotvec_to_rotmat(hand_pose.reshape(-1, 15, 3))[:, _JOINTS - 1]
        return np.swapaxes(self._axes, -1, -2) @ rotmats @ self._axes

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
        return State(
            root=rotvec_to_rotmat(global_orient),
            local=self.local_from_pose(hand_pose),
            wrist=transl + self._wrist_template + betas @ self._wrist_dirs.T,
            betas=np.asarray(betas, dtype=np.float64),
            offsets=np.asarray(offsets, dtype=np.float64),
        )

    def parameters(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """betas (B, 10), global_orient (B, 3), hand_pose (B, 45) and transl (B, 3) in MANO's convention."""
        rotmats = self._axes @ state.local @ np.swapaxes(self._axes, -1, -2)
        pose = np.empty((len(state), 15, 3))
        pose[:, _JOINTS - 1] = rotmat_to_rotvec(rotmats)
        rest_wrist = self._wrist_template + state.betas @ self._wrist_dirs.T
        orient = rotmat_to_rotvec(state.root)
        return state.betas, orient, pose.reshape(-1, 45), state.wrist - rest_wrist


def exp(rotvec: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3) rotation matrices, exact near zero too (Rodrigues)."""
    angle = np.sqrt(np.maximum(np.square(rotvec).sum(axis=-1, keepdims=True), 1e-12))
    half = np.sin(0.5 * angle) / angle
    outer = (rotvec * (2 * half * half))[..., None] * rotvec[..., None, :]
    return outer + skew(np.sin(angle) / angle * rotvec) + np.cos(angle)[..., None] * np.eye(3)
