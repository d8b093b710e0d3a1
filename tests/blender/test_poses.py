"""Poses put on captured hands and on characters, and kept as assets for both."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.panels.poses import MANIENT_PT_poses
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import corrections
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import keep_map
from blender_manient.scene.keys import PoseKeys, displayed_pose, pose_at, read_pose_keys, remove_pose_keys
from blender_manient.scene.poses import PROPERTY, kept_pose, posable_hands, pose_items
from handfit_core.edit.corrections import changed_quats, correction_between
from handfit_core.geometry.rotations import quat_to_rotmat, rotvec_to_rotmat
from handfit_core.hand_model import axes, load_model
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes, relaxed_pose
from handfit_core.hand_model.poses import Pose, ready_poses
from handfit_core.media.source import Source
from handfit_core.skeleton import FINGER_JOINTS, SIDES, other_side
from tests.drawn import drawn

from .characters import BoneSpec, build_armature, hand_specs, joint_name, map_of, placed
from .conftest import action_curves

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture(params=["right", "left"])
def hand(request, make_take, model):
    made = make_take(sides=(request.param,), model=model)
    armature = build_take(made.take).hands[0].armature
    bpy.context.view_layer.objects.active = armature
    return armature, request.param, load_model(model, request.param)


def relaxed(side) -> np.ndarray:
    """(15, 3, 3) joint rotations of the ready pose, which is the open hand's on all hands."""
    return rotvec_to_rotmat(relaxed_pose(load_model(None, side)).reshape(15, 3))


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
    np.testing.assert_allclose(found, relaxed(model.side), atol=1e-4)
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
    expected = relaxed(model.side)
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
    expected = relaxed(model.side)
    np.testing.assert_allclose(finger_rotations(armature, side), expected, atol=1e-4)


@pytest.mark.parametrize("auto", [False, True])
def test_without_animation_auto_keying_keys(hand, auto):
    armature, _, _ = hand
    armature.animation_data_clear()
    bpy.context.scene.tool_settings.use_keyframe_insert_auto = auto
    bpy.context.scene.frame_set(5)
    bpy.ops.manient.apply_pose(pose="Relaxed")
    keys = read_pose_keys(rig_of(armature))
    assert keys.frames.tolist() == [5.0] * auto
    assert keys.rotation_keyed.tolist() == [[False] + [True] * 15] * auto
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
    expected = relaxed(model.side)
    np.testing.assert_allclose(finger_rotations(armature, side), expected, atol=1e-4)
    assert bpy.context.mode == "POSE"
    bpy.ops.ed.undo_push(message="relaxed")
    bpy.ops.ed.undo()
    bpy.context.view_layer.update()
    restored = displayed_pose(rig_of(bpy.data.objects[name]))
    np.testing.assert_allclose(np.abs(np.sum(restored * before, axis=-1)), 1.0, atol=1e-5)


# Ready poses on captured hands


@pytest.mark.parametrize("name", ["Fist", "Pinch", "Letter N"])
def test_a_ready_pose_gives_a_captured_hand_exactly_its_angles(hand, name):
    armature, side, _ = hand
    bpy.context.scene.frame_set(6)
    assert bpy.ops.manient.apply_pose(pose=name) == {"FINISHED"}
    bpy.context.scene.frame_set(6)
    expected = rotvec_to_rotmat(ready_poses()[name].pose.on(side).reshape(15, 3))
    np.testing.assert_allclose(finger_rotations(armature, side), expected, atol=1e-6)
    (found,) = posable_hands(bpy.context)
    read = found.read()
    assert read.side == side
    np.testing.assert_allclose(rotvec_to_rotmat(read.hand_pose.reshape(15, 3)), expected, atol=1e-6)


def test_half_of_the_way(hand):
    armature, side, _ = hand
    bpy.context.scene.frame_set(6)
    before = finger_rotations(armature, side)
    bpy.ops.manient.apply_pose(pose="Fist", blend=0.5)
    bpy.context.view_layer.update()
    half = finger_rotations(armature, side)
    wanted = rotvec_to_rotmat(ready_poses()["Fist"].pose.on(side).reshape(15, 3))
    np.testing.assert_allclose(angles_between(before, half), angles_between(half, wanted), atol=1e-4)
    np.testing.assert_allclose(
        angles_between(before, half) + angles_between(half, wanted), angles_between(before, wanted), atol=1e-4
    )
    bpy.ops.manient.clear_corrections(scope="FRAME")
    bpy.ops.manient.apply_pose(pose="Fist", blend=0.0)
    np.testing.assert_allclose(finger_rotations(armature, side), before, atol=1e-5)


