"""The opposite hand is the mirror image, keys and all."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import PoseKeys, read_pose_keys, remove_pose_keys, write_pose_keys
from blender_manient.scene.store import hand_of
from handfit_core.common.skeleton import other_side

from .conftest import action_curves, evaluated_vertices, joint_heads

pytestmark = pytest.mark.usefixtures("registered")

MIRROR = np.array([-1.0, 1.0, 1.0])


def aside(made, metres=0.4):
    """Well to one side of the middle, so that the mirror is the camera's."""
    made.take.hands[0].transl[:, 0] += metres
    return made


def mirrored(hand):
    bpy.context.view_layer.objects.active = hand.armature
    assert bpy.ops.manient.mirror_hand() == {"FINISHED"}
    return bpy.context.view_layer.objects.active


def mirror_error(armature, source, side) -> np.ndarray:
    """(16, 3) metres on the present frame between a hand and its mirror image."""
    return joint_heads(armature, other_side(side)) - joint_heads(source, side) * MIRROR


@pytest.mark.parametrize("side", ["right", "left"])
def test_it_is_the_mirror_image_on_every_frame(make_take, model, side):
    made = aside(make_take(sides=(side,), model=model))
    source = build_take(made.take).hands[0]
    armature = mirrored(source)
    hand = hand_of(armature)
    assert hand.side == other_side(side)
    for _, frame in made.seen:
        bpy.context.scene.frame_set(frame)
        error = np.linalg.norm(mirror_error(armature, source.armature, side), axis=-1)
        assert error[0] < 1e-5
        assert error.max() < 2e-3  # left and right models are mirror images to a millimetre or so
    vertices = evaluated_vertices(hand.mesh) * MIRROR
    distance = [np.linalg.norm(evaluated_vertices(source.mesh) - v, axis=-1).min() for v in vertices[::40]]
    assert max(distance) < 4e-3


def test_the_artists_keys_are_mirrored(make_take):
    """Also their handles: a Bezier bulge is mirrored."""
    source = build_take(aside(make_take(sides=("right",))).take).hands[0]
    armature, rig = source.armature, rig_of(source.armature)
    keys = read_pose_keys(rig)
    write_pose_keys(rig, PoseKeys.everywhere(np.array([25.0]), keys.quats[:1], keys.locations[:1]))
    remove_pose_keys(rig, 5, 9, joints=[3], location=True)
    armature.pose.bones[bone_names("right")[4]].rotation_mode = "YXZ"
    path = f'pose.bones["{bone_names("right")[1]}"].rotation_quaternion'
    for curve in action_curves(armature.animation_data.action):
        if curve.data_path == path:
            point = curve.keyframe_points[2]
            point.interpolation = "BEZIER"
            point.handle_left_type = point.handle_right_type = "FREE"
            point.handle_right = (point.co[0] + 0.3, point.co[1] + 0.1)
            curve.update()
    before = read_pose_keys(rig)
    other = mirrored(source)
    after = read_pose_keys(rig_of(other))
    np.testing.assert_array_equal(after.frames, before.frames)
    np.testing.assert_array_equal(after.rotation_keyed, before.rotation_keyed)
    np.testing.assert_array_equal(after.location_keyed, before.location_keyed)
    np.testing.assert_allclose(read_pose_keys(rig).quats, before.quats, atol=1e-7)
    assert other.pose.bones[bone_names("left")[4]].rotation_mode == "YXZ"
    for frame in (4, 5, 5.5, 7, 20, 25):
        bpy.context.scene.frame_set(int(frame), subframe=frame % 1)
        assert np.abs(mirror_error(other, armature, "right")).max() < 2e-3
    assert not [c for c in action_curves(other.animation_data.action) if ".R" in c.data_path]


def test_hands_do_not_overlap(make_take):
    """In the middle of the picture the mirror stands beside the hand."""
    made = make_take(sides=("right",))
    source, found = build_take(made.take).hands[0], []
    for armature, side in ((source.armature, "right"), (mirrored(source), "left")):
        across = []
        for _, frame in made.seen:
            bpy.context.scene.frame_set(frame)
            across.append(joint_heads(armature, side)[:, 0])
        found.append(np.array(across))
    own, other = found
    assert own.min() < 0 < own.max()
    assert other.min() > own.max() or other.max() < own.min()


def test_it_is_a_captured_hand_of_the_same_capture(make_take, tmp_path):
    made = aside(make_take(sides=("right",)))
    built = build_take(made.take)
    other = mirrored(built.hands[0])
    hand, source = hand_of(other), hand_of(built.hands[0].armature)
    assert hand.collection == source.collection == built.collection
    assert [t.side for t in hand.take.hands] == ["right", "left"]
    assert not hand.track.detected.any()
    np.testing.assert_array_equal(hand.track.present, source.track.present)
    row, frame = made.seen[2]
    bpy.context.scene.frame_set(frame)
    wrist = hand.track.joints_3d[row, 0]
    np.testing.assert_allclose(joint_heads(other, "left")[0], [wrist[0], wrist[2], -wrist[1]], atol=1e-4)
    # And its shape can be changed like any other's.
    other.manient.betas[0] += 1.0
    np.testing.assert_allclose(list(other["betas"]), list(other.manient.betas), atol=1e-6)


def test_a_moved_rig_without_keys(make_take):
    source = build_take(aside(make_take(sides=("right",))).take).hands[0]
    armature = source.armature
    armature.animation_data_clear()
    armature.location = (1.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    other = mirrored(source)
    bpy.context.view_layer.update()
    mine = joint_heads(armature, "right") - [1.0, 2.0, 3.0]
    np.testing.assert_allclose(joint_heads(other, "left")[0], mine[0] * MIRROR + [1, 2, 3], atol=1e-5)
