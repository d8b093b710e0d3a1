"""A hand's 21 landmarks and their analytic Jacobian, batched: forward kinematics for fitting.

Each joint j has a world frame F_j whose columns are its anatomical axes (twist, spread, bend) after
posing. With Q_j = Rx(twist) Ry(spread) Rz(bend) and C_j the constant turn from its parent's axes,

    F_j = F_parent C_j Q_j,    p_j = p_parent + F_parent o_j(betas),    x_k = p_j + F_j l_k(betas).

A point x beyond joint j moves by a x (x - p_j) per radian about an axis a. The axes of a joint's three angles
are the columns of

    G_j = F_j [Q_j^T e_x, Rz^T e_y, e_z],

those of the root's increment, R <- R exp(w), are its own columns: one cross product for all of a hand's
derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.common.batch import Batch, slices
from handfit_core.common.skeleton import JOINTS_BY_FINGER, NUM_BETAS, NUM_KEYPOINTS
from handfit_core.geometry.rotations import (
    euler_to_rotmat,
    rotmat_to_euler,
    rotmat_to_rotvec,
    rotvec_to_rotmat,
    skew,
)
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import Landmarks, bone_axes

_ROOT = 3
"""Index of the root among the frames of a finger, after its three joints"""
_CROSSED = -skew(np.eye(3)).reshape(3, 9)
"""(3, 9) a matrix for cross products: a @ _CROSSED is, row by row, the matrix with which v becomes v x a"""

ROOT, BETAS, PLACE, DEPTH_ZERO = slice(0, 3), slice(3, 13), slice(13, 16), slice(16, 17)
"""A hand's own variables: the root's turn, the shape, the wrist's place, and where depth is zero"""
HAND_SIZE = 17
FIXED_SHAPE = np.r_[ROOT, PLACE, DEPTH_ZERO]
"""Indices of the variables of a hand whose shape is given"""


@dataclass(frozen=True, eq=False)
class State(Batch):
    """The pose, place and shape of B hands, as a fit's variables."""

    root: np.ndarray
    """(B, 3, 3) global_orient as rotation matrices"""
    angles: np.ndarray
    """(B, 5, 9) radians, finger by finger: (twist, spread, bend) of each of three joints"""
    wrist: np.ndarray
    """(B, 3) metres: the place of the wrist joint in the camera frame"""
    betas: np.ndarray
    """(B, 10) shape coefficients of the hand model"""
    depth_zero: np.ndarray
    """(B,) metres along the line of sight where the detector's depth is zero"""

    def moved(self, of_hand: np.ndarray, of_fingers: np.ndarray) -> State:
        """Return the state after increments of the hand's own variables (B, 17), or (B, 7) where the shape is
        given, and of the angles (B, 5, 9) in radians."""
        free = of_hand.shape[1] == HAND_SIZE
        place = of_hand[:, PLACE] if free else of_hand[:, 3:6]
        return State(
            root=self.root @ rotvec_to_rotmat(of_hand[:, ROOT]),
            angles=self.angles + of_fingers,
            wrist=self.wrist + place,
            betas=self.betas + of_hand[:, BETAS] if free else self.betas,
            depth_zero=self.depth_zero + of_hand[:, -1],
        )