def angles_between(one, other):
    cosine = (np.trace(np.swapaxes(one, -1, -2) @ other, axis1=-2, axis2=-1) - 1.0) / 2.0
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def select_bones(armature, names):
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="POSE")
    bpy.ops.pose.select_all(action="DESELECT")
    for name in names:
        # From Blender 5.0 on the pose bone is selected, before the bone is.
        bone = armature.pose.bones[name]
        (bone if hasattr(bone, "select") else armature.data.bones[name]).select = True


def test_selected_bones_choose_fingers_and_other_points_stay(hand):
    armature, side, _ = hand
    bpy.context.scene.frame_set(6)
    here = pose_at(rig_of(armature), np.array([6.0]))
    pins = {4: (1.0, 2.0), 8: (10.0, 20.0)}
    corrections.correct_frames(armature, [6], *here, 4, pins=[pins], touches=[{16: 12, 8: 4}])
    before = finger_rotations(armature, side)
    select_bones(armature, [bone_names(side)[FINGER_JOINTS["index"][1]]])
    assert bpy.ops.manient.apply_pose(pose="Fist") == {"FINISHED"}
    bpy.context.view_layer.update()
    after = finger_rotations(armature, side)
    moved = angles_between(before, after) > 0.01
    index = np.array(FINGER_JOINTS["index"]) - 1
    assert moved[index].all()
    assert not np.delete(moved, index).any()
    field = corrections.corrections_of(armature)
    assert set(field.pins(6)) == {4}  # the index finger's own is gone
    assert dict(field.touching(6)) == {16: 12}


def test_the_chosen_picture_is_what_is_applied(hand):
    armature, side, _ = hand
    settings = bpy.context.scene.manient
    items = pose_items(settings, bpy.context)
    assert [item[0] for item in items] == list(ready_poses())
    assert len({item[4] for item in items}) == len(items)
    assert settings.pose == "Relaxed"
    settings.pose = "Horns"
    assert bpy.ops.manient.apply_pose() == {"FINISHED"}
    bpy.context.view_layer.update()
    expected = rotvec_to_rotmat(ready_poses()["Horns"].pose.on(side).reshape(15, 3))
    np.testing.assert_allclose(finger_rotations(armature, side), expected, atol=1e-5)


def test_a_pose_that_is_not_there(hand):
    with pytest.raises(RuntimeError, match="there is no pose 'Vulcan': ready ones are Relaxed, Flat"):
        bpy.ops.manient.apply_pose(pose="Vulcan")


# On ranges, and held


def is_pose(armature, side, name, frames):
    wanted = rotvec_to_rotmat(ready_poses()[name].pose.on(side).reshape(15, 3))
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        found.append(angles_between(finger_rotations(armature, side), wanted).max() < 1e-3)
    return found


def test_a_range_gets_a_pose_and_clear_takes_it_back(hand):
    armature, side, _ = hand
    bpy.context.scene.manient.spread = 3
    before = read_pose_keys(rig_of(armature))
    bpy.context.scene.frame_set(20)  # outside
    ranged = {"pose": "Fist", "scope": "RANGE", "first": 8, "last": 12}
    assert bpy.ops.manient.apply_pose(**ranged) == {"FINISHED"}
    assert is_pose(armature, side, "Fist", range(6, 15)) == [False] * 2 + [True] * 5 + [False] * 2
    change = turned(before, read_pose_keys(rig_of(armature)))
    np.testing.assert_array_equal(change.max(axis=1) > 1e-4, (before.frames > 5) & (before.frames < 15))
    assert change[:, 0].max() == 0.0
    assert corrections.corrected_frames(armature) == [8, 9, 10, 11, 12]
    bpy.context.scene.use_preview_range = True
    bpy.context.scene.frame_preview_start, bpy.context.scene.frame_preview_end = 8, 12
    assert bpy.ops.manient.clear_corrections(scope="RANGE") == {"FINISHED"}
    assert turned(before, read_pose_keys(rig_of(armature))).max() < 1e-5


