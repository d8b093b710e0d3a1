"""What Blender's curves hold and its evaluated bones show, for tests to judge."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS
from handfit_core.geometry.rotations import quat_to_rotmat

from .conftest import action_curves
from .conftest import chosen as chosen


def curves_of(armature: bpy.types.Object) -> list[bpy.types.FCurve]:
    """The curves of an object's action."""
    return action_curves(armature.animation_data.action)


def keyed_bones(armature: bpy.types.Object) -> set[str]:
    """The names of the bones that an object's action has curves for."""
    return {curve.data_path.split('"')[1] for curve in curves_of(armature)}


def bones_at(armature: bpy.types.Object, frame: float):
    """The evaluated pose bones on a frame, whole or not."""
    bpy.context.scene.frame_set(int(np.floor(frame)), subframe=float(frame % 1.0))
    return armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones


def angles(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(...) degrees between rotations, which are quaternions (..., 4) or matrices (..., 3, 3)."""
    one, other = (quat_to_rotmat(turn) if turn.shape[-1] == 4 else turn for turn in (one, other))
    cosine = (np.trace(np.swapaxes(one, -1, -2) @ other, axis1=-2, axis2=-1) - 1.0) / 2.0
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """The largest of these angles, in degrees."""
    return float(angles(one, other).max())


def directions_apart(one: np.ndarray, other: np.ndarray) -> float:
    """The largest angle between unit vectors (..., 3), in degrees."""
    return float(np.degrees(np.arccos(np.clip(np.sum(one * other, axis=-1), -1.0, 1.0))).max())


def select_bones(armature: bpy.types.Object, names: list[str]) -> None:
    """Select these bones alone, in Pose Mode."""
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="POSE")
    bpy.ops.pose.select_all(action="DESELECT")
    for name in names:
        # From Blender 5.0 on the pose bone is selected, before the bone is.
        bone = armature.pose.bones[name]
        (bone if hasattr(bone, "select") else bone.bone).select = True


def palm(points: np.ndarray) -> np.ndarray:
    """(3, 3) along, across and out of a palm as columns, of its joints in MANO's order."""
    along = points[4] - points[0]
    along = along / np.linalg.norm(along)
    toward = points[1] - points[7]
    toward = toward - along * (along @ toward)
    toward /= np.linalg.norm(toward)
    return np.stack([along, toward, np.cross(along, toward)], axis=-1)


def directions(armature: bpy.types.Object, names: Sequence[str], frame: float) -> np.ndarray:
    """(5, 2, 3) where two segments of each finger point, in the axes of the hand's own palm at that frame."""
    bones = bones_at(armature, frame)
    points = np.array([bones[name].head for name in names])
    rest = np.array([armature.data.bones[name].head_local for name in names])
    # The palm as a rigid body, which fingers do not turn.
    still = np.linalg.inv(np.array(armature.data.bones[names[0]].matrix_local.to_3x3()))
    steps = np.diff(points[list(FINGER_JOINTS.values())], axis=1)
    steps /= np.linalg.norm(steps, axis=-1, keepdims=True)
    return steps @ np.array(bones[names[0]].matrix.to_3x3()) @ still @ palm(rest)
