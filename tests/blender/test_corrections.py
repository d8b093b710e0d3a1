"""Corrections live in the .blend, and leave keys as they found them; what cannot be changed is left alone,
and says why: links, overrides, the NLA, locks, shared actions."""

from __future__ import annotations

import hashlib

import bpy
import numpy as np
import pytest

from blender_manient.operators.export import MANIENT_OT_export_hand
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import corrections, reshape
from blender_manient.scene.actions import push_down
from blender_manient.scene.apply import apply_track
from blender_manient.scene.editable import why_not_editable, why_not_keyable
from blender_manient.scene.keys import PoseKeys, displayed_pose, pose_at, read_pose_keys, write_pose_keys
from blender_manient.scene.store import captured_hands, hand_of
from blender_manient.session.refiner import why_not
from handfit_core.common.errors import HandModelError, OptionError
from handfit_core.edit.corrections import changed_quats, correction_between

from .conftest import FRAMES, UNSEEN
from .looking import chosen, curves_of

pytestmark = pytest.mark.usefixtures("registered")

SEEN = np.delete(FRAMES, UNSEEN)


def all_keys(armature) -> PoseKeys:
    return read_pose_keys(rig_of(armature))


def same_rotations(a: np.ndarray, b: np.ndarray) -> float:
    """The largest angle between two sets of quaternions, radians."""
    return float(np.linalg.norm(correction_between(a, b), axis=-1).max())


def moved_pose(armature, frame: int, seed: int = 1, size: float = 0.3):
    rng = np.random.default_rng(seed)
    quats, locations = pose_at(rig_of(armature), np.array([float(frame)]))
    turned = changed_quats(quats[0], np.zeros((16, 3)), rng.normal(scale=size, size=(16, 3)))
    return turned, locations[0] + rng.normal(scale=0.01, size=3)


def correct(armature, frame=6, spread=6.0, seed=1, size=0.6, pins=None) -> tuple[np.ndarray, np.ndarray]:
    """Correct a frame to another pose, which is returned."""
    quats, location = moved_pose(armature, frame, seed, size)
    pins = [pins or {8: (1.0, 2.0)}]
    corrections.correct_frames(armature, [frame], quats[None], location[None], spread, pins=pins)
    return quats, location


def pose_on(armature, frame: float) -> tuple[np.ndarray, np.ndarray]:
    """(16, 4), (3,) on a frame."""
    quats, locations = pose_at(rig_of(armature), np.array([float(frame)]))
    return quats[0], locations[0]


def write(armature, frame: float, quats, location=None) -> None:
    places = None if location is None else np.asarray(location)[None]
    write_pose_keys(rig_of(armature), PoseKeys.everywhere(np.array([float(frame)]), quats[None], places))


