"""Shape sliders: mesh, bones and keys become those of the other shape, and everything else stays."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient.common import preferences
from blender_manient.common.blender_versions import channels
from blender_manient.panels.shape import MANIENT_PT_shape
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import reshape
from blender_manient.scene.build import build_take
from blender_manient.scene.corrections import clear_corrections, correct_frames
from blender_manient.scene.keys import pose_at, read_pose_keys, remove_pose_keys
from blender_manient.scene.mirror import mirror_hand
from blender_manient.scene.store import hand_of
from handfit_core.errors import HandModelError
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import REST_FROM_MODEL, points_to_rest
from handfit_core.hand_model.forearm import with_wrist
from tests.drawn import drawn

from .conftest import built_model, evaluated_vertices, joint_heads, world

pytestmark = pytest.mark.usefixtures("registered")

BETAS = np.array([1.5, -2.0, 1.0, 0.5, -1.0, 2.0, -0.5, 1.0, -1.5, 0.7])


def expected_vertices(made, side, betas) -> np.ndarray:
    """(T, V, 3) the model with another shape, the same pose, and its wrist where it was."""
    model = built_model(made.take.model, side)
    track = next(t for t in made.take.hands if t.side == side)
    moved = model.shaped(track.betas).joints[0] - model.shaped(betas).joints[0]
    posed = model.posed(betas, track.global_orient, track.hand_pose, track.transl + moved)
    return world(posed.vertices)


def worst_error(made, hands, betas) -> float:
    worst = 0.0
    for hand in hands:
        expected = expected_vertices(made, hand.side, betas)
        for row, frame in made.seen:
            bpy.context.scene.frame_set(frame)
            worst = max(worst, np.abs(evaluated_vertices(hand.mesh) - expected[row]).max())
    print(f"worst vertex error {worst * 1000:.5f} mm")
    return worst


def test_the_hand_is_the_models_with_the_new_shape(make_take, model):
    made = make_take(model=model)
    built = build_take(made.take)
    for hand in built.hands:
        hand.armature.manient.betas = BETAS
    assert worst_error(made, built.hands, BETAS) < 1e-4


def test_many_small_steps_end_where_one_large_one_does(make_take, model):
    made = make_take(sides=("right",), model=model)
    built = build_take(made.take)
    (hand,) = built.hands
    before = np.array(hand.armature.manient.betas)
    for part in np.linspace(0.0, 1.0, 30):
        hand.armature.manient.betas = before + part * (BETAS - before)
    assert worst_error(made, built.hands, BETAS) < 1e-4


def test_undo_and_redo_bring_back_everything_together(make_take):
    made = make_take(sides=("right",))
    built = build_take(made.take)
    name, mesh_name = built.hands[0].armature.name, built.hands[0].mesh.name

    def state():
        hand = bpy.data.objects[name]
        heads = [list(bone.head_local) for bone in hand.data.bones]
        vertices = np.empty((len(bpy.data.objects[mesh_name].data.vertices), 3), dtype=np.float32)
        bpy.data.objects[mesh_name].data.vertices.foreach_get("co", vertices.ravel())
        keys = read_pose_keys(rig_of(hand))
        return [np.array(v) for v in (hand.manient.betas, hand["betas"], heads, vertices, keys.quats)]

    def assert_same(one, other):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-6)

    bpy.ops.ed.undo_push(message="captured")
    captured = state()
    bpy.data.objects[name].manient.betas = BETAS
    bpy.ops.ed.undo_push(message="first")
    first = state()
    assert np.abs(first[3] - captured[3]).max() > 1e-3
    bpy.data.objects[name].manient.betas = -BETAS
    bpy.ops.ed.undo_push(message="second")
    second = state()
    bpy.ops.ed.undo()
    assert_same(state(), first)
    bpy.ops.ed.undo()
    assert_same(state(), captured)
    bpy.ops.ed.redo()
    assert_same(state(), first)
    bpy.ops.ed.redo()
    assert_same(state(), second)


def test_an_undo_step_between_slider_and_hand_is_made_whole(make_take, monkeypatch):
    """With a window the hand follows a moment after the slider, perhaps after the slider's undo step."""
    made = make_take(sides=("right",))
    built = build_take(made.take)
    name = built.hands[0].armature.name
    bpy.ops.ed.undo_push(message="captured")
    with monkeypatch.context() as later:
        later.delitem(preferences.listeners, "shape")
        bpy.data.objects[name].manient.betas = BETAS
    bpy.ops.ed.undo_push(message="slider")
    assert not reshape.is_current(bpy.data.objects[name])
    reshape.reshape(bpy.data.objects[name])  # too late for that step
    bpy.data.objects[name].manient.betas = -BETAS
    bpy.ops.ed.undo_push(message="another")
    bpy.ops.ed.undo()
    armature = bpy.data.objects[name]
    np.testing.assert_allclose(list(armature.manient.betas), BETAS, atol=1e-6)
    assert reshape.is_current(armature)
    assert worst_error(made, [hand_of(armature)], BETAS) < 1e-4