def test_a_held_pose_ends_where_the_next_one_begins(hand):
    """Captured frames are no keys of the artist's; poses one after the other are, whatever their order."""
    armature, side, _ = hand
    scene = bpy.context.scene
    scene.manient.spread = 0
    last = int(read_pose_keys(rig_of(armature)).frames[-1])
    scene.frame_set(14)
    bpy.ops.manient.apply_pose(pose="Fist", scope="HOLD")
    assert all(is_pose(armature, side, "Fist", range(14, last + 1)))
    scene.frame_set(6)
    bpy.ops.manient.apply_pose(pose="Flat", scope="HOLD")
    assert all(is_pose(armature, side, "Flat", range(6, 14)))
    assert all(is_pose(armature, side, "Fist", range(14, last + 1)))
    scene.frame_set(9)
    bpy.ops.manient.apply_pose(pose="Point", scope="HOLD")
    assert all(is_pose(armature, side, "Flat", range(6, 9)))
    assert all(is_pose(armature, side, "Point", range(9, 14)))
    assert all(is_pose(armature, side, "Fist", range(14, last + 1)))
    scene.frame_set(16)
    bpy.ops.manient.apply_pose(pose="Horns", scope="HOLD")
    assert all(is_pose(armature, side, "Horns", range(16, last + 1)))


def test_a_held_pose_leads_into_a_key_of_ones_own(hand):
    armature, side, _ = hand
    scene = bpy.context.scene
    scene.manient.spread = 4
    rig, joint = rig_of(armature), FINGER_JOINTS["index"][0]
    bone = armature.pose.bones[bone_names(side)[joint]]
    scene.frame_set(14)
    bone.rotation_quaternion = (0.8, 0.6, 0.0, 0.0)
    bone.keyframe_insert("rotation_quaternion", frame=14)
    own = pose_at(rig, np.array([14.0]))[0]
    scene.frame_set(6)
    bpy.ops.manient.apply_pose(pose="Fist", scope="HOLD")
    assert is_pose(armature, side, "Fist", range(5, 12)) == [False] + [True] * 5 + [False]
    np.testing.assert_allclose(pose_at(rig, np.array([14.0]))[0], own, atol=1e-6)


@pytest.mark.parametrize("kind", ["captured", "character"])
def test_a_range_that_runs_backwards_changes_nothing(hand, kind):
    armature = hand[0] if kind == "captured" else character("right")
    bpy.ops.manient.apply_pose(pose="Flat")
    before = {c.data_path: [tuple(p.co) for p in c.keyframe_points] for c in curves_of(armature)}
    kept = armature.manient.corrections
    with pytest.raises(RuntimeError, match="range runs backwards, from frame 12 to 8"):
        bpy.ops.manient.apply_pose(pose="Fist", scope="RANGE", first=12, last=8)
    assert {c.data_path: [tuple(p.co) for p in c.keyframe_points] for c in curves_of(armature)} == before
    assert armature.manient.corrections == kept


def curves_of(armature):
    return list(action_curves(armature.animation_data.action))


def test_a_range_without_a_hand_is_refused(hand):
    armature, _, _ = hand
    with pytest.raises(RuntimeError, match="none of the frames 400 to 410 has a hand"):
        bpy.ops.manient.apply_pose(pose="Fist", scope="RANGE", first=400, last=410)
    assert armature.manient.corrections == ""


def test_a_range_on_few_keys_stays_within_its_spread(hand):
    """Between keys that lie far apart, the curves before and after the range stay what they were."""
    armature, side, _ = hand
    rig = rig_of(armature)
    keys = read_pose_keys(rig)
    first, last = keys.frames[[0, -1]]
    remove_pose_keys(rig, first + 1, last - 1)
    bpy.context.scene.manient.spread = 2
    around = np.array([first + 1, last - 1])
    before = pose_at(rig, around)[0]
    middle = round((first + last) / 2)
    ranged = {"scope": "RANGE", "first": middle - 1, "last": middle + 1}
    bpy.ops.manient.apply_pose(pose="Fist", **ranged)
    assert all(is_pose(armature, side, "Fist", range(middle - 1, middle + 2)))
    assert np.linalg.norm(correction_between(before, pose_at(rig, around)[0]), axis=-1).max() < 1e-3