def moved_poses(armature, frames, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    quats, locations = zip(*(moved_pose(armature, f, seed + f) for f in frames), strict=True)
    return np.array(quats), np.array(locations)


def test_a_corrected_frame_takes_the_pose_and_its_neighbours_a_part(armature):
    before = all_keys(armature)
    quats, location = correct(armature, 6, 3, size=0.3, pins={8: (10.0, 20.0)})
    after = all_keys(armature)
    np.testing.assert_array_equal(after.frames, before.frames)
    at = int(np.flatnonzero(SEEN == 6)[0])
    assert same_rotations(after.quats[at], quats) < 1e-5
    np.testing.assert_allclose(after.locations[at], location, atol=1e-6)
    moved = np.linalg.norm(after.locations - before.locations, axis=-1)
    inside = (SEEN > 3) & (SEEN < 9)
    assert (moved[inside] > 1e-5).all()
    # Keys out of reach are the very same.
    np.testing.assert_array_equal(after.quats[~inside], before.quats[~inside])
    np.testing.assert_array_equal(after.locations[~inside], before.locations[~inside])
    assert corrections.corrections_of(armature).pins(6) == {8: (10.0, 20.0)}


@pytest.mark.parametrize("scope", [None, [5, 6, 16]])
def test_clearing_puts_every_key_back(armature, scope):
    before = all_keys(armature)
    for seed, frame in enumerate((6, 5, 16, 6)):
        correct(armature, frame, 6, seed=seed, size=0.8, pins={seed: (1.0, 2.0)})
    assert same_rotations(all_keys(armature).quats, before.quats) > 0.5
    assert corrections.clear_corrections(armature, scope) == 3
    after = all_keys(armature)
    assert same_rotations(after.quats, before.quats) < 1e-5
    np.testing.assert_allclose(after.locations, before.locations, atol=1e-5)
    assert corrections.corrections_text(armature) == ""


def test_what_was_done_by_hand_stays(armature):
    """A key that the artist turned under a correction keeps that turn when the correction goes."""
    correct(armature, 6, 6, size=0.3)
    now, _ = pose_on(armature, 8)
    turn, none = np.zeros((16, 3)), np.zeros((16, 3))
    turn[2] = [0.2, 0.0, 0.0]
    # The artist's turn comes first, the correction after it: so it is the bone's own before that.
    field_turn = corrections.corrections_of(armature).at(np.array([8.0]))[0][0]
    base = changed_quats(now, field_turn, none)
    write(armature, 8, changed_quats(changed_quats(base, none, turn), none, field_turn))
    corrections.clear_corrections(armature)
    np.testing.assert_allclose(correction_between(base, pose_on(armature, 8)[0]), turn, atol=1e-5)


@pytest.mark.parametrize("keyed_again", [False, True])
def test_a_frame_without_keys_loses_them_again_unless_they_say_more(armature, keyed_again):
    before = all_keys(armature)
    quats, location = correct(armature, 10, 0, size=0.3)
    assert [f for f in all_keys(armature).frames if f not in before.frames] == [10]
    found, place = pose_on(armature, 10)
    assert same_rotations(found, quats) < 1e-5
    np.testing.assert_allclose(place, location, atol=1e-6)
    if keyed_again:
        write(armature, 10, *moved_pose(armature, 10, seed=9))
    corrections.clear_corrections(armature, [10])
    after = all_keys(armature)
    assert (10 in after.frames) == keyed_again
    if not keyed_again:
        np.testing.assert_array_equal(after.quats, before.quats)


def refitted(armature, frames, seed: int = 0) -> PoseKeys:
    """Key other poses on a range, as Re-fit Range does; the keys after it."""
    for _ in corrections.replacing_poses(armature, frames, *moved_poses(armature, frames, seed)):
        pass
    return all_keys(armature)


def test_fitting_a_range_again_contains_its_corrections(armature):
    captured = all_keys(armature)
    correct(armature, 6, 3, size=0.3, pins={8: (10.0, 20.0)})
    frames = [5, 6, 8]
    new, _ = moved_poses(armature, frames)
    after = refitted(armature, frames)
    rows = np.isin(SEEN, frames)
    assert same_rotations(after.quats[rows], new) < 1e-5
    # What the correction did to frames outside of the range is gone with it.
    assert same_rotations(after.quats[~rows], captured.quats[~rows]) < 1e-5
    np.testing.assert_allclose(after.locations[~rows], captured.locations[~rows], atol=1e-6)
    field = corrections.corrections_of(armature)
    assert field.pins(6) == {8: (10.0, 20.0)}
    assert not field.at(np.array([6.0]))[0].any()
    corrections.clear_corrections(armature)
    np.testing.assert_allclose(all_keys(armature).quats, after.quats, atol=1e-6)


@pytest.mark.parametrize("spread", [2, 6, 20])
@pytest.mark.parametrize("corrected", [[4], [14], [4, 6, 14], [6, 8, 13]])
def test_clearing_after_a_range_was_fitted_again(armature, corrected, spread):
    """Inside stays what was fitted, outside comes back what was captured, whatever is cleared first."""
    captured = all_keys(armature)
    for frame in corrected:
        correct(armature, frame, spread, seed=frame, size=0.5)
    rows = (SEEN >= 6) & (SEEN <= 12)
    fitted = refitted(armature, SEEN[rows].tolist())
    assert set(corrections.corrections_of(armature).corrected) == set(corrected)
    for frame in corrected:
        corrections.clear_corrections(armature, [frame])
        now = all_keys(armature)
        at = np.isin(now.frames, SEEN[rows])
        assert same_rotations(now.quats[at], fitted.quats[np.isin(fitted.frames, SEEN[rows])]) < 1e-5
    now = all_keys(armature)
    np.testing.assert_array_equal(now.frames, captured.frames)
    assert same_rotations(now.quats[~rows], captured.quats[~rows]) < 1e-5
    np.testing.assert_allclose(now.locations[~rows], captured.locations[~rows], atol=1e-6)
    assert corrections.corrections_text(armature) == ""


def give(armature, action) -> None:
    armature.animation_data.action = action
    if hasattr(action, "slots"):
        armature.animation_data.action_slot = action.slots[0]


def reopened(armature, path) -> bpy.types.Object:
    """The hand in its file, saved and opened."""
    name = armature.name
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return chosen(bpy.data.objects[name])


def test_corrections_go_with_their_action(armature, tmp_path):
    """Through other actions in its place, copies, files and undo."""
    captured = all_keys(armature)
    other = armature.animation_data.action.copy()
    other.use_fake_user = True
    correct(armature)
    first = armature.animation_data.action
    give(armature, other)
    assert corrections.corrected_frames(armature) == []
    assert not bpy.ops.manient.clear_corrections.poll()
    correct(armature, 8)
    assert corrections.corrected_frames(armature) == [8]
    give(armature, first.copy())
    first.name = "My Motion"
    assert corrections.clear_corrections(armature) == 1
    assert same_rotations(all_keys(armature).quats, captured.quats) < 1e-5
    assert corrections.MARK not in armature.animation_data.action
    pushed = other.name
    give(armature, first)
    armature = reopened(armature, tmp_path / "actions.blend")
    bpy.ops.ed.undo_push(message="Open")
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    assert same_rotations(all_keys(armature).quats, captured.quats) < 1e-5
    bpy.ops.ed.undo_push(message="Clear")
    name = armature.name
    bpy.ops.ed.undo()
    armature = bpy.data.objects[name]
    assert corrections.corrected_frames(armature) == [6]
    give(armature, bpy.data.actions[pushed])
    assert corrections.corrected_frames(armature) == [8]
    push_down(armature.animation_data)
    assert corrections.corrected_frames(armature) == [8]


# Blender 4.2 tells nobody of what is appended.
@pytest.mark.parametrize("opened", ["file", "appended"][: 1 + hasattr(bpy.app.handlers, "blend_import_post")])
def test_corrections_of_files_of_earlier_versions_are_kept(armature, tmp_path, opened):
    """Those had the text on the armature, and on its actions a digest."""
    captured = all_keys(armature)
    correct(armature)
    action, text = armature.animation_data.action, corrections.corrections_text(armature)
    armature.manient.corrections = text
    (key,) = action[corrections.MARK].keys()
    action[corrections.MARK] = {key: hashlib.sha256(text.encode()).hexdigest()[:16]}
    gone = bpy.data.actions.new("corrected once")
    gone.use_fake_user = True
    gone[corrections.MARK] = {key: "0123456789abcdef"}
    give(armature, action)
    if opened == "file":
        armature = reopened(armature, tmp_path / "hand.blend")
        assert corrections.MARK not in bpy.data.actions["corrected once"]
    else:
        name, path = armature.manient.capture.name, str(tmp_path / "hand.blend")
        bpy.ops.wm.save_as_mainfile(filepath=path)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.append(directory=f"{path}/Collection/", filename=name)
        (armature,) = captured_hands(bpy.context.scene)
    assert corrections.corrections_text(armature) == text
    assert armature.manient.corrections == ""
    assert corrections.clear_corrections(armature) == 1
    assert same_rotations(all_keys(armature).quats, captured.quats) < 1e-5


def test_a_hand_that_is_removed_while_its_keys_are_written(armature):
    writing = corrections.replacing_poses(armature, [5, 6, 8], *moved_poses(armature, [5, 6, 8]))
    next(writing)
    armature.name = "My Hand"
    next(writing)
    bpy.data.objects.remove(armature)
    with pytest.raises(OptionError, match="the hand is gone"):
        list(writing)


@pytest.mark.parametrize("what", ["moved", "replaced"])
def test_keys_that_were_moved_or_replaced_are_left_alone(armature, what):
    correct(armature, 6, spread=4.0)
    correct(armature, 16, spread=0.0)
    keys = all_keys(armature)
    if what == "replaced":
        rows = (keys.frames > 3) & (keys.frames < 9)
        quats = np.tile([0.6, 0.8, 0.0, 0.0], (rows.sum(), 16, 1))
        write_pose_keys(rig_of(armature), PoseKeys.everywhere(keys.frames[rows], quats))
    else:
        for curve in curves_of(armature):
            for point in curve.keyframe_points:
                if point.co.x < 10:
                    point.co.x -= 2
            curve.update()
    before = all_keys(armature)
    assert corrections.displaced(armature) == [6]
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    after = all_keys(armature)
    stay = after.frames != 16
    np.testing.assert_array_equal(after.quats[stay], before.quats[stay])
    assert same_rotations(after.quats[~stay], before.quats[~stay]) > 0.1
    assert corrections.corrections_text(armature) == ""


def applied(armature, made, mode="ANIMATION", frame=1.0, **options) -> int:
    return apply_track(armature, made.take, made.take.hands[0], mode, frame, **options)


def changes(armature, made) -> list:
    """What writes keys."""
    return [
        lambda: correct(armature),
        lambda: refitted(armature, [5, 6]),
        lambda: applied(armature, made, "POSE", 8.0),
    ]


def refuses(operators: str) -> bool:
    return not any(getattr(bpy.ops.manient, operator).poll() for operator in operators.split())


def shown(armature, frames=(4, 8, 16)) -> np.ndarray:
    """What the bones show on frames, from wherever the motion is."""
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        found.append(displayed_pose(rig_of(armature)))
    return np.array(found)


def test_motion_in_the_nla_is_not_hidden_by_a_key(armature, made):
    before = shown(armature)
    push_down(armature.animation_data)
    assert "NLA" in (why_not_keyable(armature) or "")
    assert why_not_editable(armature) is None
    assert refuses("apply_pose refit_range edit_keypoints")
    with pytest.raises(RuntimeError, match="in the NLA"):
        bpy.ops.manient.apply_pose(pose="Relaxed")
    for change in changes(armature, made):
        with pytest.raises(OptionError, match="in the NLA"):
            change()
    assert armature.animation_data.action is None
    np.testing.assert_allclose(shown(armature), before, atol=1e-5)
    data = armature.animation_data
    data.nla_tracks[0].select = data.nla_tracks[0].strips[0].select = True
    data.nla_tracks.active = data.nla_tracks[0]
    data.use_tweak_mode = True
    assert "tweak mode" in (why_not_keyable(armature) or "")
    data.use_tweak_mode = False
    # A whole motion may lie over the strips.
    assert applied(armature, made) == 11
    assert why_not_keyable(armature) is None


def test_a_library_override_says_so(armature, tmp_path):
    correct(armature)
    collection = armature.manient.capture.name
    path = str(tmp_path / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.collections = [collection]
    linked = wanted.collections[0]
    bpy.context.scene.collection.children.link(linked)
    hand = captured_hands(bpy.context.scene)[0]
    assert "linked" in (why_not_editable(hand) or "")
    linked.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)
    hand = next(o for o in bpy.context.scene.objects if o.type == "ARMATURE" and o.override_library)
    bpy.context.view_layer.objects.active = hand
    assert "library override" in (why_not_editable(hand) or "")
    assert refuses("apply_pose lock_joints clear_corrections mirror_hand apply_take")
    assert "library override" in (why_not(bpy.context, hand_of(hand)) or "")
    assert bpy.ops.manient.save_pose_asset() == {"FINISHED"}
    with pytest.raises(OptionError, match="library override"):
        correct(hand)
    hand.manient.betas[0] += 1.0
    assert "library override" in (reshape.trouble(hand) or "")


def test_a_linked_action_says_so(armature, tmp_path):
    name, path = armature.animation_data.action.name, str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {armature.animation_data.action})
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.actions = [name]
    armature.animation_data.action = wanted.actions[0]
    assert "make the action local" in (why_not_keyable(armature) or "")
    assert refuses("apply_pose")