@pytest.mark.parametrize("state", ["object", "pose", "hidden", "excluded", "edit armature", "edit mesh"])
def test_mode_active_object_and_selection_stay(make_take, state):
    made = make_take(sides=("right",))
    built = build_take(made.take)
    (hand,) = built.hands
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    layer = bpy.context.view_layer
    if state == "pose":
        layer.objects.active = hand.armature
        bpy.ops.object.mode_set(mode="POSE")
    elif state == "hidden":
        hand.armature.hide_viewport = True
        hand.armature.hide_set(True)
    elif state == "excluded":
        layer.layer_collection.children[built.collection.name].exclude = True
    elif state.startswith("edit"):
        layer.objects.active = hand.armature if state == "edit armature" else hand.mesh
        bpy.ops.object.mode_set(mode="EDIT")
    before = (layer.objects.active, bpy.context.mode, {o for o in layer.objects if o.select_get()})
    objects = set(bpy.data.objects)
    hand.armature.manient.betas = BETAS
    assert (layer.objects.active, bpy.context.mode, {o for o in layer.objects if o.select_get()}) == before
    assert set(bpy.data.objects) == objects
    assert len(bpy.data.scenes) == 1
    if state != "object" and bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    hand.armature.hide_viewport = False
    layer.layer_collection.children[built.collection.name].exclude = False
    hand.armature.hide_set(False)
    assert worst_error(made, built.hands, BETAS) < 1e-4
    assert cube.name in bpy.data.objects


def test_linked_duplicates_keep_their_shape(make_take):
    made = make_take(sides=("right",))
    built = build_take(made.take)
    (hand,) = built.hands
    other = hand.mesh.copy()  # shares the mesh
    rig = hand.armature.copy()  # shares bones and action
    for copy in (other, rig):
        built.collection.objects.link(copy)
    other.parent = rig
    other.modifiers[0].object = rig
    hand.armature.manient.betas = BETAS
    assert worst_error(made, built.hands, BETAS) < 1e-4
    row, frame = made.seen[2]
    bpy.context.scene.frame_set(frame)
    error = np.abs(evaluated_vertices(other) - world(made.vertices["right"][row])).max()
    assert error < 1e-4


def test_what_the_artist_did_to_the_mesh_stays(make_take, model):
    made = make_take(sides=("right",), model=model)
    (hand,) = build_take(made.take).hands
    points = hand.mesh.data.shape_keys.key_blocks[0].data if hand.mesh.data.shape_keys else None
    for owner in (hand.mesh.data.vertices, points):
        if owner is not None:
            owner[7].co.x += 0.02
    before = built_model(made.take.model, "right").shaped(made.take.hands[0].betas).vertices
    after = built_model(made.take.model, "right").shaped(BETAS).vertices
    hand.armature.manient.betas = BETAS
    expected = after @ REST_FROM_MODEL.T
    expected[7, 0] += 0.02
    found = np.array([v.co for v in hand.mesh.data.vertices])
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert np.abs(before - after).max() > 1e-3


def test_each_bone_keeps_its_own_keys(make_take):
    made = make_take(sides=("right",))
    (hand,) = build_take(made.take).hands
    armature = hand.armature
    remove_pose_keys(rig_of(armature), 5, 14, joints=[2, 3], location=True)
    bones = bone_names("right")
    armature.pose.bones[bones[6]].rotation_mode = "XYZ"  # its quaternion curves no longer count
    curve = (
        next(c for c in armature.animation_data.action.fcurves if bones[1] in c.data_path)
        if hasattr(armature.animation_data.action, "fcurves")
        else channels(armature.animation_data.action, armature.animation_data.action_slot).fcurves[4]
    )
    curve.keyframe_points[3].interpolation = "BEZIER"
    before = read_pose_keys(rig_of(armature))
    rotations = _rest_rotations(armature, before.quats)
    place = _places(armature, before.locations)
    armature.manient.betas = BETAS
    after = read_pose_keys(rig_of(armature))
    np.testing.assert_array_equal(after.frames, before.frames)
    np.testing.assert_array_equal(after.rotation_keyed, before.rotation_keyed)
    np.testing.assert_array_equal(after.location_keyed, before.location_keyed)
    assert not before.rotation_keyed[:, 6].any()
    np.testing.assert_allclose(_rest_rotations(armature, after.quats), rotations, atol=2e-6)
    keyed = before.location_keyed
    np.testing.assert_allclose(_places(armature, after.locations)[keyed], place[keyed], atol=1e-6)
    assert curve.keyframe_points[3].interpolation == "BEZIER"


