"""The opposite hand is the mirror image, keys and all."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import PoseKeys, read_pose_keys, remove_pose_keys, write_pose_keys
from blender_manient.scene.store import hand_of
from handfit_core.skeleton import other_side

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


@pytest.mark.parametrize("side", ["right", "left"])
def test_it_is_the_mirror_image_on_every_frame(make_take, model, side):
    made = aside(make_take(sides=(side,), model=model))
    source = build_take(made.take).hands[0]
    armature = mirrored(source)
    hand = hand_of(armature)
    assert hand is not None
    assert hand.side == other_side(side)
    for _, frame in made.seen:
        bpy.context.scene.frame_set(frame)
        heads = joint_heads(armature, hand.side)
        np.testing.assert_allclose(heads[0], joint_heads(source.armature, side)[0] * MIRROR, atol=1e-5)
        error = np.linalg.norm(heads - joint_heads(source.armature, side) * MIRROR, axis=-1)
        assert error.max() < 2e-3  # left and right models are mirror images to a millimetre or so
    vertices = evaluated_vertices(hand.mesh) * MIRROR
    distance = [np.linalg.norm(evaluated_vertices(source.mesh) - v, axis=-1).min() for v in vertices[::40]]
    assert max(distance) < 4e-3


def test_the_artists_keys_are_mirrored(make_take):
    source = build_take(aside(make_take(sides=("right",))).take).hands[0]
    armature = source.armature
    keys = read_pose_keys(rig_of(armature))
    write_pose_keys(
        rig_of(armature), PoseKeys.everywhere(np.array([25.0]), keys.quats[:1], keys.locations[:1])
    )
    remove_pose_keys(rig_of(armature), 5, 9, joints=[3], location=True)
    armature.pose.bones[bone_names("right")[4]].rotation_mode = "YXZ"
    path = f'pose.bones["{bone_names("right")[1]}"].rotation_quaternion'
    for curve in action_curves(armature.animation_data.action):
        if curve.data_path == path:
            point = curve.keyframe_points[2]
            point.interpolation = "BEZIER"
            point.handle_left_type = point.handle_right_type = "FREE"
            point.handle_right = (point.co[0] + 0.3, point.co[1] + 0.1)
            curve.update()
    before = read_pose_keys(rig_of(armature))
    other = mirrored(source)
    after = read_pose_keys(rig_of(other))
    np.testing.assert_array_equal(after.frames, before.frames)
    np.testing.assert_array_equal(after.rotation_keyed, before.rotation_keyed)
    np.testing.assert_array_equal(after.location_keyed, before.location_keyed)
    # The source is as it was.
    np.testing.assert_allclose(read_pose_keys(rig_of(armature)).quats, before.quats, atol=1e-7)
    assert other.pose.bones[bone_names("left")[4]].rotation_mode == "YXZ"
    for frame in (4, 5, 7, 20, 25):
        bpy.context.scene.frame_set(frame)
        error = joint_heads(other, "left") - joint_heads(armature, "right") * MIRROR
        assert np.abs(error).max() < 2e-3
    # Handles too, in between: a Bezier bulge is mirrored.
    bpy.context.scene.frame_set(5, subframe=0.5)
    error = joint_heads(other, "left") - joint_heads(armature, "right") * MIRROR
    assert np.abs(error).max() < 2e-3
    paths = {c.data_path for c in action_curves(other.animation_data.action)}
    assert not [p for p in paths if ".R" in p]


def test_hands_do_not_overlap(make_take):
    """In the middle of the picture the mirror stands beside the hand."""
    made = make_take(sides=("right",))
    source = build_take(made.take).hands[0]

    def width(armature, side) -> np.ndarray:
        found = []
        for _, frame in made.seen:
            bpy.context.scene.frame_set(frame)
            found.append(joint_heads(armature, side)[:, 0])
        return np.array(found)

    own = width(source.armature, "right")
    assert own.min() < 0 < own.max()
    other = width(mirrored(source), "left")
    assert other.min() > own.max() or other.max() < own.min()


def test_it_is_a_captured_hand_of_the_same_capture(make_take, tmp_path):
    made = aside(make_take(sides=("right",)))
    built = build_take(made.take)
    other = mirrored(built.hands[0])
    hand, source = hand_of(other), hand_of(built.hands[0].armature)
    assert hand is not None
    assert source is not None
    assert hand.collection == source.collection == built.collection
    assert [t.side for t in hand.take.hands] == ["right", "left"]
    assert hand.track.filled is not None
    assert not hand.track.detected.any()
    np.testing.assert_array_equal(hand.track.present, source.track.present)
    np.testing.assert_allclose(list(other.manient.betas), list(source.armature.manient.betas))
    row, frame = made.seen[2]
    bpy.context.scene.frame_set(frame)
    wrist = hand.track.joints_3d[row, 0]
    np.testing.assert_allclose(joint_heads(other, "left")[0], [wrist[0], wrist[2], -wrist[1]], atol=1e-4)
    # And its shape can be changed like any other's.
    other.manient.betas[0] += 1.0
    np.testing.assert_allclose(list(other["betas"]), list(other.manient.betas), atol=1e-6)


def test_a_hand_of_an_older_model_stays_one_beside_a_mirrored_hand_of_its_side(make_take):
    """The take has one digest a side."""
    made = aside(make_take(model_digests={"left": "0" * 16, "right": "0" * 16}))
    older = tuple(replace(track, joints_3d=track.joints_3d + 0.01) for track in made.take.hands)
    built = build_take(replace(made.take, hands=older))
    new = hand_of(mirrored(built.hands[0]))
    assert [hand_of(hand.armature).is_of_other_model() for hand in built.hands] == [True, True]
    assert not new.is_of_other_model(), "it was made with the present one"


def test_a_moved_rig_without_keys_and_undo(make_take):
    source = build_take(aside(make_take(sides=("right",))).take).hands[0].armature
    name, count = source.name, len(bpy.data.objects)
    source.animation_data_clear()
    source.location = (1.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message="before")
    bpy.context.view_layer.objects.active = source
    bpy.ops.manient.mirror_hand()
    bpy.ops.ed.undo_push(message="mirrored")
    other = bpy.context.view_layer.objects.active
    bpy.context.view_layer.update()
    mine = joint_heads(source, "right") - [1.0, 2.0, 3.0]
    np.testing.assert_allclose(joint_heads(other, "left")[0], mine[0] * MIRROR + [1, 2, 3], atol=1e-5)
    bpy.ops.ed.undo()
    assert len(bpy.data.objects) == count
    hand = hand_of(bpy.data.objects[name])
    assert hand is not None
    assert len(hand.take.hands) == 1


def test_the_other_sides_model_is_needed(make_take, imitation_mano, tmp_path):
    import shutil

    shutil.copy(imitation_mano / "MANO_RIGHT.npz", tmp_path / "MANO_RIGHT.npz")
    made = make_take(sides=("right",), model=str(tmp_path))
    source = build_take(made.take).hands[0]
    count = len(bpy.data.objects), len(bpy.data.actions)
    bpy.context.view_layer.objects.active = source.armature
    with pytest.raises(RuntimeError, match="has no MANO_LEFT"):
        bpy.ops.manient.mirror_hand()
    assert (len(bpy.data.objects), len(bpy.data.actions)) == count
