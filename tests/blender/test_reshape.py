"""Shape sliders: mesh, bones and keys become those of the other shape, and everything else stays."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.common import preferences
from blender_manient.panels.shape import MANIENT_PT_shape
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import reshape
from blender_manient.scene.actions import push_down
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import pose_at, read_pose_keys, remove_pose_keys
from blender_manient.scene.mirror import mirror_hand
from blender_manient.scene.store import hand_of
from handfit_core.common.errors import HandModelError
from handfit_core.geometry.rotations import quat_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import REST_FROM_MODEL
from handfit_core.hand_model.forearm import with_wrist
from tests.drawn import drawn

from .conftest import built_model, evaluated_vertices, joint_heads, world
from .looking import curves_of

pytestmark = pytest.mark.usefixtures("registered")

BETAS = np.array([1.5, -2.0, 1.0, 0.5, -1.0, 2.0, -0.5, 1.0, -1.5, 0.7])


def shape_error(made, hands, betas, rows=None) -> float:
    """Metres from the skin to the model with that shape, the same pose, and its wrist where it was."""
    worst = 0.0
    for hand in hands:
        model = built_model(made.take.model, hand.side)
        track = next(t for t in made.take.hands if t.side == hand.side)
        moved = model.shaped(track.betas).joints[0] - model.shaped(betas).joints[0]
        posed = model.posed(betas, track.global_orient, track.hand_pose, track.transl + moved)
        for row, frame in made.seen if rows is None else [made.seen[row] for row in rows]:
            bpy.context.scene.frame_set(frame)
            error = np.abs(evaluated_vertices(hand.mesh) - world(posed.vertices[row])).max()
            worst = max(worst, float(error))
    return worst


def test_the_hand_is_the_models_with_the_new_shape(make_take, model):
    """In many small steps; one hand after the other, and back."""
    made = make_take(model=model)
    left, right = build_take(made.take).hands
    shapes = [np.array(hand.armature.manient.betas) for hand in (left, right)]
    for part in np.linspace(0.0, 1.0, 10):
        right.armature.manient.betas = shapes[1] + part * (BETAS - shapes[1])
    assert shape_error(made, [right], BETAS) < 1e-4
    assert shape_error(made, [left], shapes[0], [4]) < 1e-4
    bpy.context.view_layer.objects.active = right.armature
    assert bpy.ops.manient.reset_shape() == {"FINISHED"}
    assert shape_error(made, [right], shapes[1], [4]) < 1e-4


def test_undo_and_redo_bring_back_everything_together(armature):
    name = armature.name

    def state():
        hand = hand_of(bpy.data.objects[name])
        heads = [bone.head_local[:] for bone in hand.armature.data.bones]
        vertices = [vertex.co[:] for vertex in hand.mesh.data.vertices]
        shape = hand.armature.manient.betas, hand.armature["betas"]
        return [np.array(v) for v in (*shape, heads, vertices, read_pose_keys(rig_of(hand.armature)).quats)]

    bpy.ops.ed.undo_push(message="captured")
    states = [state()]
    for betas in (BETAS, -BETAS):
        bpy.data.objects[name].manient.betas = betas
        bpy.ops.ed.undo_push(message="shaped")
        states.append(state())
    assert np.abs(states[1][3] - states[0][3]).max() > 1e-3
    undo, redo = bpy.ops.ed.undo, bpy.ops.ed.redo
    for step, expected in ((undo, 1), (undo, 0), (redo, 1), (redo, 2)):
        step()
        for one, other in zip(state(), states[expected], strict=True):
            np.testing.assert_allclose(one, other, atol=1e-6)


def test_an_undo_step_between_slider_and_hand_is_made_whole(made, armature, monkeypatch):
    """With a window the hand follows a moment after the slider, perhaps after the slider's undo step."""
    name = armature.name
    with monkeypatch.context() as later:
        later.delitem(preferences.listeners, "shape")
        armature.manient.betas = BETAS
    bpy.ops.ed.undo_push(message="slider")
    assert not reshape.is_current(armature)
    reshape.reshape(armature)  # too late for that step
    armature.manient.betas = -BETAS
    bpy.ops.ed.undo_push(message="another")
    bpy.ops.ed.undo()
    armature = bpy.data.objects[name]
    assert reshape.is_current(armature)
    assert shape_error(made, [hand_of(armature)], BETAS, [4]) < 1e-4


