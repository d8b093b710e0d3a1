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
from blender_manient.scene.corrections import clear_corrections, displaced
from blender_manient.scene.keys import pose_at, read_pose_keys
from blender_manient.scene.layer import add_layer, end_layer
from blender_manient.scene.store import hand_of
from handfit_core.common.skeleton import SIDES

from .conftest import FRAMES, evaluated_vertices, joint_heads
from .test_corrections import correct

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


def origin(armature) -> np.ndarray:
    bpy.context.view_layer.update()
    return np.array(armature.matrix_world.translation)


def everywhere(armature) -> tuple[np.ndarray, np.ndarray]:
    """The mesh's vertices and the bones' heads in the world, on every frame."""
    found, frame = [], bpy.context.scene.frame_current
    for each in FRAMES:
        bpy.context.scene.frame_set(int(each))
        vertices = evaluated_vertices(armature.manient.mesh)
        found.append((vertices, joint_heads(armature, armature.manient.side)))
    bpy.context.scene.frame_set(frame)
    return tuple(np.array(each) for each in zip(*found, strict=True))


def to_wrist(hand) -> None:
    """Put the origin there, and see that nothing else moves."""
    before = everywhere(hand)
    row = int(np.flatnonzero(bpy.context.scene.frame_current == FRAMES)[0])
    assert bpy.ops.manient.origin_to_wrist() == {"FINISHED"}
    np.testing.assert_allclose(origin(hand), before[1][row, 0], atol=1e-6)
    for one, other in zip(before, everywhere(hand), strict=True):
        assert np.abs(one - other).max() < 4e-6


def test_the_origin_is_at_the_wrist_and_nothing_moves(hand):
    """Keys say the same about the picture: drags, re-fits and exported takes measure the hand against it."""

    def in_the_picture():
        captured = hand_of(hand)
        said = captured.rig.from_bones(captured.shaped(), *pose_at(captured.rig, FRAMES.astype(float)))
        track = retaken([captured]).hands[0]
        return [*said, track.transl, track.joints_3d]

    keys, turned, pictured = read_pose_keys(rig_of(hand)), hand.rotation_euler[:], in_the_picture()
    to_wrist(hand)
    assert hand.rotation_euler[:] == turned
    after = read_pose_keys(rig_of(hand))
    np.testing.assert_array_equal(after.quats, keys.quats)
    np.testing.assert_array_equal(after.frames, keys.frames)
    for one, other in zip(pictured, in_the_picture(), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)
    bpy.context.scene.frame_set(int(FRAMES[7]))
    to_wrist(hand)


def test_what_hangs_on_the_hand_stays(hand):
    rig = rig_of(hand)
    ring, prop = (bpy.data.objects.new(name, None) for name in ("ring", "prop"))
    glove = bpy.data.objects.new("glove", hand.manient.mesh.data.copy())
    for obj in (ring, prop, glove):
        bpy.context.scene.collection.objects.link(obj)
    ring.parent, ring.parent_type, ring.parent_bone = hand, "BONE", rig.bones[1]
    prop.parent, prop.location = hand, (0.1, 0.2, 0.3)
    for name in rig.bones:
        glove.vertex_groups.new(name=name)
    glove.modifiers.new("Armature", "ARMATURE").object = hand
    bpy.context.view_layer.update()
    glove.matrix_world = hand.matrix_world.copy()

    def places():
        bpy.context.view_layer.update()
        return [np.array(ring.matrix_world), np.array(prop.matrix_world), evaluated_vertices(glove)]

    before = places()
    to_wrist(hand)
    for one, other in zip(before, places(), strict=True):
        np.testing.assert_allclose(one, other, atol=2e-6)


def test_corrections_stay_and_can_be_cleared(hand):
    quats, locations = pose_at(rig_of(hand), FRAMES.astype(float))
    correct(hand, frame=7, spread=3.0)
    to_wrist(hand)
    assert displaced(hand) == []
    clear_corrections(hand)
    after = pose_at(rig_of(hand), FRAMES.astype(float))
    np.testing.assert_allclose(after[0], quats, atol=1e-6)
    assert np.ptp(locations - after[1], axis=0).max() < 1e-6


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
    to_wrist(hand)


@pytest.mark.parametrize("shared", [False, True])
def test_with_a_layer_on_top(hand, shared):
    wrist = hand.pose.bones[rig_of(hand).bones[0]]
    add_layer(hand)
    wrist.location = (0.03, 0.02, 0.01)
    wrist.keyframe_insert("location", frame=int(FRAMES[2]))
    twin = hand.copy() if shared else None
    before = everywhere(hand)
    to_wrist(hand)
    if twin is not None:
        assert strip_below(twin).action == twin.animation_data.action[BELOW] != strip_below(hand).action
    end_layer(hand, merge=True)
    for one, other in zip(before, everywhere(hand), strict=True):
        assert np.abs(one - other).max() < 4e-6


@pytest.mark.parametrize("why", ["leave tweak mode", "itself is animated, driven or constrained"])
def test_where_the_hand_would_jump_it_is_refused(hand, why):
    if why == "leave tweak mode":
        add_layer(hand)
        hand.animation_data.nla_tracks[0].strips[0].select = True
        hand.animation_data.use_tweak_mode = True
    else:
        hand.keyframe_insert("location", frame=1)
    with pytest.raises(RuntimeError, match=why):
        bpy.ops.manient.origin_to_wrist()
