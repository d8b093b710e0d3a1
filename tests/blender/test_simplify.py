"""Fewer keys in Blender's own curves, every one of them back, and a layer for changes on top."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.common.blender_versions import action_slot, assign_action, channels
from blender_manient.exporters.take import retaken
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import corrections
from blender_manient.scene.apply import apply_hand
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import keep_map
from blender_manient.scene.editable import why_not_keyable
from blender_manient.scene.keys import PoseKeys, pose_at, read_pose_keys, write_pose_keys
from blender_manient.scene.layer import add_layer, end_layer
from blender_manient.scene.mirror import mirror_hand
from blender_manient.scene.onto_character import reading_motion
from blender_manient.scene.origin import origin_to_wrist
from blender_manient.scene.own_keys import keyed_by_hand
from blender_manient.scene.simplify import (
    DENSE,
    Bounds,
    hands_to_simplify,
    kept_action,
    restore,
    thinning,
    write,
)
from blender_manient.scene.store import hand_of
from blender_manient.session import key_preview
from handfit_core.errors import OptionError
from handfit_core.geometry.rotations import quat_multiply, quat_to_rotmat, rotvec_to_quat
from handfit_core.retarget.hand_map import HandMap
from handfit_core.skeleton import NUM_JOINTS
from handfit_core.slices import run_to_completion

from .characters import build_armature, hand_specs, joint_name
from .test_corrections import correct, moved_poses, refitted
from .test_keys import contents

pytestmark = pytest.mark.usefixtures("registered")

FRAMES = np.arange(1, 81)


@pytest.fixture
def made(make_take):
    return make_take(sides=("right",), frame_numbers=FRAMES)


@pytest.fixture
def armature(made):
    return chosen(build_take(made.take).hands[0].armature)


def chosen(armature):
    for obj in bpy.context.selected_objects:
        obj.select_set(False)
    bpy.context.view_layer.objects.active = armature
    armature.select_set(True)
    return armature


def simplify(bounds=Bounds()) -> list:  # noqa: B008
    found = [run_to_completion(thinning(hand, bounds)) for hand in hands_to_simplify(bpy.context)]
    write(found[0].hand.rig.armature, found)
    return found


def count_of(armature) -> int:
    data = armature.animation_data
    return sum(len(c.keyframe_points) for c in channels(data.action, action_slot(data)).fcurves)


def evaluated(armature, frames, names) -> np.ndarray:
    """(N, B, 4) what Blender itself evaluates."""
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(int(np.floor(frame)), subframe=float(frame % 1))
        shown = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
        found.append([shown.pose.bones[name].matrix_basis.to_quaternion() for name in names])
    return np.array(found)


def apart(one, other) -> float:
    """The largest rotation between quaternions, or matrices, in degrees."""
    one, other = (quat_to_rotmat(q) if q.shape[-1] == 4 else q for q in (one, other))
    turn = np.swapaxes(one, -1, -2) @ other
    return float(np.degrees(np.arccos(np.clip((np.trace(turn, axis1=-2, axis2=-1) - 1) / 2, -1, 1))).max())


@pytest.mark.parametrize("together", ["ALL", "FINGER", "BONE"])
def test_what_blender_evaluates_keeps_to_the_bounds(armature, made, together):
    names, keyed = bone_names("right"), read_pose_keys(rig_of(armature)).frames
    dense = evaluated(armature, keyed, names)
    before = count_of(armature)
    (found,) = simplify(Bounds(3.0, 4.0, together))
    assert apart(evaluated(armature, keyed, names), dense) <= 3.0
    assert count_of(armature) == found.after < before == found.before
    points = np.array(made.take.intrinsics.project(retaken([hand_of(armature)]).hands[0].joints_3d))
    captured = made.take.intrinsics.project(made.take.hands[0].joints_3d)
    assert np.nanmax(np.linalg.norm(points - captured, axis=-1)) <= 4.0 + 0.05  # from a picture of 160 pixels
    frames = {tuple(k.co[0] for k in c.keyframe_points) for c in curves_of(armature)}
    assert len(frames) == {"ALL": 1, "FINGER": 6}.get(together, len(frames))


def curves_of(armature):
    data = armature.animation_data
    return list(channels(data.action, action_slot(data)).fcurves)


def test_all_keys_come_back_bit_for_bit(armature):
    before, name = contents(armature), armature.animation_data.action.name
    simplify()
    dense = kept_action(armature)
    assert dense.use_fake_user
    assert dense.name == f"{name} (all keys)"
    assert armature.animation_data.action.name == name
    simplify(Bounds(5.0, 9.0))  # from all keys again, not from those that were left
    assert kept_action(armature) == dense
    assert len(bpy.data.actions) == 2
    assert restore(armature) is None
    assert contents(armature) == before
    assert [(a.name, a.use_fake_user) for a in bpy.data.actions] == [(name, False)]
    with pytest.raises(OptionError, match="has all its keys"):
        restore(armature)


def test_changes_since_are_kept_when_all_keys_come_back(armature):
    before = contents(armature)
    simplify()
    curves_of(armature)[5].keyframe_points[0].co[1] += 0.2
    changed = contents(armature)
    assert simplify()[0].before < 16 * 4 * 40  # what was changed is simplified further
    assert restore(armature) is None
    assert contents(armature) == changed
    kept = restore(armature)
    assert contents(armature) == before
    assert kept.use_fake_user
    assert kept.get(DENSE) is None


def test_actions_that_others_use_stay(armature):
    before = contents(armature)
    simplify()
    other = armature.copy()
    bpy.context.collection.objects.link(other)
    simplify(Bounds(5.0, 9.0))
    shared = other.animation_data.action
    assert shared != armature.animation_data.action
    assert kept_action(other) == kept_action(armature)
    restore(armature)
    assert other.animation_data.action == shared
    restore(other)
    assert contents(other) == contents(armature) == before


def test_an_action_that_another_object_has_keeps_its_name(armature):
    dense = armature.animation_data.action
    name = dense.name
    bpy.data.objects.new("another", None).animation_data_create().action = dense
    for _ in range(2):
        simplify()
        assert dense.name == name
        assert kept_action(armature) == dense != armature.animation_data.action
    assert restore(armature) is None
    assert armature.animation_data.action == dense
    assert [action.name for action in bpy.data.actions] == [name]


def test_actions_with_long_names_can_be_told_apart(armature):
    name = f"{'x' * 44} the hand on the right"
    name = armature.animation_data.action.name = name[:60]
    simplify()
    dense = kept_action(armature)
    assert dense.name.endswith(" (all keys)")
    curves_of(armature)[5].keyframe_points[0].co[1] += 0.2
    assert restore(armature).name.endswith(" (fewer keys)")
    assert dense.name == name
    assert add_layer(armature).name.endswith(" changes")


def test_all_keys_come_back_after_saving(armature, tmp_path):
    before, name = contents(armature), armature.name
    simplify()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hand.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "hand.blend"))
    armature = bpy.data.objects[name]
    assert restore(armature) is None
    assert contents(armature) == before


def test_only_the_chosen_fingers_lose_keys(armature):
    before = contents(armature)
    simplify(Bounds(parts=frozenset({"thumb"})))
    after = contents(armature)
    fewer = {path for path, _ in before if len(after[path, _]) < len(before[path, _])}
    assert {path.split('"')[1] for path in fewer} == {n for n in bone_names("right") if n.startswith("thumb")}
    assert all(after[k] == before[k] for k in before if k[0] not in fewer)
    simplify(Bounds(6.0, 9.0, parts=frozenset({"index"})))
    both = contents(armature)
    assert all(both[k] == after[k] for k in before if k[0] in fewer)
    assert {k[0].split('"')[1] for k in before if len(both[k]) < len(after[k])} == {
        n for n in bone_names("right") if n.startswith("index")
    }
    restore(armature)
    assert contents(armature) == before


def test_bones_in_euler_angles(armature):
    names = bone_names("right")
    keys = read_pose_keys(rig_of(armature))
    for name in names[1:4]:
        armature.pose.bones[name].rotation_mode = "ZXY"
    write_pose_keys(rig_of(armature), keys)
    dense = evaluated(armature, keys.frames, names)
    simplify(Bounds(2.0, 1000.0, "BONE"))
    assert apart(evaluated(armature, keys.frames, names), dense) <= 2.0
    assert any("rotation_euler" in path for path, _ in contents(armature))


def test_a_characters_hand(armature):
    armature = chosen(build_armature(hand_specs("left", np.random.default_rng(1), bend=0.3)))
    names = [joint_name(joint, "left") for joint in range(NUM_JOINTS)]
    for name in names:
        armature.pose.bones[name].rotation_mode = "XYZ"
    keep_map(armature, HandMap("left", tuple(names)))
    (hand,) = hands_to_simplify(bpy.context)
    t = FRAMES[:, None, None] / 25.0
    swing = 0.7 * np.sin(t * np.linspace(0.5, 2.0, 16)[:, None] + np.array([0.0, 1.0, 2.0]))
    write_pose_keys(hand.rig, PoseKeys.everywhere(FRAMES, rotvec_to_quat(swing)))
    dense = evaluated(armature, FRAMES, names)
    before = count_of(armature)
    (found,) = simplify(Bounds(1.0))
    assert found.result.pixels is None
    assert apart(evaluated(armature, FRAMES, names), dense) <= 1.0
    assert count_of(armature) < 0.4 * before


@pytest.mark.parametrize("what", ["locked", "no action", "nothing chosen"])
def test_what_cannot_be_simplified_says_so_and_stays(armature, what):
    data = armature.animation_data
    if what == "locked":
        curves_of(armature)[20].lock = True
    elif what == "no action":
        data.action = None
    action = data.action
    bounds = Bounds(parts=frozenset()) if what == "nothing chosen" else Bounds()
    sentence = {"locked": "are locked", "no action": "no keys to simplify"}.get(what, "chosen parts")
    with pytest.raises(OptionError, match=sentence):
        simplify(bounds)
    assert data.action == action
    assert len(bpy.data.actions) == 1


def test_corrections_are_kept_and_can_be_cleared_afterwards(armature):
    frames = read_pose_keys(rig_of(armature)).frames
    captured = pose_at(rig_of(armature), frames)[0]
    correct(armature, frame=30)
    corrected = pose_at(rig_of(armature), frames)[0]
    simplify(Bounds(1.0, 1.0, "BONE"))
    assert corrections.why_elsewhere(armature) is None
    assert corrections.displaced(armature) == []
    at = int(np.flatnonzero(frames == 30)[0])
    assert apart(pose_at(rig_of(armature), frames)[0][at], corrected[at]) < 0.01
    corrections.clear_corrections(armature)
    left = pose_at(rig_of(armature), frames)[0]
    assert apart(left[at], captured[at]) < 0.1
    far = np.abs(frames - 30) > 20
    assert apart(left[far], captured[far]) <= 1.0


def test_a_correction_after_simplify_is_taken_out_again(armature):
    simplify(Bounds(2.0, 2.0, "FINGER"))
    places = np.arange(1.0, 80.0, 0.5)
    before = pose_at(rig_of(armature), places)[0]
    correct(armature, frame=33, spread=6.0)
    corrected = pose_at(rig_of(armature), places)[0]
    assert apart(corrected, before) > 5.0
    beyond = np.abs(places - 33) >= 6
    assert apart(corrected[beyond], before[beyond]) < 0.05
    corrections.clear_corrections(armature)
    assert (
        apart(pose_at(rig_of(armature), places)[0], before) < 0.5
    )  # curves there are of length one only nearly


@pytest.mark.parametrize("since", ["nothing", "shape", "origin"])
def test_all_keys_come_back_with_the_corrections_that_they_hold(armature, since):
    correct(armature, frame=30)
    simplify()
    if since == "shape":
        armature.manient.betas = [2.0, -1.0, 1.5, *[0.0] * 7]
    elif since == "origin":
        origin_to_wrist(hand_of(armature))
    held = armature.manient.corrections
    shown = pose_at(rig_of(armature), np.array([30.0]))
    assert restore(armature) is None
    assert armature.manient.corrections == held
    assert corrections.why_elsewhere(armature) is None
    assert corrections.displaced(armature) == []
    there = pose_at(rig_of(armature), np.array([30.0]))
    assert apart(there[0], shown[0]) < 0.1
    np.testing.assert_allclose(there[1], shown[1], atol=1e-4)


def test_all_keys_come_back_with_what_was_corrected_since(armature):
    frames = np.arange(1.0, 81.0)
    captured = pose_at(rig_of(armature), frames)[0]
    simplify()
    correct(armature, frame=50)
    shown = pose_at(rig_of(armature), np.array([50.0]))[0]
    assert restore(armature).name.endswith("(fewer keys)")
    assert apart(pose_at(rig_of(armature), np.array([50.0]))[0], shown) < 0.01
    corrections.clear_corrections(armature)
    assert apart(pose_at(rig_of(armature), frames)[0], captured) < 0.01


def test_a_merged_layer_is_in_all_keys_too(armature):
    frames = np.arange(1.0, 81.0)
    simplify()
    bone = bone_names("right")[1]
    add_layer(armature)
    for frame, turn in ((20.0, 0.0), (26.0, 0.4), (32.0, 0.0)):
        key_change(armature, bone, frame, (turn, 0.0, 0.0))
    end_layer(armature, merge=True)
    shown = pose_at(rig_of(armature), frames)[0]
    assert restore(armature) is None
    assert apart(pose_at(rig_of(armature), frames)[0], shown) <= 2.5  # simplified by 2, merged by half of one
    assert apart(pose_at(rig_of(armature), frames[25:26])[0], shown[25:26]) <= 2.0


def test_corrections_are_known_after_a_merge_over_them(armature):
    correct(armature, frame=30)
    add_layer(armature)
    for joint in range(1, NUM_JOINTS):
        key_change(armature, bone_names("right")[joint], 30.0, (0.0, 0.2, 0.0))
    end_layer(armature, merge=True)
    assert corrections.displaced(armature) == []
    assert corrections.why_elsewhere(armature) is None
    correct(armature, frame=60)
    assert corrections.corrected_frames(armature) == [30, 60]


def test_a_range_that_is_fitted_again_after_simplify(armature):
    simplify(Bounds(2.0, 2.0, "BONE"))
    frames, places = list(range(30, 41)), np.arange(1.0, 81.0)
    before = pose_at(rig_of(armature), places)[0]
    new, _ = moved_poses(armature, frames)
    refitted(armature, frames)
    after = pose_at(rig_of(armature), places)[0]
    assert apart(after[29:40], new) < 0.01
    keyed = read_pose_keys(rig_of(armature))
    for joint in range(NUM_JOINTS):
        own = keyed.frames[keyed.rotation_keyed[:, joint]]
        outside = (places <= own[own < 30].max()) | (places >= own[own > 40].min())
        assert apart(after[outside, joint], before[outside, joint]) < 0.01


def test_all_keys_follow_when_the_hand_gets_another_shape(armature):
    frames = read_pose_keys(rig_of(armature)).frames
    bare = pose_at(rig_of(armature), frames)[0]
    old = rig_of(armature).rest
    simplify()
    armature.manient.betas = [2.0, -1.0, 1.5, *[0.0] * 7]
    restore(armature)
    new = rig_of(armature).rest
    assert apart(old.frames, new.frames) > 0.05
    assert apart(pose_at(rig_of(armature), frames)[0], old.turned_to(new, bare)) < 0.01


def test_keys_that_are_left_are_the_captures_own(armature):
    hand = hand_of(armature)
    simplify(Bounds(2.0, 2.0, "BONE"))
    assert not keyed_by_hand(hand, np.arange(len(FRAMES))).any()


def test_what_follows_a_simplified_hand_gets_all_of_its_motion(armature, make_take):
    simplify(Bounds(2.0, 2.0, "BONE"))
    frames = np.arange(1.0, 81.0)
    quats = pose_at(rig_of(armature), frames)[0]
    motion = run_to_completion(reading_motion(hand_of(armature)))
    np.testing.assert_array_equal(motion.frames, frames)
    other = build_take(make_take(sides=("right",), frame_numbers=FRAMES, seed=5).take).hands[0].armature
    apply_hand(other, armature, "ANIMATION", 1.0)
    turned = rig_of(armature).rest.turned_to(rig_of(other).rest, quats)
    assert apart(pose_at(rig_of(other), frames)[0], turned) < 0.1


def test_the_mirrored_hand_of_a_simplified_one(armature):
    simplify(Bounds(2.0, 2.0, "BONE"))
    frames = np.arange(1.0, 81.0)
    quats = pose_at(rig_of(armature), frames)[0]
    other = mirror_hand(hand_of(armature))
    turned = rig_of(armature).rest.turned_to(rig_of(other).rest, quats)
    assert apart(pose_at(rig_of(other), frames)[0], turned) < 0.5


def test_the_preview_says_what_the_operator_does_and_follows_the_sliders(armature):
    settings = bpy.context.scene.manient
    assert key_preview.preview(bpy.context) is None
    while key_preview._continue() is not None:
        pass
    found = key_preview.preview(bpy.context)
    settings.keys_degrees = 4.0
    settings.keys_pixels = 9.0
    assert key_preview.preview(bpy.context) is None
    while key_preview._continue() is not None:
        pass
    looser = key_preview.preview(bpy.context)
    assert looser[0].after < found[0].after
    assert key_preview.found_now(bpy.context) is looser
    assert bpy.ops.manient.simplify_keys() == {"FINISHED"}
    assert count_of(armature) == looser[0].after
    assert bpy.ops.manient.restore_keys() == {"FINISHED"}
    assert not bpy.ops.manient.restore_keys.poll()


@pytest.mark.parametrize("what", ["rotation mode", "table"])
def test_a_preview_of_other_bones_is_not_written(what):
    armature = chosen(build_armature(hand_specs("left", np.random.default_rng(1), bend=0.3)))
    names = [joint_name(joint, "left") for joint in range(NUM_JOINTS)]
    keep_map(armature, HandMap("left", tuple(names)))
    swing = 0.7 * np.sin(FRAMES[:, None, None] / 25.0 * np.linspace(0.5, 2.0, 16)[:, None] + np.arange(3.0))
    (hand,) = hands_to_simplify(bpy.context)
    write_pose_keys(hand.rig, PoseKeys.everywhere(FRAMES, rotvec_to_quat(swing)))
    key_preview.preview(bpy.context)
    while key_preview._continue() is not None:
        pass
    found = key_preview.found_now(bpy.context)
    if what == "rotation mode":
        armature.pose.bones[names[1]].rotation_mode = "XYZ"
    else:
        names[1:7] = names[4:7] + names[1:4]  # the middle finger's bones for the index finger's
        keep_map(armature, HandMap("left", tuple(names)))
    assert key_preview.found_now(bpy.context) is not found
    assert key_preview.preview(bpy.context) is None
    assert bpy.ops.manient.simplify_keys() == {"FINISHED"}
    assert not any("rotation_euler" in path for path, _ in contents(armature))


def test_the_preview_is_found_for_the_hand_that_the_panel_shows(armature):
    """Blender's timers know no window, and thus not always the scene and the hand that the panel shows."""
    other = armature.copy()
    bpy.context.collection.objects.link(other)
    with bpy.context.temp_override(active_object=other, selected_objects=[other]):
        assert key_preview.preview(bpy.context) is None
    while key_preview._continue() is not None:
        pass
    with bpy.context.temp_override(active_object=other, selected_objects=[other]):
        (found,) = key_preview.preview(bpy.context)
    assert found.hand.rig.armature == other
    assert key_preview.preview(bpy.context) is None
    bpy.data.objects.remove(armature)  # before it was looked at
    assert key_preview._continue() is None
    with bpy.context.temp_override(active_object=other, selected_objects=[other]):
        assert key_preview.preview(bpy.context) is None