@pytest.mark.parametrize("state", ["object", "pose", "hidden", "excluded", "edit armature", "edit mesh"])
def test_mode_active_object_and_selection_stay(made, built, state):
    (hand,) = built.hands
    bpy.ops.mesh.primitive_cube_add()
    layer = bpy.context.view_layer
    collection = layer.layer_collection.children[built.collection.name]
    if state == "hidden":
        hand.armature.hide_viewport = True
        hand.armature.hide_set(True)
    elif state == "excluded":
        collection.exclude = True
    elif state != "object":
        layer.objects.active = hand.mesh if state == "edit mesh" else hand.armature
        bpy.ops.object.mode_set(mode="POSE" if state == "pose" else "EDIT")

    def seen():
        layer.update()
        selected = {o for o in layer.objects if o.select_get()}
        return layer.objects.active, bpy.context.mode, selected, set(bpy.data.objects), len(bpy.data.scenes)

    before = seen()
    hand.armature.manient.betas = BETAS
    assert seen() == before
    if bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    hand.armature.hide_viewport = collection.exclude = False
    hand.armature.hide_set(False)
    assert shape_error(made, built.hands, BETAS, [4]) < 1e-4


def test_linked_duplicates_keep_their_shape(made, built):
    (hand,) = built.hands
    other, rig = hand.mesh.copy(), hand.armature.copy()  # they share the mesh, and bones and action
    for copy in (other, rig):
        built.collection.objects.link(copy)
    other.parent = other.modifiers[0].object = rig
    hand.armature.manient.betas = BETAS
    assert shape_error(made, built.hands, BETAS, [2]) < 1e-4
    row, _ = made.seen[2]
    assert np.abs(evaluated_vertices(other) - world(made.vertices["right"][row])).max() < 1e-4


def test_what_the_artist_did_to_the_mesh_stays(make_take, model):
    (hand,) = build_take(make_take(sides=("right",), model=model).take).hands
    shapes = hand.mesh.data.shape_keys
    for points in (hand.mesh.data.vertices, *([shapes.key_blocks[0].data] if shapes else ())):
        points[7].co.x += 0.02
    hand.armature.manient.betas = BETAS
    expected = built_model(model, "right").shaped(BETAS).vertices @ REST_FROM_MODEL.T
    expected[7, 0] += 0.02
    np.testing.assert_allclose([v.co[:] for v in hand.mesh.data.vertices], expected, atol=1e-6)