def test_this_pose_is_held_and_reset_is_rest(hand):
    armature, side, _ = hand
    scene = bpy.context.scene
    scene.manient.spread = 0
    scene.frame_set(7)
    own = finger_rotations(armature, side)
    bpy.ops.manient.apply_pose(source="OWN", scope="HOLD")
    for frame in (7, 12, 18):
        scene.frame_set(frame)
        np.testing.assert_allclose(finger_rotations(armature, side), own, atol=1e-4)
    bpy.ops.manient.apply_pose(source="REST", scope="RANGE", first=9, last=10)
    scene.frame_set(10)
    np.testing.assert_allclose(finger_rotations(armature, side), np.tile(np.eye(3), (15, 1, 1)), atol=1e-4)


def test_mirrored_is_the_other_hands_pose(make_take, model):
    built = build_take(make_take(sides=SIDES, model=model).take)
    hands = {one.armature.manient.side: one.armature for one in built.hands}
    bpy.context.view_layer.objects.active = hands["left"]
    bpy.context.scene.frame_set(6)
    bpy.ops.manient.apply_pose(pose="Horns")
    bpy.context.view_layer.objects.active = hands["right"]
    bpy.ops.manient.apply_pose(source="OTHER", scope="RANGE", first=10, last=14)
    assert all(is_pose(hands["right"], "right", "Horns", range(10, 15)))
    bpy.data.objects.remove(hands["left"])
    with pytest.raises(RuntimeError, match="there are 0 captured left hands"):
        bpy.ops.manient.apply_pose(source="OTHER")


def test_the_range_is_suggested(hand):
    settings, scene = bpy.context.scene.manient, bpy.context.scene
    scene.use_preview_range = True
    scene.frame_preview_start, scene.frame_preview_end = 7, 9
    settings.pose_scope = "RANGE"
    assert (settings.pose_first, settings.pose_last) == (7, 9)
    assert "Mirrored Reset" in drawn(MANIENT_PT_poses).said
    settings.pose_scope = "HERE"
    settings.pose_first = 3
    settings.pose_scope = "RANGE"
    assert settings.pose_first == 7


# Characters


def character(side, seed=3, **fields):
    rng = np.random.default_rng(seed)
    fields = {"bend": 0.6, "stretch": 0.3, **fields}
    armature = build_armature(hand_specs(side, rng, **fields))
    placed(armature, rng, 0.1)
    keep_map(armature, map_of(side))
    armature.manient.character.contacts = False
    return armature


def segments(armature, side):
    """(10, 3) where two bones of each finger point, relative to the hand's own bone, in our rest space."""
    bones = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
    heads = np.array([bones[joint_name(j, side)].head for j in range(16)])
    own = np.array(bones[joint_name(0, side)].matrix.to_3x3())
    rest = np.array(armature.data.bones[joint_name(0, side)].matrix_local.to_3x3())
    steps = np.array([heads[b] - heads[a] for js in FINGER_JOINTS.values() for a, b in (js[:2], js[1:])])
    steps = steps @ own @ rest.T
    return steps / np.linalg.norm(steps, axis=1, keepdims=True)


def expected_segments(pose: Pose, side):
    """The same of our own hand, in the same palm."""
    model = load_model(None, side)
    still = np.zeros(3)
    points = axes.points_to_rest(model.posed(None, still, pose.on(side), still).joints)
    steps = np.array([points[b] - points[a] for js in FINGER_JOINTS.values() for a, b in (js[:2], js[1:])])
    return steps / np.linalg.norm(steps, axis=1, keepdims=True)


def bent(armature, side, frame):
    """(15, 4) the character's finger bones on a frame, by their channels."""
    bpy.context.scene.frame_set(frame)
    names = [joint_name(j, side) for j in range(1, 16)]
    return np.array([armature.pose.bones[name].rotation_quaternion for name in names])


