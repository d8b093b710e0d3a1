"""Fewer keys in Blender's own curves, every one of them back, and a layer for changes on top."""

from __future__ import annotations

from itertools import permutations

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
from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import NUM_JOINTS
from handfit_core.common.slices import run_to_completion
from handfit_core.geometry.rotations import quat_multiply, rotvec_to_quat
from handfit_core.retarget.hand_map import HandMap

from .characters import build_armature, hand_specs, joint_name
from .looking import apart, bones_at, chosen, curves_of
from .test_corrections import correct
from .test_keys import contents

pytestmark = pytest.mark.usefixtures("registered")

FRAMES = np.arange(1, 81)


@pytest.fixture
def made(make_take):
    return make_take(sides=("right",), frame_numbers=FRAMES)


def simplify(bounds=Bounds()) -> list:  # noqa: B008
    found = [run_to_completion(thinning(hand, bounds)) for hand in hands_to_simplify(bpy.context)]
    write(found[0].hand.rig.armature, found)
    return found


def count_of(armature) -> int:
    return sum(len(curve.keyframe_points) for curve in curves_of(armature))


def evaluated(armature, frames, names) -> np.ndarray:
    """(N, B, 4) what Blender itself evaluates."""
    shown = ([bones_at(armature, frame)[name] for name in names] for frame in frames)
    return np.array([[bone.matrix_basis.to_quaternion() for bone in bones] for bones in shown])


def poses(armature, frames) -> np.ndarray:
    """(N, 16, 4) what the keys say."""
    return pose_at(rig_of(armature), np.asarray(frames, dtype=float))[0]


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
    assert not keyed_by_hand(hand_of(armature), np.arange(len(FRAMES))).any()