def test_each_bone_keeps_its_own_keys(armature):
    rig, bones = rig_of(armature), bone_names("right")
    remove_pose_keys(rig, 5, 14, joints=[2, 3], location=True)
    armature.pose.bones[bones[6]].rotation_mode = "XYZ"  # its quaternion curves no longer count
    curve = next(c for c in curves_of(armature) if bones[1] in c.data_path)
    curve.keyframe_points[3].interpolation = "BEZIER"

    def places():
        keys, rest = read_pose_keys(rig), rig_of(armature).rest
        turns = rest.frames @ quat_to_rotmat(keys.quats) @ np.swapaxes(rest.frames, -1, -2)
        wrist = np.array(armature.data.bones[bones[0]].head_local)
        return keys, turns, (wrist + keys.locations @ rest.frames[0].T)[keys.location_keyed]

    before, turns, wrists = places()
    armature.manient.betas = BETAS
    after, turns_after, wrists_after = places()
    for name in ("frames", "rotation_keyed", "location_keyed"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    assert not before.rotation_keyed[:, 6].any()
    np.testing.assert_allclose(turns_after, turns, atol=2e-6)
    np.testing.assert_allclose(wrists_after, wrists, atol=1e-6)
    assert curve.keyframe_points[3].interpolation == "BEZIER"


@pytest.mark.parametrize("motion", ["strip", "none"])
def test_a_strip_follows_and_a_pose_without_keys_stays(made, built, armature, motion):
    data, (_, frame) = armature.animation_data, made.seen[3]
    if motion == "strip":
        push_down(data)
    else:
        quats, locations = pose_at(rig_of(armature), np.array([frame]))
        armature.animation_data_clear()
        for name, quat in zip(bone_names("right"), quats[0], strict=True):
            armature.pose.bones[name].rotation_quaternion = quat
        armature.pose.bones[bone_names("right")[0]].location = locations[0]
    armature.manient.betas = BETAS
    bpy.context.view_layer.update()
    assert shape_error(made, built.hands, BETAS, [3]) < 1e-4


def test_a_changed_mesh_and_other_objects_are_left_alone(built):
    (hand,) = built.hands
    count = len(hand.mesh.data.vertices)
    hand.mesh.data.vertices.add(5)
    heads = joint_heads(hand.armature, "right")
    hand.armature.manient.is_hand = False  # so that nothing follows by itself
    hand.armature.manient.betas = BETAS
    hand.armature.manient.is_hand = True
    with pytest.raises(HandModelError, match=f"has {count + 5} vertices"):
        reshape.reshape(hand.armature)
    np.testing.assert_allclose(joint_heads(hand.armature, "right"), heads)
    bpy.ops.object.armature_add()
    bpy.context.object.manient.betas = BETAS
    assert reshape.is_current(bpy.context.object)


@pytest.mark.parametrize("with_own_key", [False, True])
def test_the_forearm_can_be_shown_and_hidden(made, built, with_own_key):
    """At first a cap closes the wrist in the same vertices."""
    (hand,) = built.hands
    shape = hand.armature.manient
    assert (shape.wrist, shape.forearm) == ("cap", False)
    shape.forearm = True
    assert "forearm" in drawn(MANIENT_PT_shape).said
    if with_own_key:  # it is moved along, as the correctives are
        hand.mesh.shape_key_add(name="mine", from_mix=False).value = 1.0
    before = evaluated_vertices(hand.mesh)
    plain, track = load_model("open-hand", "right"), made.take.hands[0]
    row, frame = made.seen[0]
    pose = (track.betas, track.global_orient[row], track.hand_pose[row], track.transl[row])
    cap = world(with_wrist(plain, "cap").posed(*pose).vertices)
    bpy.context.scene.frame_set(frame)
    shape.forearm = False
    # Blender leaves out products of the pose that move the skin by less than 0.2 mm.
    np.testing.assert_allclose(evaluated_vertices(hand.mesh), cap, atol=5e-5)
    shape.betas = BETAS  # the shape of what is shown now
    shape.betas = track.betas
    np.testing.assert_allclose(evaluated_vertices(hand.mesh), cap, atol=5e-5)
    mirrored = mirror_hand(hand_of(hand.armature)).manient
    assert (mirrored.wrist, mirrored.forearm) == ("cap", False)
    shape.forearm = True
    np.testing.assert_allclose(evaluated_vertices(hand.mesh), before, atol=1e-5)
    count = len(plain.v_template)
    assert np.abs(before[count:] - cap[count:]).max() > 0.04
    np.testing.assert_allclose(before[:count], cap[:count], atol=5e-5)


def test_hands_without_a_forearm_stay_open(made, make_take, imitation_mano):
    """As every hand of a file from before there were forearms, and of models without an edge at the wrist."""
    (hand,) = build_take(made.take, wrist="open").hands
    assert "forearm" not in drawn(MANIENT_PT_shape).said
    hand.armature.manient.forearm = True
    hand.armature.manient.betas = BETAS
    assert reshape.is_current(hand.armature)
    assert len(hand.mesh.data.vertices) == len(load_model("open-hand", "right").v_template)
    (hand,) = build_take(make_take(sides=("right",), model=str(imitation_mano)).take).hands
    assert (hand.armature.manient.wrist, hand.armature.manient.forearm) == ("open", False)
