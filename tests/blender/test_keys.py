"""Keys as arrays and back: nothing else in the action changes."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.common.blender_versions import channels, first_slot
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.keys import (
    PoseKeys,
    align_signs,
    displayed_pose,
    pose_at,
    read_pose_keys,
    remove_pose_keys,
    set_pose,
    write_pose_keys,
)
from handfit_core.geometry.rotations import quat_to_rotmat

from .conftest import FRAMES, UNSEEN, action_curves

SEEN = np.delete(FRAMES, UNSEEN).astype(float)


def random_quats(count, seed=0) -> np.ndarray:
    quats = np.random.default_rng(seed).normal(size=(count, 16, 4))
    return quats / np.linalg.norm(quats, axis=-1, keepdims=True)


def same_rotation(one, other, atol=1e-5):
    np.testing.assert_allclose(quat_to_rotmat(one), quat_to_rotmat(other), atol=atol)


def curve_of(armature, bone, index, attribute="rotation_quaternion"):
    path = f'pose.bones["{bone_names("right")[bone]}"].{attribute}'
    curves = action_curves(armature.animation_data.action)
    return next(c for c in curves if c.data_path == path and c.array_index == index)


def write(armature, frames, *poses) -> None:
    write_pose_keys(rig_of(armature), PoseKeys.everywhere(np.array(frames, dtype=float), *poses))


def contents(armature) -> dict:
    """Everything that the curves hold."""
    return {
        (c.data_path, c.array_index): [
            (tuple(k.co), k.interpolation, k.handle_left_type, tuple(k.handle_left), tuple(k.handle_right))
            for k in c.keyframe_points
        ]
        for c in action_curves(armature.animation_data.action)
    }


def test_read_and_written_back_nothing_changes(armature):
    keys = read_pose_keys(rig_of(armature))
    np.testing.assert_array_equal(keys.frames, SEEN)
    assert keys.rotation_keyed.all()
    assert keys.location_keyed.all()
    some = read_pose_keys(rig_of(armature), 5, 13)
    inside = (SEEN >= 5) & (SEEN <= 13)
    np.testing.assert_array_equal(some.frames, SEEN[inside])
    same_rotation(some.quats, keys.quats[inside])
    before = contents(armature)
    write_pose_keys(rig_of(armature), keys)
    after = contents(armature)
    assert after.keys() == before.keys()
    for name, points in before.items():
        for one, other in zip(points, after[name], strict=True):
            assert one[1:3] == other[1:3]
            np.testing.assert_allclose(np.ravel(one[0]), np.ravel(other[0]), atol=1e-6)


def test_only_the_written_keys_change(armature):
    before = contents(armature)
    quats = random_quats(1)
    keyed = np.zeros((1, 16), dtype=bool)
    keyed[0, 5] = True
    keys = PoseKeys(SEEN[[3]], quats, np.zeros((1, 3)), keyed, np.zeros(1, dtype=bool))
    write_pose_keys(rig_of(armature), keys)
    own = bone_names("right")[5]
    for name, points in contents(armature).items():
        for one, other in zip(points, before[name], strict=True):
            if f'"{own}"' not in name[0] or one[0][0] != SEEN[3]:
                # Automatic handles next to the key may turn; keys do not.
                assert one[0] == other[0]
    same_rotation(pose_at(rig_of(armature), SEEN[[3]])[0][:, 5], quats[:, 5])


def test_insert_between_before_and_after(armature):
    """New keys go on like the key before."""
    frames = np.array([1.0, 4.5, 10.0, 30.0])
    before = read_pose_keys(rig_of(armature))
    curve_of(armature, 2, 1).keyframe_points[1].interpolation = "BEZIER"
    quats, places = random_quats(4), np.arange(12.0).reshape(4, 3)
    write(armature, frames, quats, places)
    keys = read_pose_keys(rig_of(armature))
    np.testing.assert_array_equal(keys.frames, np.sort(np.concatenate([SEEN, frames])))
    new = np.isin(keys.frames, frames)
    same_rotation(keys.quats[new], quats)
    np.testing.assert_allclose(keys.locations[new], places, atol=1e-6)
    same_rotation(keys.quats[~new], before.quats)
    for curve in action_curves(armature.animation_data.action):
        points = [k.co[0] for k in curve.keyframe_points]
        assert points == sorted(points)
    kinds = {k.co[0]: k.interpolation for k in curve_of(armature, 2, 1).keyframe_points}
    assert [kinds[frame] for frame in (3.0, 4.0, 4.5, 5.0)] == ["LINEAR", "BEZIER", "BEZIER", "LINEAR"]


@pytest.mark.parametrize("mode", ["XYZ", "ZYX", "AXIS_ANGLE"])
def test_other_rotation_modes(armature, mode):
    bone = armature.pose.bones[bone_names("right")[4]]
    bone.rotation_mode = mode
    quats, frames = random_quats(3), np.array([3.0, 5.0, 9.0])
    write(armature, frames, quats)
    keys = read_pose_keys(rig_of(armature))
    rows = np.isin(keys.frames, frames)
    same_rotation(keys.quats[rows], quats)
    np.testing.assert_array_equal(keys.rotation_keyed[:, 4], rows)
    for frame, quat in zip(frames, quats, strict=True):
        bpy.context.scene.frame_set(int(frame))
        same_rotation(np.array(bone.matrix_basis.to_quaternion()), quat[4])


def test_without_an_action_one_is_made_and_shows_at_once(armature):
    armature.animation_data_clear()
    assert not read_pose_keys(rig_of(armature)).rotation_keyed.any()
    bpy.context.scene.frame_set(2)
    quats = random_quats(2)
    write(armature, [1, 2], quats, np.ones((2, 3)))
    assert read_pose_keys(rig_of(armature)).rotation_keyed.all()
    bpy.context.view_layer.update()
    same_rotation(displayed_pose(rig_of(armature)), quats[1])


def test_remove(armature):
    remove_pose_keys(rig_of(armature), 5, 12, joints=[3, 4], location=False)
    keys = read_pose_keys(rig_of(armature))
    inside = (keys.frames >= 5) & (keys.frames <= 12)
    assert not keys.rotation_keyed[inside][:, [3, 4]].any()
    assert keys.rotation_keyed[~inside][:, [3, 4]].all()
    assert keys.rotation_keyed[:, [0, 1, 2, 5]].all()
    assert keys.location_keyed.all()


def test_a_missing_curve_is_made_without_moving_anything(armature):
    curve = curve_of(armature, 7, 2)
    armature.pose.bones[bone_names("right")[7]].rotation_quaternion[2] = curve.keyframe_points[0].co[1]
    action = armature.animation_data.action
    channels(action, first_slot(action)).fcurves.remove(curve)
    before, _ = pose_at(rig_of(armature), SEEN)
    write(armature, [40], random_quats(1))
    same_rotation(pose_at(rig_of(armature), SEEN)[0], before)
    assert len(curve_of(armature, 7, 2).keyframe_points) == len(SEEN) + 1


def test_signs_are_aligned_from_key_to_key(armature):
    keys = read_pose_keys(rig_of(armature))
    for index in range(4):  # what follows a turn of more than half a circle has the other sign
        for point in curve_of(armature, 9, index).keyframe_points[5:]:
            point.co[1] *= -1.0
    align_signs(rig_of(armature))
    found = np.array([[k.co[1] for k in curve_of(armature, 9, i).keyframe_points] for i in range(4)]).T
    assert (np.sum(found[1:] * found[:-1], axis=-1) > 0).all()
    same_rotation(found, keys.quats[:, 9])


def test_set_pose(armature):
    armature.animation_data_clear()
    names = bone_names("right")
    armature.pose.bones[names[2]].rotation_mode = "YXZ"
    armature.pose.bones[names[3]].rotation_mode = "AXIS_ANGLE"
    before = displayed_pose(rig_of(armature))
    quats = random_quats(1)[0]
    wanted = quats.copy()
    quats[6] = np.nan
    wanted[6] = before[6]
    set_pose(rig_of(armature), quats, np.array([1.0, 2.0, 3.0]))
    bpy.context.view_layer.update()
    same_rotation(displayed_pose(rig_of(armature)), wanted)
    assert tuple(armature.pose.bones[names[0]].location) == (1.0, 2.0, 3.0)