def turns_by_angles(angles: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Return the matrices (..., 3, 3) that turn changes of joints' angles (..., 3), in radians, into the
    increment w of Q <- Q exp(w); `local` (..., 3, 3) are the joints' rotations Q."""
    turns = np.zeros_like(local)
    turns[..., 0] = local[..., 0, :]
    turns[..., 0, 1], turns[..., 1, 1] = np.sin(angles[..., 2]), np.cos(angles[..., 2])
    turns[..., 2, 2] = 1.0
    return turns


@dataclass(frozen=True, eq=False)
class Posed:
    """The landmarks of B posed hands, and the axes and arms that their derivatives are made of."""

    points: np.ndarray
    """(B, 21, 3) metres: the landmarks in the camera frame"""
    origins: np.ndarray
    """(B, 5, 4, 3) metres: for each finger the centres of rotation of its three joints and of the root,
    camera frame"""
    axes: np.ndarray
    """(B, 5, 4, 3, 3) axes of rotation, in columns, of each joint's angles and of the root's increment,
    camera frame"""
    frames: np.ndarray
    """(B, 5, 3, 12) for each finger the axes of its three joints and of the root, side by side"""
    state: State


class Chain:
    """The kinematics of one hand model, which carry its landmarks."""

    def __init__(self, model: HandModel, landmarks: Landmarks) -> None:
        self.model = model
        axes = bone_axes(model)
        joints = model.joint_regressor @ model.v_template
        joint_dirs = np.einsum("jv,vcb->jcb", model.joint_regressor, model.shapedirs)
        tips = model.v_template[model.tip_vertices]
        tip_dirs = model.shapedirs[model.tip_vertices]
        offsets = landmarks.in_metres(model)

        turn = np.empty((5, 3, 3, 3))
        # The contribution of each frame (three joints, then the root) to the places of four points and three
        # joints.
        offset, offset_dirs = np.zeros((5, 4, 3, 7)), np.zeros((5, 4, 3, 7, NUM_BETAS))
        for f, finger in enumerate(JOINTS_BY_FINGER):
            parent, frame = 0, _ROOT
            for level, joint in enumerate(finger):
                turn[f, level] = axes[parent].T @ axes[joint]
                # This joint, and all that lies beyond it.
                beyond = [*range(level, 4), *range(4 + level, 7)]
                bone, bone_dirs = joints[joint] - joints[parent], joint_dirs[joint] - joint_dirs[parent]
                offset[f, frame][:, beyond] = (axes[parent].T @ bone)[:, None]
                offset_dirs[f, frame][:, beyond] = (axes[parent].T @ bone_dirs)[:, None]
                offset[f, level, :, level] = offsets[1 + 4 * f + level]
                parent, frame = joint, level
            offset[f, 2, :, 3] = axes[parent].T @ (tips[f] - joints[parent]) + offsets[4 + 4 * f]
            offset_dirs[f, 2, :, 3] = axes[parent].T @ (tip_dirs[f] - joint_dirs[parent])
        self._axes = axes[JOINTS_BY_FINGER]  # (5, 3, 3, 3)
        self._turn = turn
        self._offset = offset.reshape(-1)
        self._offset_dirs = np.ascontiguousarray(offset_dirs.reshape(-1, NUM_BETAS).T)
        self._point_dirs = offset_dirs[:, :, :, :4].reshape(5, 12, 4 * NUM_BETAS)
        self._wrist_offset = offsets[0]
        # The wrist's landmark by the root's increment, in the root's axes: e x l.
        self._wrist_turned = np.cross(np.eye(3), offsets[0]).T
        # A joint moves the points from its own bone outwards, the root all.
        # The level of the bone that carries each of a finger's four points
        moves = [[level <= [0, 1, 2, 2][k] for k in range(4)] for level in range(3)] + [[True] * 4]
        self._moves = np.array(moves, dtype=float)[..., None]  # (4 frames, 4 points, 1)
        self._wrist_template, self._wrist_dirs = joints[0], joint_dirs[0]

    def pose(self, state: State) -> Posed:
        """Pose the landmarks of B hands, and collect what their derivatives are made of."""
        batch = len(state)
        angles = state.angles.reshape(batch, 5, 3, 3)
        local = euler_to_rotmat(angles)
        turned = self._turn @ local
        axes = np.empty((batch, 5, 4, 3, 3))
        frames = np.empty((batch, 5, 3, 4, 3))
        frames[:, :, :, _ROOT] = axes[:, :, _ROOT] = parent = state.root[:, None]
        for level in range(3):
            parent = parent @ turned[:, :, level]
            frames[:, :, :, level] = parent
        np.matmul(frames[:, :, :, :3].swapaxes(2, 3), turns_by_angles(angles, local), out=axes[:, :, :3])
        frames = frames.reshape(batch, 5, 3, 12)
        offsets = (self._offset + state.betas @ self._offset_dirs).reshape(batch, 5, 12, 7)
        placed = (frames @ offsets).swapaxes(2, 3) + state.wrist[:, None, None]  # four points, three joints
        points = np.empty((batch, NUM_KEYPOINTS, 3))
        points[:, 0] = state.wrist + state.root @ self._wrist_offset
        points[:, 1:].reshape(batch, 5, 4, 3)[...] = placed[:, :, :4]
        origins = np.empty((batch, 5, 4, 3))
        origins[:, :, :3], origins[:, :, _ROOT] = placed[:, :, 4:], state.wrist[:, None]
        return Posed(points, origins, axes, frames, state)

    def points(self, state: State) -> np.ndarray:
        """Return the landmarks (B, 21, 3) of posed hands, metres, camera frame; computed in slices, which
        bounds the memory."""
        return np.concatenate([self.pose(state.select(rows)).points for rows in slices(len(state))])

    def jacobian(self, posed: Posed, rows: np.ndarray, *, shape: bool) -> np.ndarray:
        """Turn c rows of each landmark (B, 21, c, 3 + 1 + k) into rows (B, 21, c, 9 + n + k) by the hand's
        variables.

        The given rows hold derivatives by the landmark's place and by where depth is zero, and k columns that
        stay what they are, such as residuals. The returned ones hold derivatives by the nine angles of the
        landmark's own finger (zero for the wrist's point), and by the hand's own n variables: 17, or with a
        given shape 7.
        """
        batch = len(posed.state)
        moving = 12 + NUM_BETAS * shape
        points = posed.points[:, 1:].reshape(batch, 5, 1, 4, 3)
        arms = (points - posed.origins[:, :, :, None]) * self._moves  # (B, 5, 4 frames, 4 points, 3)
        crossed = (arms.reshape(-1, 3) @ _CROSSED).reshape(batch, 5, 4, 12, 3)
        turning = (crossed @ posed.axes).reshape(batch, 5, 4, 4, 3, 3)
        by_point = np.empty((batch, 5, 4, 3, moving))
        by_point[..., :12].reshape(batch, 5, 4, 3, 4, 3)[...] = turning.transpose(0, 1, 3, 4, 2, 5)
        if shape:
            # Finger by finger, since the linear maps are every hand's.
            frames = posed.frames.swapaxes(0, 1).reshape(5, batch * 3, 12)
            growing = (frames @ self._point_dirs).reshape(5, batch, 3, 4, NUM_BETAS)
            by_point[..., 12:] = growing.transpose(1, 0, 3, 2, 4)
        whole = np.empty((batch, NUM_KEYPOINTS, rows.shape[2], moving + rows.shape[3]))
        np.matmul(rows[:, 1:, :, :3], by_point.reshape(batch, 20, 3, moving), out=whole[:, 1:, :, :moving])
        whole[:, 0, :, :moving] = 0.0
        whole[:, 0, :, 9:12] = rows[:, 0, :, :3] @ (posed.state.root @ self._wrist_turned)
        whole[..., moving:] = rows
        return whole

    def state(
        self,
        betas: np.ndarray,
        global_orient: np.ndarray,
        hand_pose: np.ndarray,
        transl: np.ndarray,
        depth_zero: np.ndarray,
    ) -> State:
        """Return the state of hands given in MANO's convention, by betas (B, 10), global_orient (B, 3) and
        hand_pose (B, 45) in radians, transl (B, 3) in metres; depth_zero (B,) metres. The inverse of
        `parameters`."""
        rotmats = rotvec_to_rotmat(hand_pose.reshape(-1, 15, 3))[:, JOINTS_BY_FINGER - 1]
        angles = rotmat_to_euler(np.swapaxes(self._axes, -1, -2) @ rotmats @ self._axes)
        return State(
            root=rotvec_to_rotmat(global_orient),
            angles=angles.reshape(-1, 5, 9),
            wrist=transl + self._wrist_template + betas @ self._wrist_dirs.T,
            betas=np.asarray(betas, dtype=np.float64),
            depth_zero=np.asarray(depth_zero, dtype=np.float64),
        )

    def parameters(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return betas (B, 10), global_orient (B, 3) and hand_pose (B, 45) in radians, and transl (B, 3) in
        metres, of a state, in MANO's convention."""
        pose = np.empty((len(state), 15, 3))
        for rows in slices(len(state)):
            local = self._axes @ euler_to_rotmat(state.angles[rows].reshape(-1, 5, 3, 3))
            pose[rows, JOINTS_BY_FINGER - 1] = rotmat_to_rotvec(local @ np.swapaxes(self._axes, -1, -2))
        rest_wrist = self._wrist_template + state.betas @ self._wrist_dirs.T
        return state.betas, rotmat_to_rotvec(state.root), pose.reshape(-1, 45), state.wrist - rest_wrist