@pytest.mark.parametrize("kind", ["CONSTANT", "BEZIER"])
def test_a_characters_range_holds_between_its_own_keys(kind):
    armature = character("right")
    scene = bpy.context.scene
    scene.manient.spread = 4
    for frame, name in ((1, "Flat"), (12, "Point"), (40, "Flat")):
        scene.frame_set(frame)
        bpy.ops.manient.apply_pose(pose=name)
    for curve in curves_of(armature):
        for point in curve.keyframe_points:
            point.interpolation = kind
            point.handle_left_type = point.handle_right_type = "ALIGNED"
    outside = [bent(armature, "right", frame) for frame in (1, 3, 30, 40)]
    scene.frame_set(20)
    bpy.ops.manient.apply_pose(pose="Fist")
    fist = bent(armature, "right", 20)
    bpy.ops.ed.undo_push(message="x")
    assert bpy.ops.manient.apply_pose(pose="Fist", scope="RANGE", first=10, last=20) == {"FINISHED"}
    for frame in range(10, 21):
        np.testing.assert_allclose(
            np.abs(np.sum(bent(armature, "right", frame) * fist, axis=1)), 1, atol=1e-4
        )
    after = [bent(armature, "right", frame) for frame in (1, 3, 30, 40)]
    np.testing.assert_allclose(after[0], outside[0], atol=1e-5)
    np.testing.assert_allclose(after[3], outside[3], atol=1e-5)


def test_a_characters_pose_is_held_to_its_next_key_and_mirrored_to_its_other_hand():
    armature = two_hands()
    armature.manient.character.contacts = False
    scene = bpy.context.scene
    scene.manient.spread, scene.frame_end = 5, 60
    select_bones(armature, [joint_name(0, "left")])
    scene.frame_set(40)
    bpy.ops.manient.apply_pose(pose="Flat")
    flat = bent(armature, "left", 40)
    scene.frame_set(10)
    bpy.ops.manient.apply_pose(pose="Fist", scope="HOLD")
    fist = bent(armature, "left", 10)
    np.testing.assert_allclose(bent(armature, "left", 35), fist, atol=1e-5)
    assert np.abs(bent(armature, "left", 37) - fist).max() > 1e-3
    np.testing.assert_allclose(bent(armature, "left", 40), flat, atol=1e-5)
    scene.frame_set(20)
    bpy.ops.pose.select_all(action="DESELECT")
    select_bones(armature, [joint_name(0, "right")])
    bpy.ops.manient.apply_pose(source="OTHER", scope="HOLD")
    keyed = {p.co[0] for c in curves_of(armature) if "_r" in c.data_path for p in c.keyframe_points}
    assert keyed == {15.0, 20.0, 60.0}
    (shown,) = posable_hands(bpy.context)
    scene.frame_set(50)
    read = rotvec_to_rotmat(shown.read().on("right").reshape(15, 3))
    wanted = rotvec_to_rotmat(ready_poses()["Fist"].pose.on("right").reshape(15, 3))
    assert angles_between(read, wanted).max() < 0.01


def test_reset_gives_a_character_its_own_rest(make_take):
    armature = character("right")
    bpy.ops.manient.apply_pose(pose="Fist")
    bpy.ops.manient.apply_pose(source="REST")
    np.testing.assert_allclose(bent(armature, "right", 1), np.tile([1, 0, 0, 0], (15, 1)), atol=1e-6)


def target_of(armature):
    (hand,) = posable_hands(bpy.context)
    assert hand.rig.armature == armature
    return hand._target


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", ["Fist", "Pinch", "Letter K, P"])
def test_a_ready_pose_points_a_characters_fingers_as_ours(name, side):
    armature = character(side)
    bpy.context.scene.frame_set(12)
    assert bpy.ops.manient.apply_pose(pose=name) == {"FINISHED"}
    bpy.context.scene.frame_set(12)
    pose = ready_poses()[name].pose
    wanted = expected_segments(pose, side) @ target_of(armature).aligned.T
    cosine = np.sum(segments(armature, side) * wanted, axis=1)
    assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < 0.1
    curves = list(action_curves(armature.animation_data.action))
    assert len(curves) == 4 * 15
    assert all([p.co[0] for p in c.keyframe_points] == [12.0] for c in curves)
    (hand,) = posable_hands(bpy.context)
    read = hand.read()
    assert read.side == side
    np.testing.assert_allclose(read.on("right"), pose.on("right"), atol=1e-4)


def test_a_pinch_of_a_character_is_closed_where_contacts_are_kept():
    armature = character("right", bend=0.2, stretch=0.1)
    gaps = []
    for contacts in (False, True):
        armature.manient.character.contacts = contacts
        bpy.ops.manient.apply_pose(pose="Pinch")
        bpy.context.view_layer.update()
        bones = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        thumb, index = (bones[joint_name(FINGER_JOINTS[f][2], "right")].tail for f in ("thumb", "index"))
        gaps.append((thumb - index).length / target_of(armature).scale)
    model, still = load_model(None, "right"), np.zeros(3)
    points = model.keypoints(None, still, ready_poses()["Pinch"].pose.hand_pose, still)
    captured = np.linalg.norm(points[4] - points[8])
    assert abs(gaps[1] - captured) < 0.003
    assert abs(gaps[0] - captured) > 0.006


