"""A relaxed pose for the fingers, keyed where the artist's animation asks for keys."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import corrections
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import PoseKeys, displayed_pose, pose_at, read_pose_keys, remove_pose_keys
from handfit_core.edit.corrections import changed_quats, correction_between
from handfit_core.geometry.rotations import quat_to_rotmat, rotvec_to_rotmat
from handfit_core.hand_model import axes, load_model
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes, relaxed_pose
from handfit_core.media.source import Source

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture(params=["right", "left"])
def hand(request, make_take, model):
    made = make_take(sides=(request.param,), model=model)
    armature = build_take(made.take).hands[0].armature
    bpy.context.view_layer.objects.active = armature
    return armature, request.param, load_model(model, request.param)


def finger_rotations(armature, side) -> np.ndarray:
    """(15, 3, 3) joint rotations in the model's axes, from what the bones show."""
    frames = rig_of(armature).rest.frames
    turned = frames @ quat_to_rotmat(displayed_pose(rig_of(armature))) @ np.swapaxes(frames, -1, -2)
    return (axes.REST_FROM_MODEL.T @ turned @ axes.REST_FROM_MODEL)[1:]


def test_fingers_relax_and_the_wrist_stays(hand):
    armature, side, model = hand
    bpy.context.scene.frame_set(9)  # between keys
    before = displayed_pose(rig_of(armature))
    keys = read_pose_keys(rig_of(armature))
    assert bpy.ops.manient.apply_pose(pose="Relaxed") == {"FINISHED"}
    bpy.context.view_layer.update()
    found = finger_rotations(armature, side)
    np.testing.assert_allclose(found, rotvec_to_rotmat(relaxed_pose(model).reshape(15, 3)), atol=1e-4)
    bends = np.degrees(anatomical_angles(found, anatomical_axes(model))[:12, 2])
    assert (bends > 10).all()
    np.testing.assert_allclose(np.abs(displayed_pose(rig_of(armature))[0] @ before[0]), 1.0, atol=1e-6)
    after = read_pose_keys(rig_of(armature))
    here = after.frames == 9
    assert here.sum() == 1
    assert after.rotation_keyed[here][0].tolist() == [False] + [True] * 15
    assert not after.location_keyed[here].any()
    np.testing.assert_array_equal(after.frames[~here], keys.frames)


def turned(before: PoseKeys, after: PoseKeys) -> np.ndarray:
    """(N, 16) radians by which the keys differ on the frames that both have."""
    both = np.isin(after.frames, before.frames)
    return np.linalg.norm(correction_between(before.quats, after.quats[both]), axis=-1)


def test_it_fades_out_over_spread_and_clear_takes_it_back(hand):
    armature, _, _ = hand
    bpy.context.scene.manient.spread = 4
    before = read_pose_keys(rig_of(armature))
    bpy.context.scene.frame_set(6)
    assert bpy.ops.manient.apply_pose(pose="Relaxed") == {"FINISHED"}
    after = read_pose_keys(rig_of(armature))
    change = turned(before, after)
    assert change[:, 0].max() == 0.0
    np.testing.assert_array_equal(change.max(axis=1) > 1e-4, np.abs(before.frames - 6) < 4)
    np.testing.assert_array_equal(after.locations, before.locations)
    largest = [change[before.frames == frame].max() for frame in (6, 5, 4)]
    assert largest[0] > largest[1] > largest[2] > 0.0
    assert corrections.corrected_frames(armature) == [6]
    assert bpy.ops.manient.clear_corrections(scope="FRAME") == {"FINISHED"}
    assert turned(before, read_pose_keys(rig_of(armature))).max() < 1e-5


def test_without_a_spread_it_stays_in_its_frame(hand):
    armature, _, _ = hand
    bpy.context.scene.manient.spread = 0
    before = read_pose_keys(rig_of(armature))
    bpy.context.scene.frame_set(6)
    bpy.ops.manient.apply_pose(pose="Relaxed")
    change = turned(before, read_pose_keys(rig_of(armature))).max(axis=1)
    np.testing.assert_array_equal(change > 1e-4, before.frames == 6)


