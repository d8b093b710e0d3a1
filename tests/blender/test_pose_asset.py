"""Poses for Blender's pose library, applied as the library does it."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import displayed_pose

from .conftest import action_curves

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def hands(make_take):
    """Two right hands of different captures, the first active and somewhere in its motion."""
    first = build_take(make_take(sides=("right",)).take).hands[0].armature
    second = build_take(make_take(sides=("right",), seed=8).take).hands[0].armature
    bpy.context.scene.frame_set(7)
    bpy.context.view_layer.objects.active = first
    return first, second


def same_rotation(one, other, atol=1e-5):
    np.testing.assert_allclose(np.abs(np.sum(one * other, axis=-1)), 1.0, atol=atol)


@pytest.mark.parametrize("wrist", [False, True])
def test_one_key_per_bone(hands, wrist):
    first, _ = hands
    own = first.animation_data.action
    assert bpy.ops.manient.save_pose_asset(asset_name="Wave", wrist=wrist) == {"FINISHED"}
    action = bpy.data.actions["Wave"]
    assert action.asset_data is not None
    assert {t.name for t in action.asset_data.tags} == {"hand", "right"}
    assert action.use_fake_user
    assert first.animation_data.action == own
    curves = list(action_curves(action))
    assert {c.data_path for c in curves} == {
        f'pose.bones["{name}"].rotation_quaternion' for name in bone_names("right")[0 if wrist else 1 :]
    }
    assert len(curves) == 4 * (15 + wrist)
    assert all(len(c.keyframe_points) == 1 for c in curves)
    values = np.array([c.keyframe_points[0].co[1] for c in curves]).reshape(-1, 4)
    same_rotation(values, displayed_pose(rig_of(first))[0 if wrist else 1 :])


@pytest.mark.parametrize("wrist", [False, True])
def test_the_pose_librarys_own_way_of_applying(hands, wrist):
    """`Pose.apply_pose_from_action` is what poselib.apply_pose_asset calls, slots and all."""
    first, second = hands
    bpy.ops.manient.save_pose_asset(asset_name="Wave", wrist=wrist)
    action = bpy.data.actions["Wave"]
    wanted = displayed_pose(rig_of(first))
    before = displayed_pose(rig_of(second))
    second.animation_data_clear()
    second.pose.apply_pose_from_action(action, evaluation_time=0.0)
    bpy.context.view_layer.update()
    found = displayed_pose(rig_of(second))
    same_rotation(found[1:], wanted[1:])
    if wrist:
        same_rotation(found[0], wanted[0])
    else:
        same_rotation(found[0], before[0])


def test_half_of_a_pose_can_be_blended(hands):
    first, second = hands
    bpy.ops.manient.save_pose_asset(asset_name="Wave")
    wanted = displayed_pose(rig_of(first))
    second.animation_data_clear()
    before = displayed_pose(rig_of(second))
    second.pose.blend_pose_from_action(bpy.data.actions["Wave"], blend_factor=0.5, evaluation_time=0.0)
    bpy.context.view_layer.update()
    found = displayed_pose(rig_of(second))
    towards = np.abs(np.sum(found * wanted, axis=-1))[1:]
    assert (towards >= np.abs(np.sum(before * wanted, axis=-1))[1:] - 1e-6).all()
    assert towards.mean() > np.abs(np.sum(before * wanted, axis=-1))[1:].mean()


def test_names_and_euler_bones(hands):
    first, _ = hands
    first.pose.bones[bone_names("right")[3]].rotation_mode = "XYZ"
    bpy.ops.manient.save_pose_asset(asset_name="  ")
    bpy.ops.manient.save_pose_asset(asset_name="Hand Pose")
    assert {"Hand Pose", "Hand Pose.001"} <= {a.name for a in bpy.data.actions}