def test_all_keys_come_back_bit_for_bit(armature, tmp_path):
    before, name = contents(armature), armature.animation_data.action.name
    simplify()
    dense = kept_action(armature)
    assert dense.use_fake_user
    assert dense.name == f"{name} (all keys)"
    assert armature.animation_data.action.name == name
    simplify(Bounds(5.0, 9.0))  # from all keys again, not from those that were left
    assert kept_action(armature) == dense
    assert len(bpy.data.actions) == 2
    owner, path = armature.name, str(tmp_path / "hand.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    armature = bpy.data.objects[owner]
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
    assert (kept.use_fake_user, kept.get(DENSE)) == (True, None)


def test_only_the_chosen_fingers_lose_keys(armature, make_take):
    """What follows the hand gets all of its motion."""
    counts, quats = [contents(armature)], poses(armature, FRAMES)
    for finger, bounds in (("thumb", (2.0, 3.0)), ("index", (6.0, 9.0))):
        simplify(Bounds(*bounds, parts=frozenset({finger})))
        counts.append(contents(armature))
        fewer = {path for path in counts[0] if len(counts[-1][path]) < len(counts[-2][path])}
        named = {name for name in bone_names("right") if name.startswith(finger)}
        assert {path.split('"')[1] for path, _ in fewer} == named
        assert all(counts[-1][path] == counts[-2][path] for path in counts[0] if path not in fewer)
    motion = run_to_completion(reading_motion(hand_of(armature)))
    np.testing.assert_array_equal(motion.frames, FRAMES)
    same = build_take(make_take(sides=("right",), frame_numbers=FRAMES, seed=5).take).hands[0].armature
    apply_hand(same, armature, "ANIMATION", 1.0)
    for other in (same, mirror_hand(hand_of(armature))):
        turned = rig_of(armature).rest.turned_to(rig_of(other).rest, poses(armature, FRAMES))
        assert apart(poses(other, FRAMES), turned) < 0.5
    restore(armature)
    assert contents(armature) == counts[0]
    np.testing.assert_array_equal(poses(armature, FRAMES), quats)


@pytest.mark.parametrize(
    ("what", "said"),
    [("locked", "are locked"), ("no action", "no keys to simplify"), ("nothing chosen", "chosen parts")],
)
def test_what_cannot_be_simplified_says_so_and_stays(armature, what, said):
    data = armature.animation_data
    if what == "locked":
        curves_of(armature)[20].lock = True
    elif what == "no action":
        data.action = None
    action = data.action
    with pytest.raises(OptionError, match=said):
        simplify(Bounds(parts=frozenset()) if what == "nothing chosen" else Bounds())
    assert data.action == action
    assert len(bpy.data.actions) == 1


def test_corrections_before_and_after_can_be_cleared(armature):
    captured = poses(armature, FRAMES)
    correct(armature, frame=30)
    corrected = poses(armature, [30])
    simplify(Bounds(1.0, 1.0, "BONE"))
    assert corrections.displaced(armature) == []
    assert apart(poses(armature, [30]), corrected) < 0.01
    places = np.arange(1.0, 80.0, 0.5)
    before = poses(armature, places)
    correct(armature, frame=63, spread=6.0)
    after = poses(armature, places)
    assert apart(after, before) > 5.0
    beyond = np.abs(places - 63) >= 6
    assert apart(after[beyond], before[beyond]) < 0.05
    corrections.clear_corrections(armature, [63])
    # Between keys, curves are only nearly of length one.
    assert apart(poses(armature, places), before) < 0.5
    corrections.clear_corrections(armature)
    assert apart(poses(armature, [30]), captured[29:30]) < 0.1
    far = np.abs(FRAMES - 30) > 20
    assert apart(poses(armature, FRAMES[far]), captured[far]) <= 1.0


@pytest.mark.parametrize("since", ["nothing", "shape", "origin", "correction"])
def test_all_keys_come_back_with_their_corrections(armature, since):
    captured = poses(armature, FRAMES)
    correct(armature, frame=30)
    simplify()
    if since == "shape":
        armature.manient.betas = [2.0, -1.0, 1.5, *[0.0] * 7]
    elif since == "origin":
        origin_to_wrist(hand_of(armature))
    elif since == "correction":
        correct(armature, frame=50)
    held = corrections.corrections_text(armature)
    frames = np.array([30.0, 50.0])[: 1 + (since == "correction")]
    shown = pose_at(rig_of(armature), frames)
    kept = restore(armature)
    if since == "correction":
        assert kept.name.endswith("(fewer keys)")
    else:
        assert (kept, corrections.corrections_text(armature)) == (None, held)
    assert corrections.displaced(armature) == []
    there = pose_at(rig_of(armature), frames)
    assert apart(there[0], shown[0]) < 0.1
    np.testing.assert_allclose(there[1], shown[1], atol=1e-4)
    corrections.clear_corrections(armature)
    if since != "shape":
        assert apart(poses(armature, FRAMES), captured) < 0.01


# The preview in the panel


def finish_preview() -> None:
    while key_preview._continue() is not None:
        pass


def test_the_preview_says_what_the_operator_does_and_follows_the_sliders(armature):
    settings = bpy.context.scene.manient
    found = []
    for degrees, pixels in ((2.0, 3.0), (4.0, 9.0)):
        settings.keys_degrees, settings.keys_pixels = degrees, pixels
        assert key_preview.preview(bpy.context) is None
        finish_preview()
        found.append(key_preview.preview(bpy.context))
    assert found[1][0].after < found[0][0].after
    assert key_preview.found_now(bpy.context) is found[1]
    assert bpy.ops.manient.simplify_keys() == {"FINISHED"}
    assert count_of(armature) == found[1][0].after
    assert bpy.ops.manient.restore_keys() == {"FINISHED"}
    assert not bpy.ops.manient.restore_keys.poll()


@pytest.mark.parametrize("what", ["rotation mode", "table"])
def test_a_characters_hand_and_a_preview_of_other_bones(what):
    armature = chosen(build_armature(hand_specs("left", np.random.default_rng(1), bend=0.3)))
    names = [joint_name(joint, "left") for joint in range(NUM_JOINTS)]
    for name in names:
        armature.pose.bones[name].rotation_mode = "XYZ"
    keep_map(armature, HandMap("left", tuple(names)))
    swing = 0.7 * np.sin(FRAMES[:, None, None] / 25.0 * np.linspace(0.5, 2.0, 16)[:, None] + np.arange(3.0))
    (hand,) = hands_to_simplify(bpy.context)
    write_pose_keys(hand.rig, PoseKeys.everywhere(FRAMES, rotvec_to_quat(swing)))
    key_preview.preview(bpy.context)
    finish_preview()
    (found,) = key_preview.found_now(bpy.context)
    if what == "rotation mode":
        armature.pose.bones[names[1]].rotation_mode = "QUATERNION"
    else:
        names[1:7] = names[4:7] + names[1:4]  # the middle finger's bones for the index finger's
        keep_map(armature, HandMap("left", tuple(names)))
    assert key_preview.preview(bpy.context) is None
    assert key_preview.found_now(bpy.context)[0] is not found
    dense, before = evaluated(armature, FRAMES, names), count_of(armature)
    (found,) = simplify(Bounds(1.0))
    assert found.result.pixels is None
    assert apart(evaluated(armature, FRAMES, names), dense) <= 1.0
    assert count_of(armature) < 0.4 * before


def test_the_preview_is_found_for_the_hand_that_the_panel_shows(armature):
    """Blender's timers know no window, and thus not always the scene and the hand that the panel shows."""
    other = armature.copy()
    bpy.context.collection.objects.link(other)
    with bpy.context.temp_override(active_object=other, selected_objects=[other]):
        assert key_preview.preview(bpy.context) is None
        finish_preview()
        (found,) = key_preview.preview(bpy.context)
    assert found.hand.rig.armature == other
    assert key_preview.preview(bpy.context) is None
    bpy.data.objects.remove(armature)  # before it was looked at
    assert key_preview._continue() is None


# A layer on top


def key_change(armature, bone: str, frame: float, turn) -> None:
    """Key a rotation in the layer, as an artist does who keys what the bone shows."""
    data = armature.animation_data
    assign_action(armature, data.action)
    curves = channels(data.action, action_slot(data), make=True).fcurves
    path = f'pose.bones["{bone}"].rotation_quaternion'
    for i, value in enumerate(rotvec_to_quat(np.array(turn))):
        curve = curves.find(path, index=i) or curves.new(path, index=i)
        curve.keyframe_points.insert(frame, value)


def change(armature, turn=(0.4, 0.2, 0.0)) -> None:
    """Turn one bone of the layer for some frames."""
    for frame, by in ((20.0, (0, 0, 0)), (31.5, turn), (45.0, (0, 0, 0))):
        key_change(armature, bone_names("right")[1], frame, by)


@pytest.mark.parametrize("simplified", [False, True])
def test_a_layer_is_added_and_merged_or_taken_away(armature, simplified):
    if simplified:
        simplify(Bounds(2.0, 2.0, "BONE"))
    names, frames = bone_names("right"), np.append(np.arange(1.0, 81.0, 3.0), [31.0, 31.5])
    motion, kept = armature.animation_data.action, contents(armature)
    motion.use_frame_range, motion.frame_start, motion.frame_end = True, 10, 20
    before = evaluated(armature, frames, names)
    layer = add_layer(armature)
    assert armature.animation_data.action == layer
    assert apart(evaluated(armature, frames, names), before) < 0.05
    assert why_not_keyable(armature).startswith("The active action is a layer on top of the motion")
    for refused in (lambda: corrections.check_writable(armature), lambda: mirror_hand(hand_of(armature))):
        with pytest.raises(OptionError, match="layer on top"):
            refused()
    change(armature)
    shown = evaluated(armature, frames, names)
    wanted = quat_multiply(before[-1, 1], rotvec_to_quat(np.array([0.4, 0.2, 0.0])))
    assert apart(shown[-1, 1], wanted) < 3.0
    assert apart(shown[:, 2:], before[:, 2:]) < 0.05
    # What reads the hand sees the changes: a take that is exported, a character that follows.
    pose = retaken([hand_of(armature)]).hands[0].hand_pose[30, :3]
    assert np.abs(pose - hand_of(armature).track.hand_pose[30, :3]).max() > 0.2
    assert len(run_to_completion(reading_motion(hand_of(armature))).frames) == len(FRAMES)
    end_layer(armature, merge=False)
    assert armature.animation_data.action == motion
    assert contents(armature) == kept
    assert not len(armature.animation_data.nla_tracks)
    assert why_not_keyable(armature) is None

    name = add_layer(armature).name
    change(armature)
    end_layer(armature, merge=True)
    assert armature.animation_data.action == motion
    assert apart(evaluated(armature, frames, names), shown) < (0.6 if simplified else 0.05)
    assert name not in bpy.data.actions


def test_a_layer_with_keys_on_everything_is_merged_without_what_changes_nothing(armature):
    bone, paths = armature.pose.bones[bone_names("right")[2]], set(contents(armature))
    add_layer(armature)
    for frame, bend in ((20, 0.0), (40, 0.4), (60, 0.0)):
        bpy.context.scene.frame_set(frame)
        turn = rotvec_to_quat(np.array([bend, 0.0, 0.0]))
        bone.rotation_quaternion = quat_multiply(np.array(bone.rotation_quaternion), turn)
        for path in ("location", "rotation_quaternion", "scale"):
            bone.keyframe_insert(path, frame=frame)
    frames = np.array([20.0, 33.0, 40.0, 52.0])
    shown = evaluated(armature, frames, [bone.name])
    end_layer(armature, merge=True)
    assert set(contents(armature)) == paths
    assert apart(evaluated(armature, frames, [bone.name]), shown) < 0.05


@pytest.mark.parametrize("track", [{}, {"mute": True}])
@pytest.mark.parametrize(
    "strip", [{"mute": True}, {"action_frame_end": 8.0}, {"blend_type": "ADD"}, {"blend_in": 10.0}]
)
def test_what_blender_shows_is_merged(armature, track, strip):
    add_layer(armature)
    change(armature)
    above = armature.animation_data.nla_tracks[0]
    for owner, changes in ((above, track), (above.strips[0], strip)):
        for name, value in changes.items():
            setattr(owner, name, value)
    armature.animation_data.action_influence = 0.7
    names, frames = bone_names("right"), np.append(np.arange(1.0, 81.0, 6.0), 31.5)
    shown = evaluated(armature, frames, names)
    end_layer(armature, merge=True)
    assert apart(evaluated(armature, frames, names), shown) < 0.05


def test_a_layer_that_cannot_be_merged_says_so(armature):
    assert bpy.ops.manient.add_key_layer() == {"FINISHED"}
    assert not bpy.ops.manient.simplify_keys.poll()
    bone = armature.pose.bones[0]
    bone.scale = (2.0, 2.0, 2.0)
    bone.keyframe_insert("scale", frame=20)
    strip = armature.animation_data.nla_tracks[0].strips[0]
    for start, said in ((6.0, "another time"), (1.0, "neither a bone's rotation nor its location")):
        strip.frame_start = start
        with pytest.raises(OptionError, match=said):
            end_layer(armature, merge=True)
    end_layer(armature, merge=False)
    with pytest.raises(OptionError, match="no layer"):
        end_layer(armature, merge=True)
    armature.animation_data.action = None
    with pytest.raises(OptionError, match="no motion"):
        add_layer(armature)


# What the artist has corrected stays, in whatever order keys are merged, simplified and undone. It is lost
# only by Undo of the press before it. All Keys goes back to the keys of before Simplify, with the corrections
# and merged layers of after it.

EARLY, LATE = 12, 24
"""Frames that are corrected"""
ORDERS = (
    *(order for other in ("correct", "undo") for order in permutations(("merge", "simplify", other))),
    *(order for other in ("correct", "merge") for order in permutations(("simplify", other, "all keys"))),
)


@pytest.mark.parametrize(
    "presses",
    [
        pytest.param(order, marks=pytest.mark.slow if i % 3 else (), id=", ".join(order))
        for i, order in enumerate(ORDERS)
    ],
)
def test_no_order_of_presses_loses_a_correction(make_take, presses):
    take = make_take(sides=("right",), frame_numbers=np.arange(1, 37)).take
    name = chosen(build_take(take).hands[0].armature).name
    bpy.context.scene.manient.keys_parts = {"MIDDLE"}  # which is enough to lose, and faster
    steps: list[dict[int, np.ndarray]] = [{}]

    def press(what: str) -> None:
        hand, corrected = bpy.data.objects[name], dict(steps[-1])
        if what == "simplify":
            bpy.ops.manient.simplify_keys()
        elif what == "all keys":
            if bpy.ops.manient.restore_keys.poll():
                bpy.ops.manient.restore_keys()
        else:
            frame = LATE if corrected else EARLY
            if what == "correct":
                correct(hand, frame, seed=5 + len(steps))
            else:
                bpy.ops.manient.add_key_layer()
                for at, turn in ((20.0, 0.0), (LATE, 0.4), (28.0, 0.0)):
                    key_change(hand, bone_names("right")[5], at, (turn, 0.0, 0.0))
                bpy.ops.manient.end_key_layer(merge=True)
            corrected[frame] = poses(hand, [frame])
        bpy.ops.ed.undo_push(message="Press")
        steps.append(corrected)

    press("correct")
    del steps[0]
    for what in presses:
        if key_preview.preview(bpy.context) is None:
            finish_preview()
        if what != "undo":
            press(what)
        elif len(steps) > 1:
            bpy.ops.ed.undo()
            steps.pop()
        for frame, pose in steps[-1].items():
            off = apart(poses(bpy.data.objects[name], [frame]), pose)
            assert off <= bpy.context.scene.manient.keys_degrees, (what, frame)
    armature = bpy.data.objects[name]
    assert EARLY in corrections.corrections_of(armature).corrected
    assert corrections.displaced(armature) == []