def _rest_rotations(armature, quats) -> np.ndarray:
    from handfit_core.geometry.rotations import quat_to_rotmat

    frames = rig_of(armature).rest.frames
    return frames @ quat_to_rotmat(quats) @ np.swapaxes(frames, -1, -2)


def _places(armature, locations) -> np.ndarray:
    wrist = np.array(armature.data.bones[bone_names("right")[0]].head_local)
    return wrist + locations @ rig_of(armature).rest.frames[0].T


def test_actions_in_the_nla_follow_too(make_take):
    made = make_take(sides=("right",))
    built = build_take(made.take)
    armature = built.hands[0].armature
    data = armature.animation_data
    action, slot = data.action, getattr(data, "action_slot", None)
    strip = data.nla_tracks.new().strips.new("hand", int(action.frame_range[0]), action)
    if slot is not None:
        strip.action_slot = slot
    data.action = None
    armature.manient.betas = BETAS
    assert worst_error(made, built.hands, BETAS) < 1e-4


def test_a_pose_without_keys_stays(make_take):
    made = make_take(sides=("right",))
    built = build_take(made.take)
    armature = built.hands[0].armature
    row, frame = made.seen[3]
    quats, locations = pose_at(rig_of(armature), np.array([frame]))
    armature.animation_data_clear()
    for name, quat in zip(bone_names("right"), quats[0], strict=True):
        armature.pose.bones[name].rotation_quaternion = quat
    armature.pose.bones[bone_names("right")[0]].location = locations[0]
    armature.manient.betas = BETAS
    bpy.context.view_layer.update()
    expected = expected_vertices(made, "right", BETAS)[row]
    assert np.abs(evaluated_vertices(built.hands[0].mesh) - expected).max() < 1e-4


def test_corrections_can_still_be_taken_out(make_take):
    made = make_take(sides=("right",))
    armature = build_take(made.take).hands[0].armature
    captured = read_pose_keys(rig_of(armature))
    frame = int(made.seen[2][1])
    quats, locations = pose_at(rig_of(armature), np.array([float(frame)]))
    turned = quats[0].copy()
    turned[:, 1] += 0.2
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    place = locations + [0.01, 0.02, 0.03]
    correct_frames(armature, [frame], turned[None], place, 3.0, pins=[{8: (10.0, 10.0)}])
    start = np.array(armature.manient.betas)
    armature.manient.betas = BETAS
    clear_corrections(armature)
    armature.manient.betas = start
    restored = read_pose_keys(rig_of(armature))
    np.testing.assert_allclose(restored.quats, captured.quats, atol=1e-4)
    np.testing.assert_allclose(restored.locations, captured.locations, atol=1e-5)


def test_reset_gives_the_captured_shape_back(make_take):
    made = make_take(sides=("right",))
    built = build_take(made.take)
    armature = built.hands[0].armature
    bpy.context.view_layer.objects.active = armature
    armature.manient.betas = BETAS
    assert bpy.ops.manient.reset_shape() == {"FINISHED"}
    assert worst_error(made, built.hands, made.take.hands[0].betas) < 1e-4


def test_a_missing_model_is_one_sentence_and_changes_nothing(make_take, imitation_mano, tmp_path, capfd):
    import shutil

    folder = tmp_path / "models"
    shutil.copytree(imitation_mano, folder)
    made = make_take(sides=("right",), model=str(folder))
    built = build_take(made.take)
    armature = built.hands[0].armature
    Path(folder / "MANO_RIGHT.npz").unlink()
    Path(folder / "MANO_LEFT.npz").unlink()
    folder.rmdir()
    armature.manient.betas = BETAS
    sentence = reshape.trouble(armature)
    assert sentence is not None
    assert "there is no such hand model" in sentence
    assert "Traceback" not in capfd.readouterr().err
    row, frame = made.seen[1]
    bpy.context.scene.frame_set(frame)
    error = np.abs(evaluated_vertices(built.hands[0].mesh) - world(made.vertices["right"][row])).max()
    assert error < 1e-4
    bpy.context.view_layer.objects.active = armature
    assert bpy.ops.manient.reset_shape() == {"FINISHED"}  # it still has the captured shape
    assert reshape.trouble(armature) is None