@pytest.mark.parametrize("what", ["curves", "group"])
def test_locked_channels_are_not_overwritten(armature, made, what):
    before, bone = read_pose_keys(rig_of(armature)), bone_names("right")[5]
    own = [curve for curve in curves_of(armature) if f'"{bone}"' in curve.data_path]
    for locked in own if what == "curves" else [own[0].group]:
        locked.lock = True
    bpy.context.scene.frame_set(6)
    with pytest.raises(RuntimeError, match=f"bone {bone} .* are locked"):
        bpy.ops.manient.apply_pose(pose="Relaxed")
    for change in changes(armature, made):
        with pytest.raises(OptionError, match=f"bone {bone} .* are locked"):
            change()
    after = all_keys(armature)
    np.testing.assert_array_equal(after.quats, before.quats)
    np.testing.assert_array_equal(after.locations, before.locations)
    assert corrections.corrections_text(armature) == ""
    # Its neighbours may be written.
    chosen = np.arange(16)[None] == 6
    keys = PoseKeys(np.array([6.0]), before.quats[:1], np.zeros((1, 3)), chosen, np.zeros(1, dtype=bool))
    write_pose_keys(rig_of(armature), keys)


def test_renamed_bones_are_one_sentence(armature, made):
    bone = bone_names("right")[8]
    armature.data.bones[bone].name = "pinky"
    assert refuses("apply_pose mirror_hand save_pose_asset apply_take refit_range")
    with pytest.raises(RuntimeError, match=f"lacks the bone {bone}"):
        bpy.ops.manient.apply_pose(pose="Relaxed")
    with pytest.raises(HandModelError, match=f"lacks the bone {bone}.*give its bones their names back"):
        applied(armature, made)
    # Those that only read, as exports, say so too.
    assert bone in (MANIENT_OT_export_hand.poll_reason(bpy.context) or "")