def test_between_the_frames_of_a_retimed_clip(make_take, picture):
    """The current frame is relaxed, although the clip has none there; clearing takes its key away again."""
    scene = bpy.context.scene
    scene.render.fps = 24
    scene.frame_set(1001)
    made = make_take(sides=("right",), source=Source("video", (str(picture),)), fps=30.0)
    armature = build_take(made.take, match_scene=False, picture=False).hands[0].armature
    bpy.context.view_layer.objects.active = armature
    model = load_model("open-hand", "right")
    before = read_pose_keys(rig_of(armature))
    scene.frame_set(1003)
    bpy.ops.manient.apply_pose(pose="Relaxed")
    scene.frame_set(1003)
    expected = rotvec_to_rotmat(relaxed_pose(model).reshape(15, 3))
    np.testing.assert_allclose(finger_rotations(armature, "right"), expected, atol=1e-4)
    assert corrections.corrected_frames(armature) == [1003]
    bpy.ops.manient.clear_corrections(scope="FRAME")
    after = read_pose_keys(rig_of(armature))
    np.testing.assert_array_equal(after.frames, before.frames)
    assert turned(before, after).max() < 1e-5


def test_pins_that_come_and_go_leave_it(hand):
    """A point that is dragged in a relaxed frame is measured against the relaxed pose."""
    armature, _, _ = hand
    bpy.context.scene.frame_set(6)
    bpy.ops.manient.apply_pose(pose="Relaxed")
    relaxed = pose_at(rig_of(armature), np.array([6.0]))
    dragged = changed_quats(relaxed[0][0], np.zeros((16, 3)), np.full((16, 3), 0.1))
    corrections.correct_frames(armature, [6], dragged[None], relaxed[1], 4, pins=[{8: (10.0, 20.0)}])
    one = corrections.corrections_of(armature).corrections[6]
    start = changed_quats(dragged, one.rotation, one.start_rotation)
    assert np.linalg.norm(correction_between(start, relaxed[0][0]), axis=-1).max() < 1e-6
    # It is the artist's own, even where the frame had been keyed anew before.
    corrections.end_corrections(armature, [6])
    assert corrections.corrected_frames(armature) == []
    bpy.ops.manient.apply_pose(pose="Relaxed")
    assert corrections.corrected_frames(armature) == [6]


def test_bones_without_keys_are_only_posed(hand):
    armature, side, model = hand
    remove_pose_keys(rig_of(armature), -100, 100, joints=[4, 5, 6])
    bpy.ops.manient.apply_pose(pose="Relaxed")
    keys = read_pose_keys(rig_of(armature))
    assert not keys.rotation_keyed[:, [4, 5, 6]].any()
    bpy.context.view_layer.update()
    expected = rotvec_to_rotmat(relaxed_pose(model).reshape(15, 3))
    np.testing.assert_allclose(finger_rotations(armature, side), expected, atol=1e-4)


def test_auto_keying_keys_them_too(hand):
    armature, _, _ = hand
    armature.animation_data_clear()
    bpy.context.scene.tool_settings.use_keyframe_insert_auto = True
    bpy.context.scene.frame_set(5)
    bpy.ops.manient.apply_pose(pose="Relaxed")
    keys = read_pose_keys(rig_of(armature))
    assert keys.frames.tolist() == [5.0]
    assert keys.rotation_keyed[0].tolist() == [False] + [True] * 15


def test_without_animation_there_are_no_keys(hand):
    armature, _, _ = hand
    armature.animation_data_clear()
    bpy.ops.manient.apply_pose(pose="Relaxed")
    assert armature.animation_data is None or armature.animation_data.action is None
    assert np.abs(displayed_pose(rig_of(armature))[1:, 1]).min() > 0.01


def test_euler_bones_pose_mode_and_undo(hand):
    armature, side, model = hand
    armature.pose.bones[bone_names(side)[8]].rotation_mode = "XZY"
    bpy.ops.object.mode_set(mode="POSE")
    name = armature.name
    bpy.ops.ed.undo_push(message="before")
    before = displayed_pose(rig_of(armature))
    bpy.ops.manient.apply_pose(pose="Relaxed")
    bpy.context.view_layer.update()
    expected = rotvec_to_rotmat(relaxed_pose(model).reshape(15, 3))
    np.testing.assert_allclose(finger_rotations(armature, side), expected, atol=1e-4)
    assert bpy.context.mode == "POSE"
    bpy.ops.ed.undo_push(message="relaxed")
    bpy.ops.ed.undo()
    bpy.context.view_layer.update()
    restored = displayed_pose(rig_of(bpy.data.objects[name]))
    np.testing.assert_allclose(np.abs(np.sum(restored * before, axis=-1)), 1.0, atol=1e-5)