def test_a_changed_mesh_is_left_alone(make_take):
    (hand,) = build_take(make_take(sides=("right",)).take).hands
    count = len(hand.mesh.data.vertices)
    hand.mesh.data.vertices.add(5)
    heads = joint_heads(hand.armature, "right")
    with pytest.raises(HandModelError, match=f"has {count + 5} vertices"):
        _without_callback(hand.armature)
    np.testing.assert_allclose(joint_heads(hand.armature, "right"), heads)


def _without_callback(armature):
    armature.manient.is_hand = False
    armature.manient.betas = BETAS
    armature.manient.is_hand = True
    reshape.reshape(armature)


def test_other_hands_and_objects_are_no_business_of_it(make_take):
    made = make_take()
    built = build_take(made.take)
    left, right = built.hands
    right.armature.manient.betas = BETAS
    row, frame = made.seen[4]
    bpy.context.scene.frame_set(frame)
    assert np.abs(evaluated_vertices(left.mesh) - world(made.vertices["left"][row])).max() < 1e-4
    bpy.ops.object.armature_add()
    bpy.context.object.manient.betas = BETAS  # no hand: nothing to do
    assert reshape.is_current(bpy.context.object)


@pytest.mark.parametrize("with_own_key", [False, True])
def test_the_forearm_can_be_hidden(make_take, with_own_key):
    """Hidden, a cap closes the wrist in the same vertices; shown again, all is
    as it was."""
    made = make_take(sides=("right",))
    (hand,) = build_take(made.take).hands
    assert "forearm" in drawn(MANIENT_PT_shape).said
    if with_own_key:  # it is moved along, as the correctives are
        hand.mesh.shape_key_add(name="mine", from_mix=False).value = 1.0
    before = evaluated_vertices(hand.mesh)
    plain = load_model("open-hand", "right")
    count = len(plain.v_template)
    hand.armature.manient.forearm = False
    row, frame = made.seen[0]
    track = made.take.hands[0]
    cap = with_wrist(plain, "cap").posed(
        track.betas, track.global_orient[row], track.hand_pose[row], track.transl[row]
    )
    bpy.context.scene.frame_set(frame)
    # Blender leaves out products of the pose that move the skin by less than 0.2 mm.
    np.testing.assert_allclose(evaluated_vertices(hand.mesh), world(cap.vertices), atol=5e-5)
    hand.armature.manient.betas = BETAS  # the shape of what is shown now
    hand.armature.manient.betas = track.betas
    np.testing.assert_allclose(evaluated_vertices(hand.mesh), world(cap.vertices), atol=5e-5)
    hand.armature.manient.forearm = True
    np.testing.assert_allclose(evaluated_vertices(hand.mesh), before, atol=1e-5)
    assert np.abs(before[count:] - world(cap.vertices)[count:]).max() > 0.04
    np.testing.assert_allclose(before[:count], world(cap.vertices)[:count], atol=5e-5)


def test_hands_with_an_open_wrist_stay_open(make_take):
    """As every hand of a file from before there were forearms."""
    made = make_take(sides=("right",))
    (hand,) = build_take(made.take, wrist="open").hands
    assert "forearm" not in drawn(MANIENT_PT_shape).said
    hand.armature.manient.forearm = True
    hand.armature.manient.betas = BETAS
    assert reshape.is_current(hand.armature)
    assert len(hand.mesh.data.vertices) == len(load_model("open-hand", "right").v_template)


def test_a_model_without_an_edge_at_its_wrist_has_no_forearm(make_take, imitation_mano):
    """The panel shows no box where there is no wrist to close."""
    (hand,) = build_take(make_take(sides=("right",), model=str(imitation_mano)).take).hands
    assert (hand.armature.manient.wrist, hand.armature.manient.forearm) == ("open", False)


def test_the_mirror_image_has_the_wrist_that_is_shown(make_take):
    made = make_take(sides=("right",))
    (hand,) = build_take(made.take).hands
    hand.armature.manient.forearm = False
    mirrored = mirror_hand(hand_of(hand.armature))
    assert (mirrored.manient.wrist, mirrored.manient.forearm) == ("cap", False)
    mirrored.manient.forearm = True
    model = with_wrist(load_model("open-hand", "left"), "forearm")
    found = np.array([v.co for v in hand_of(mirrored).mesh.data.vertices])
    shaped = model.shaped(made.take.hands[0].betas)
    np.testing.assert_allclose(found, points_to_rest(shaped.vertices), atol=1e-6)