def test_linked_duplicates_do_not_move_each_other(armature):
    before = all_keys(armature)
    bpy.ops.object.duplicate(linked=True)
    twin = bpy.context.view_layer.objects.active
    assert twin.animation_data.action == armature.animation_data.action
    bpy.context.scene.frame_set(6)
    assert bpy.ops.manient.apply_pose(pose="Relaxed") == {"FINISHED"}
    np.testing.assert_array_equal(read_pose_keys(rig_of(armature)).quats, before.quats)
    assert same_rotations(read_pose_keys(rig_of(twin)).quats, before.quats) > 0.05


@pytest.mark.parametrize("what", ["ready pose", "take", "take between frames"])
def test_a_pose_beside_a_correction_outlives_it(armature, made, what):
    frame = 9.5 if "between" in what else 8.0
    captured = all_keys(armature)
    correct(armature, 6)
    wrist, stood = pose_on(armature, frame)
    if what == "ready pose":
        bpy.context.scene.frame_set(int(frame))
        assert bpy.ops.manient.apply_pose(pose="Relaxed") == {"FINISHED"}
    else:
        applied(armature, made, "POSE", frame, source_frame=16)
    pose, place = pose_on(armature, frame)
    if what == "ready pose":
        assert same_rotations(pose[0], wrist[0]) < 1e-5
        np.testing.assert_allclose(place, stood, atol=1e-6)
    corrections.clear_corrections(armature, [6])
    now, there = pose_on(armature, frame)
    assert same_rotations(now, pose) < 1e-5
    np.testing.assert_allclose(there, place, atol=1e-6)
    if what == "ready pose":  # it is a correction itself
        assert corrections.corrected_frames(armature) == [8]
        corrections.clear_corrections(armature)
    keys = all_keys(armature)
    same = np.isin(captured.frames, keys.frames) & ((captured.frames != frame) | (what == "ready pose"))
    again = np.isin(keys.frames, captured.frames[same])
    assert same_rotations(keys.quats[again], captured.quats[same]) < 1e-5