def test_a_characters_fingers_by_selected_bones_and_half_of_the_way():
    armature = character("left")
    select_bones(armature, [joint_name(FINGER_JOINTS["thumb"][2], "left")])
    assert bpy.ops.manient.apply_pose(pose="Fist", blend=0.5) == {"FINISHED"}
    keyed = {c.data_path.split('"')[1] for c in action_curves(armature.animation_data.action)}
    assert keyed == {joint_name(j, "left") for j in FINGER_JOINTS["thumb"]}
    (hand,) = posable_hands(bpy.context)
    read = rotvec_to_rotmat(hand.read().on("right").reshape(15, 3))
    moved = angles_between(np.eye(3), read)
    assert moved[12:].min() > 0.05


def two_hands():
    rng = np.random.default_rng(5)
    specs = [BoneSpec("chest", "", (0, 0, 0), (0, 0, 0.2))]
    for side in SIDES:
        specs += hand_specs(
            side, rng, parent="chest", place=np.array([{"left": 0.5, "right": -0.5}[side], 0, 0])
        )
    armature = build_armature(specs)
    for side in SIDES:
        keep_map(armature, map_of(side))
    return armature


def test_both_hands_of_a_character_or_the_one_with_selected_bones():
    armature = two_hands()
    select_bones(armature, [joint_name(0, "right")])
    bpy.ops.manient.apply_pose(pose="Point")
    keyed = {c.data_path.split('"')[1] for c in action_curves(armature.animation_data.action)}
    assert keyed == {joint_name(j, "right") for j in range(1, 16)}
    bpy.ops.pose.select_all(action="DESELECT")
    bpy.ops.manient.apply_pose(pose="Point")
    keyed = {c.data_path.split('"')[1] for c in action_curves(armature.animation_data.action)}
    assert keyed == {joint_name(j, side) for side in SIDES for j in range(1, 16)}
    with pytest.raises(RuntimeError, match="two hands: select a bone"):
        bpy.ops.manient.save_pose_asset(asset_name="Both")
    select_bones(armature, [joint_name(1, "left")])
    assert bpy.ops.manient.save_pose_asset(asset_name="Mine") == {"FINISHED"}
    assert kept_pose(bpy.data.actions["Mine"].asset_data).side == "left"


def test_a_hand_that_cannot_take_a_pose_keeps_the_other_from_it():
    armature = two_hands()
    armature.data.pose_position = "REST"
    assert not bpy.ops.manient.apply_pose.poll()
    armature.data.pose_position = "POSE"
    bpy.ops.manient.apply_pose(pose="Fist")
    curves = list(action_curves(armature.animation_data.action))
    locked = next(c for c in curves if joint_name(4, "right") in c.data_path)
    locked.lock = True
    before = [[tuple(p.co) for p in c.keyframe_points] for c in curves]
    bpy.context.scene.frame_set(7)
    shown = [tuple(bone.rotation_quaternion) for bone in armature.pose.bones]
    with pytest.raises(RuntimeError, match="locked"):
        bpy.ops.manient.apply_pose(pose="Spread")
    assert [[tuple(p.co) for p in c.keyframe_points] for c in curves] == before
    assert [tuple(bone.rotation_quaternion) for bone in armature.pose.bones] == shown
    select_bones(armature, [joint_name(1, "left")])
    assert bpy.ops.manient.apply_pose(pose="Spread") == {"FINISHED"}


# Assets for every rig