def key_change(armature, bone: str, frame: float, turn) -> None:
    """Key a rotation in the layer, as an artist does who keys what the bone shows."""
    curves = channels(*layer_of(armature), make=True).fcurves
    path = f'pose.bones["{bone}"].rotation_quaternion'
    for i, value in enumerate(rotvec_to_quat(np.array(turn))):
        curve = curves.find(path, index=i) or curves.new(path, index=i)
        curve.keyframe_points.insert(frame, value)


def layer_of(armature):
    data = armature.animation_data
    assign_action(armature, data.action)
    return data.action, action_slot(data)


@pytest.mark.parametrize("simplified", [False, True])
def test_a_layer_is_added_and_merged_or_taken_away(armature, simplified):
    if simplified:
        simplify(Bounds(2.0, 2.0, "BONE"))
    names, frames = bone_names("right"), np.arange(1.0, 81.0)
    frames = frames[np.isin(frames, read_pose_keys(rig_of(armature)).frames) | simplified]
    motion, kept = armature.animation_data.action, contents(armature)
    before = evaluated(armature, frames, names)
    layer = add_layer(armature)
    assert armature.animation_data.action == layer
    assert apart(evaluated(armature, frames, names), before) < 0.05
    assert why_not_keyable(armature).startswith("The active action is a layer on top of the motion")
    with pytest.raises(OptionError, match="layer on top"):
        corrections.check_writable(armature)
    with pytest.raises(OptionError, match="layer on top"):
        mirror_hand(hand_of(armature))
    for frame, turn in ((20.0, (0, 0, 0)), (31.5, (0.5, 0.2, 0)), (45.0, (0, 0, 0))):
        key_change(armature, names[1], frame, turn)
    shown = evaluated(armature, frames, names)
    inside = np.abs(frames - 31.5) < 1.0
    wanted = quat_multiply(before[inside, 1], rotvec_to_quat(np.array([0.5, 0.2, 0.0])))
    assert apart(shown[inside, 1], wanted) < 3.0
    assert apart(shown[:, 2:], before[:, 2:]) < 0.05
    # What reads the hand sees the changes: a take that is exported, a character that follows.
    at = np.isin(FRAMES, frames)
    pose = retaken([hand_of(armature)]).hands[0].hand_pose[at, :3]
    assert np.abs(pose[inside] - hand_of(armature).track.hand_pose[at, :3][inside]).max() > 0.2
    assert len(run_to_completion(reading_motion(hand_of(armature))).frames) >= len(frames)
    end_layer(armature, merge=False)
    assert armature.animation_data.action == motion
    assert contents(armature) == kept
    assert not len(armature.animation_data.nla_tracks)
    assert why_not_keyable(armature) is None

    name = add_layer(armature).name
    for frame, turn in ((20.0, (0, 0, 0)), (31.5, (0.5, 0.2, 0)), (45.0, (0, 0, 0))):
        key_change(armature, names[1], frame, turn)
    shown = evaluated(armature, np.append(frames, 31.5), names)
    end_layer(armature, merge=True)
    assert armature.animation_data.action == motion
    assert apart(evaluated(armature, np.append(frames, 31.5), names), shown) < (0.6 if simplified else 0.05)
    assert name not in bpy.data.actions


