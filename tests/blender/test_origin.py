"""The origin goes to the wrist, and nothing else moves: not the hand, what hangs on it, or the picture."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from blender_manient.exporters.take import retaken
from blender_manient.rigs import rig_of
from blender_manient.scene.actions import BELOW, strip_below
from blender_manient.scene.build import build_take
from blender_manient.scene.corrections import clear_corrections, correct_frames, displaced
from blender_manient.scene.keys import pose_at, read_pose_keys
from blender_manient.scene.layer import add_layer, end_layer
from blender_manient.scene.store import hand_of
from handfit_core.skeleton import SIDES

from .conftest import FRAMES, evaluated_vertices, joint_heads

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture(params=SIDES)
def hand(request, make_take):
    """A captured hand, active, in the middle of its motion, under a parent that is turned and scaled."""
    made = make_take(sides=(request.param,))
    armature = build_take(made.take).hands[0].armature
    parent = bpy.data.objects.new("parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.matrix_basis = Matrix.LocRotScale((0.5, -0.2, 0.1), Matrix.Rotation(0.7, 3, "Z"), (1.5,) * 3)
    armature.parent = parent
    armature.rotation_euler = (0.2, 0.1, 0.0)
    armature.delta_location = (0.0, 0.3, 0.0)
    bpy.context.view_layer.objects.active = armature
    bpy.context.scene.frame_set(int(FRAMES[2]))
    return armature


def everywhere(armature) -> tuple[np.ndarray, np.ndarray]:
    """The mesh's vertices and the bones' heads in the world, on every frame."""
    vertices, heads = [], []
    frame = bpy.context.scene.frame_current
    for each in FRAMES:
        bpy.context.scene.frame_set(int(each))
        vertices.append(evaluated_vertices(armature.manient.mesh))
        heads.append(joint_heads(armature, armature.manient.side))
    bpy.context.scene.frame_set(frame)
    return np.array(vertices), np.array(heads)


def origin(armature) -> np.ndarray:
    bpy.context.view_layer.update()
    return np.array(armature.matrix_world.translation)


def test_the_origin_is_at_the_wrist_and_nothing_moves(hand):
    before = everywhere(hand)
    keys = read_pose_keys(rig_of(hand))
    turned = tuple(hand.rotation_euler), tuple(hand.scale)
    assert bpy.ops.manient.origin_to_wrist() == {"FINISHED"}
    np.testing.assert_allclose(origin(hand), before[1][2, 0], atol=1e-6)
    for one, other in zip(before, everywhere(hand), strict=True):
        assert np.abs(one - other).max() < 2e-6
    assert turned == (tuple(hand.rotation_euler), tuple(hand.scale))
    after = read_pose_keys(rig_of(hand))
    np.testing.assert_array_equal(after.quats, keys.quats)
    np.testing.assert_array_equal(after.frames, keys.frames)
    bpy.context.scene.frame_set(int(FRAMES[7]))  # and again, elsewhere
    assert bpy.ops.manient.origin_to_wrist() == {"FINISHED"}
    np.testing.assert_allclose(origin(hand), before[1][7, 0], atol=1e-6)
    for one, other in zip(before, everywhere(hand), strict=True):
        assert np.abs(one - other).max() < 4e-6


def test_what_hangs_on_the_hand_stays(hand):
    rig = rig_of(hand)
    ring, prop, glove = (bpy.data.objects.new(name, None) for name in ("ring", "prop", "glove"))
    glove = bpy.data.objects.new("glove", hand.manient.mesh.data.copy())
    for obj in (ring, prop, glove):
        bpy.context.scene.collection.objects.link(obj)
    ring.parent, ring.parent_type, ring.parent_bone = hand, "BONE", rig.bones[1]
    prop.parent, prop.location = hand, (0.1, 0.2, 0.3)
    for index in range(16):
        glove.vertex_groups.new(name=rig.bones[index])
    glove.modifiers.new("Armature", "ARMATURE").object = hand
    bpy.context.view_layer.update()
    glove.matrix_world = hand.matrix_world.copy()

    def places():
        bpy.context.view_layer.update()
        return [*(np.array(o.matrix_world) for o in (ring, prop)), evaluated_vertices(glove)]

    before = places()
    assert bpy.ops.manient.origin_to_wrist() == {"FINISHED"}
    for one, other in zip(before, places(), strict=True):
        np.testing.assert_allclose(one, other, atol=2e-6)


def test_the_keys_say_the_same_about_the_picture(hand):
    """Drags, re-fits and exported takes measure the hand against the picture."""

    def in_the_picture():
        captured = hand_of(hand)
        said = captured.rig.from_bones(captured.shaped(), *pose_at(captured.rig, FRAMES.astype(float)))
        track = retaken([captured]).hands[0]
        return [*said, track.transl, track.joints_3d]

    before = in_the_picture()
    assert bpy.ops.manient.origin_to_wrist() == {"FINISHED"}
    for one, other in zip(before, in_the_picture(), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_corrections_stay_and_can_be_cleared(hand):
    rig = rig_of(hand)
    before = pose_at(rig, FRAMES.astype(float))
    quats, locations = pose_at(rig, np.array([7.0]))
    correct_frames(hand, [7.0], quats, locations + 0.02, 3.0, pins=[{8: (10.0, 12.0)}])
    assert bpy.ops.manient.origin_to_wrist() == {"FINISHED"}
    assert displaced(hand) == []
    clear_corrections(hand)
    after = pose_at(rig, FRAMES.astype(float))
    moved = before[1] - after[1]
    np.testing.assert_allclose(after[0], before[0], atol=1e-6)
    np.testing.assert_allclose(moved, np.broadcast_to(moved[0], moved.shape), atol=1e-6)


def test_the_shape_and_the_other_hand_follow(hand):
    side = hand.manient.side
    mirrored = []
    for _ in range(2):
        bpy.context.view_layer.objects.active = hand
        assert bpy.ops.manient.mirror_hand() == {"FINISHED"}
        mirrored.append(everywhere(bpy.context.view_layer.objects.active)[1])
        bpy.context.view_layer.objects.active = hand
        assert bpy.ops.manient.origin_to_wrist() == {"FINISHED"}
    np.testing.assert_allclose(mirrored[1], mirrored[0], atol=5e-6)
    wrist = joint_heads(hand, side)[0]
    hand.manient.betas[0] += 1.0
    bpy.context.view_layer.update()
    np.testing.assert_allclose(joint_heads(hand, side)[0], wrist, atol=1e-5)


def test_with_controls(hand):
    bpy.ops.manient.add_controls()
    hand.pose.bones[rig_of(hand).controls["hand"]].location = (0.03, 0.02, 0.01)
    hand.pose.bones[rig_of(hand).controls["index"]].rotation_euler.x = 0.3
    before = everywhere(hand)
    assert bpy.ops.manient.origin_to_wrist() == {"FINISHED"}
    np.testing.assert_allclose(origin(hand), before[1][2, 0], atol=1e-6)
    for one, other in zip(before, everywhere(hand), strict=True):
        assert np.abs(one - other).max() < 3e-6


@pytest.mark.parametrize("shared", [False, True])
def test_with_a_layer_on_top(hand, shared):
    wrist, along = hand.pose.bones[rig_of(hand).bones[0]], (0.03, 0.02, 0.01)
    add_layer(hand)
    wrist.location = along
    wrist.keyframe_insert("location", frame=int(FRAMES[2]))
    twin = hand.copy() if shared else None
    before = everywhere(hand)
    assert bpy.ops.manient.origin_to_wrist() == {"FINISHED"}
    np.testing.assert_allclose(origin(hand), before[1][2, 0], atol=1e-6)
    for one, other in zip(before, everywhere(hand), strict=True):
        assert np.abs(one - other).max() < 3e-6
    if twin is not None:
        assert strip_below(twin).action == twin.animation_data.action[BELOW] != strip_below(hand).action
    end_layer(hand, merge=True)
    for one, other in zip(before, everywhere(hand), strict=True):
        assert np.abs(one - other).max() < 3e-6


def test_no_origin_while_a_strip_is_edited(hand):
    """The hand would jump when that ends."""
    add_layer(hand)
    hand.animation_data.nla_tracks[0].strips[0].select = True
    hand.animation_data.use_tweak_mode = True
    assert hand.animation_data.use_tweak_mode
    with pytest.raises(RuntimeError, match="leave tweak mode"):
        bpy.ops.manient.origin_to_wrist()


def test_an_object_that_moves_itself_is_refused(hand):
    hand.keyframe_insert("location", frame=1)
    with pytest.raises(RuntimeError, match="itself is animated, driven or constrained"):
        bpy.ops.manient.origin_to_wrist()