@pytest.mark.parametrize("onto", ["captured", "character"])
def test_a_pose_saved_on_one_rig_is_the_same_on_another(hand, onto, tmp_path):
    """Saved to a file, appended from it, and put on a hand of the other side."""
    armature, side, _ = hand
    bpy.context.scene.frame_set(9)
    bpy.context.view_layer.update()
    shown = finger_rotations(armature, side)
    assert bpy.ops.manient.save_pose_asset(asset_name="Wave") == {"FINISHED"}
    pixels = picture_of(bpy.data.actions["Wave"])
    assert pixels.shape == (128, 128, 4)
    assert 0.2 < (pixels[..., 3] > 0.5).mean() < 0.9
    path = str(tmp_path / "poses.blend")
    bpy.data.libraries.write(path, {bpy.data.actions["Wave"]}, fake_user=True)
    bpy.data.actions.remove(bpy.data.actions["Wave"])
    with bpy.data.libraries.load(path) as (there, here):
        here.actions = list(there.actions)
    np.testing.assert_allclose(picture_of(bpy.data.actions["Wave"]), pixels, atol=0.01)
    assert "Wave" in [item[0] for item in pose_items(None, bpy.context)]

    other = other_side(side)
    pose = kept_pose(bpy.data.actions["Wave"].asset_data)
    np.testing.assert_allclose(rotvec_to_rotmat(pose.hand_pose.reshape(15, 3)), shown, atol=1e-5)
    if onto == "character":
        target = character(other, seed=11)
        assert bpy.ops.manient.apply_pose(pose="Wave") == {"FINISHED"}
        bpy.context.view_layer.update()
        wanted = expected_segments(pose, other) @ target_of(target).aligned.T
        cosine = np.sum(segments(target, other) * wanted, axis=1)
        assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < 0.1
    else:
        assert bpy.ops.manient.mirror_hand() == {"FINISHED"}
        target = bpy.context.active_object
        assert target.manient.side == other
        bpy.ops.manient.apply_pose(pose="Fist")
        assert bpy.ops.manient.apply_pose(pose="Wave") == {"FINISHED"}
        bpy.context.view_layer.update()
        expected = rotvec_to_rotmat(pose.on(other).reshape(15, 3))
        np.testing.assert_allclose(finger_rotations(target, other), expected, atol=1e-5)


def picture_of(action):
    preview = action.preview
    pixels = np.empty(4 * preview.image_size[0] * preview.image_size[1], dtype=np.float32)
    preview.image_pixels_float.foreach_get(pixels)
    return pixels.reshape(preview.image_size[1], preview.image_size[0], 4)


def test_a_characters_pose_on_a_captured_hand(hand):
    armature, side, _ = hand
    character("right", seed=2)
    bpy.ops.manient.apply_pose(pose="Letter R")
    assert bpy.ops.manient.save_pose_asset(asset_name="Crossed") == {"FINISHED"}
    curves = list(action_curves(bpy.data.actions["Crossed"]))
    assert len(curves) == 4 * 15
    bpy.context.view_layer.objects.active = armature
    bpy.ops.manient.apply_pose(pose="Crossed")
    bpy.context.view_layer.update()
    expected = rotvec_to_rotmat(ready_poses()["Letter R"].pose.on(side).reshape(15, 3))
    np.testing.assert_allclose(finger_rotations(armature, side), expected, atol=1e-4)


def test_ones_own_pose_takes_the_place_of_a_ready_one(hand):
    armature, side, _ = hand
    bpy.context.scene.frame_set(3)
    bpy.context.view_layer.update()
    own = finger_rotations(armature, side)
    bpy.ops.manient.save_pose_asset(asset_name="Fist")
    bpy.context.scene.frame_set(9)
    bpy.ops.manient.apply_pose(pose="Fist")
    bpy.context.view_layer.update()
    np.testing.assert_allclose(finger_rotations(armature, side), own, atol=1e-5)
    names = [item[0] for item in pose_items(None, bpy.context)]
    assert len(names) == len(set(names)) == len(ready_poses())


@pytest.mark.parametrize(
    "value",
    ["right", 5, [1.0, 2.0], {"side": "right"}, {"side": "right", "hand_pose": [1e9] * 45}, {"side": 3}],
)
def test_a_damaged_pose_asset_ends_in_a_sentence(hand, value):
    armature, side, _ = hand
    bpy.ops.manient.save_pose_asset(asset_name="Bad")
    bpy.data.actions["Bad"].asset_data[PROPERTY] = value
    before = finger_rotations(armature, side)
    assert "Bad" in [item[0] for item in pose_items(None, bpy.context)]
    with pytest.raises(RuntimeError, match="pose of a hand"):
        bpy.ops.manient.apply_pose(pose="Bad")
    np.testing.assert_array_equal(finger_rotations(armature, side), before)