def test_a_layer_with_keys_on_everything_is_merged_without_what_changes_nothing(armature):
    bone = armature.pose.bones[bone_names("right")[2]]
    paths = set(contents(armature))
    add_layer(armature)
    for frame, bend in ((20, 0.0), (40, 0.4), (60, 0.0)):
        bpy.context.scene.frame_set(frame)
        turned = quat_multiply(np.array(bone.rotation_quaternion), rotvec_to_quat(np.array([bend, 0.0, 0.0])))
        bone.rotation_quaternion = turned
        for path in ("location", "rotation_quaternion", "scale"):
            bone.keyframe_insert(path, frame=frame)
    frames = np.array([20.0, 33.0, 40.0, 52.0])
    shown = evaluated(armature, frames, [bone.name])
    end_layer(armature, merge=True)
    assert set(contents(armature)) == paths
    assert apart(evaluated(armature, frames, [bone.name]), shown) < 0.05


def test_a_layer_hides_nothing_of_a_motion_with_a_range_set_by_hand(armature):
    motion, bone = armature.animation_data.action, bone_names("right")[1:2]
    motion.use_frame_range, motion.frame_start, motion.frame_end = True, 10, 20
    before = evaluated(armature, FRAMES[::10], bone)
    add_layer(armature)
    assert apart(evaluated(armature, FRAMES[::10], bone), before) < 0.01


@pytest.mark.parametrize("what", ["strip muted", "track muted", "trimmed", "added", "faded"])
def test_a_motion_that_is_not_shown_whole_is_not_merged(armature, what):
    motion = armature.animation_data.action
    add_layer(armature)
    key_change(armature, bone_names("right")[1], 20.0, (0.3, 0, 0))
    track = armature.animation_data.nla_tracks[0]
    strip = track.strips[0]
    if what == "strip muted":
        strip.mute = True
    elif what == "track muted":
        track.mute = True
    elif what == "trimmed":
        strip.action_frame_end = 8.0
    elif what == "added":
        strip.blend_type = "ADD"
    else:
        strip.blend_in = 10.0
    kept = contents(armature)
    with pytest.raises(OptionError, match="not shown as its keys are"):
        end_layer(armature, merge=True)
    assert contents(armature) == kept
    end_layer(armature, merge=False)
    assert armature.animation_data.action == motion


def test_a_layer_that_cannot_be_merged_says_so(armature):
    assert bpy.ops.manient.add_key_layer() == {"FINISHED"}
    assert not bpy.ops.manient.simplify_keys.poll()
    strip = armature.animation_data.nla_tracks[0].strips[0]
    key_change(armature, bone_names("right")[1], 20.0, (0.3, 0, 0))
    bone = armature.pose.bones[0]
    bone.scale = (2.0, 2.0, 2.0)
    bone.keyframe_insert("scale", frame=20)
    with pytest.raises(OptionError, match="neither a bone's rotation nor its location"):
        end_layer(armature, merge=True)
    strip.frame_start += 5.0
    with pytest.raises(OptionError, match="another time"):
        end_layer(armature, merge=True)
    end_layer(armature, merge=False)
    with pytest.raises(OptionError, match="no layer"):
        end_layer(armature, merge=True)
    armature.animation_data.action = None
    with pytest.raises(OptionError, match="no motion"):
        add_layer(armature)
