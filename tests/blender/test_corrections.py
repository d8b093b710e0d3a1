"""Corrections live in the .blend, and leave keys as they found them."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient.common.blender_versions import channels
from blender_manient.rigs import rig_of
from blender_manient.scene import corrections
from blender_manient.scene.keys import PoseKeys, pose_at, read_pose_keys, write_pose_keys
from blender_manient.scene.store import hand_of
from handfit_core.edit.corrections import changed_quats, correction_between
from handfit_core.errors import OptionError

from .conftest import FRAMES, UNSEEN

pytestmark = pytest.mark.usefixtures("registered")

ROOT = Path(__file__).resolve().parents[2]
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
    assert corrections.corrected_frames(armature) == [6]
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
    assert armature.manient.corrections == ""


def test_clearing_one_leaves_the_other_as_if_it_had_been_alone(armature):
    correct(armature, 5, 6, size=0.3)
    alone = all_keys(armature)
    correct(armature, 8, 6, seed=2, size=0.3, pins={4: (1.0, 2.0)})
    # The other corrected frame keeps its pose.
    at = int(np.flatnonzero(SEEN == 5)[0])
    assert same_rotations(all_keys(armature).quats[at], alone.quats[at]) < 1e-5
    corrections.clear_corrections(armature, [8])
    after = all_keys(armature)
    assert same_rotations(after.quats, alone.quats) < 1e-5
    np.testing.assert_allclose(after.locations, alone.locations, atol=1e-5)
    assert corrections.corrected_frames(armature) == [5]


def test_what_was_done_by_hand_stays(armature):
    """A key that the artist turned under a correction keeps that turn when the correction goes."""
    correct(armature, 6, 6, size=0.3)
    here = np.array([8.0])
    now, _ = pose_at(rig_of(armature), here)
    turn = np.zeros((1, 16, 3))
    turn[0, 2] = [0.2, 0.0, 0.0]
    # The artist's turn comes first, the correction after it: so it is the bone's own before that.
    field_turn = corrections.corrections_of(armature).at(here)[0]
    base = changed_quats(now, field_turn, np.zeros_like(field_turn))
    by_hand = changed_quats(changed_quats(base, np.zeros_like(turn), turn), np.zeros_like(turn), field_turn)
    write_pose_keys(rig_of(armature), PoseKeys.everywhere(here, by_hand))
    corrections.clear_corrections(armature)
    after, _ = pose_at(rig_of(armature), here)
    np.testing.assert_allclose(correction_between(base[0], after[0]), turn[0], atol=1e-5)


def test_a_frame_without_keys_gets_them_and_loses_them_again(armature):
    before = all_keys(armature)
    assert 10 not in before.frames
    quats, location = correct(armature, 10, 0, size=0.3)
    assert 10 in all_keys(armature).frames
    found, place = pose_at(rig_of(armature), np.array([10.0]))
    assert same_rotations(found[0], quats) < 1e-5
    np.testing.assert_allclose(place[0], location, atol=1e-6)
    corrections.clear_corrections(armature, [10])
    after = all_keys(armature)
    np.testing.assert_array_equal(after.frames, before.frames)
    np.testing.assert_array_equal(after.quats, before.quats)


def test_a_key_that_says_something_else_too_stays(armature):
    correct(armature, 10, 0, size=0.3)
    other, place = moved_pose(armature, 10, seed=9)
    write_pose_keys(rig_of(armature), PoseKeys.everywhere(np.array([10.0]), other[None], place[None]))
    corrections.clear_corrections(armature)
    assert 10 in all_keys(armature).frames


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


def test_scene_frames_that_are_not_the_sources(armature):
    """A capture that lies elsewhere in the scene, at another speed."""
    capture = armature.manient.capture
    capture.manient.frame_offset, capture.manient.frame_scale = 100.0, 0.5
    keys = all_keys(armature)
    places = 100.0 + 0.5 * SEEN
    for place, quats, location in zip(places, keys.quats, keys.locations, strict=True):
        write_pose_keys(rig_of(armature), PoseKeys.everywhere(np.array([place]), quats[None], location[None]))
    before = read_pose_keys(rig_of(armature), 100.0)
    quats, location = moved_pose(armature, 103.0)
    corrections.correct_frames(armature, [6], quats[None], location[None], 3, pins=[{8: (1.0, 2.0)}])
    after = read_pose_keys(rig_of(armature), 100.0)
    moved = np.linalg.norm(after.locations - before.locations, axis=-1) > 1e-6
    np.testing.assert_array_equal(moved, (SEEN > 3) & (SEEN < 9))
    np.testing.assert_array_equal(read_pose_keys(rig_of(armature), 0.0, 50.0).quats, keys.quats)


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
    assert armature.manient.corrections == ""


def test_a_frame_keyed_anew_can_be_corrected_and_that_taken_back(armature):
    for frame in (4, 14):
        correct(armature, frame, 8, seed=frame, size=0.3)
    fitted = refitted(armature, [6, 8, 12])
    for frame in (6, 8):
        correct(armature, frame, 3, seed=frame + 50, size=0.3, pins={4: (1.0, 2.0)})
    found, _ = pose_at(rig_of(armature), np.array([6.0]))
    assert same_rotations(found[0], moved_pose(armature, 6, size=0.0)[0]) < 1e-5
    assert corrections.clear_corrections(armature, [6, 8]) == 2
    assert same_rotations(all_keys(armature).quats, fitted.quats) < 1e-5
    assert corrections.corrected_frames(armature) == [4, 14]


# Whose keys they are


def other_action(armature) -> bpy.types.Action:
    """The hand's action, and another one with other poses in its place."""
    first = armature.animation_data.action
    armature.animation_data.action = bpy.data.actions.new("Another")
    keys = PoseKeys.everywhere(SEEN.astype(float), np.tile([0.8, 0.6, 0.0, 0.0], (len(SEEN), 16, 1)))
    write_pose_keys(rig_of(armature), keys)
    return first


def give(armature, action) -> None:
    armature.animation_data.action = action
    if hasattr(action, "slots"):
        armature.animation_data.action_slot = action.slots[0]


def test_another_action_is_left_alone(armature, tmp_path):
    captured = all_keys(armature)
    bpy.context.view_layer.objects.active = armature
    correct(armature)
    first = other_action(armature)
    others = all_keys(armature)
    with pytest.raises(OptionError, match=f"in the action {first.name}"):
        corrections.clear_corrections(armature)
    with pytest.raises(OptionError, match="assign it again"):
        correct(armature, 8)
    with pytest.raises(OptionError, match="assign it again"):
        refitted(armature, [6, 8])
    with pytest.raises(RuntimeError, match="assign it again"):
        bpy.ops.manient.clear_corrections(scope="RANGE")
    np.testing.assert_array_equal(all_keys(armature).quats, others.quats)
    # The right one again, under another name, in a file that was saved.
    give(armature, first)
    first.name = "My Motion"
    path, name = str(tmp_path / "actions.blend"), armature.name
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    armature = bpy.data.objects[name]
    assert corrections.clear_corrections(armature) == 1
    assert same_rotations(all_keys(armature).quats, captured.quats) < 1e-5
    assert corrections.MARK not in armature.animation_data.action


def test_clear_all_in_another_action_only_forgets(armature):
    bpy.context.view_layer.objects.active = armature
    correct(armature)
    first = other_action(armature)
    others = all_keys(armature)
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    assert armature.manient.corrections == ""
    np.testing.assert_array_equal(all_keys(armature).quats, others.quats)
    # From here on it is a hand without corrections.
    correct(armature, 8)
    assert corrections.corrected_frames(armature) == [8]
    give(armature, first)
    assert corrections.why_elsewhere(armature) is not None


def test_an_earlier_copy_of_the_action_does_not_hold_later_corrections(armature):
    correct(armature)
    copy = armature.animation_data.action.copy()
    correct(armature, 14)
    give(armature, copy)
    assert corrections.why_elsewhere(armature) is not None


@pytest.mark.parametrize("linked", [True, False])
def test_duplicates_are_corrected_each_for_itself(armature, linked):
    captured = all_keys(armature)
    correct(armature)
    corrected = all_keys(armature)
    bpy.ops.object.select_all(action="DESELECT")
    armature.select_set(True)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.duplicate(linked=linked)
    twin = bpy.context.view_layer.objects.active
    assert (twin.animation_data.action == armature.animation_data.action) == linked
    corrections.clear_corrections(armature)
    assert same_rotations(all_keys(armature).quats, captured.quats) < 1e-5
    np.testing.assert_array_equal(all_keys(twin).quats, corrected.quats)
    assert corrections.clear_corrections(twin) == 1
    assert same_rotations(all_keys(twin).quats, captured.quats) < 1e-5
    assert same_rotations(all_keys(armature).quats, captured.quats) < 1e-5


def test_another_name_while_keys_are_written(armature):
    frames = [5, 6, 8]
    quats, locations = moved_poses(armature, frames)
    writing = corrections.replacing_poses(armature, frames, quats, locations)
    next(writing)
    armature.name = "My Hand"
    bpy.data.objects.new("right hand of photo of a hand", None)
    assert list(writing)[-1] == 1.0
    found, _ = pose_at(rig_of(armature), np.array(frames, dtype=float))
    assert same_rotations(found, quats) < 1e-5
    writing = corrections.replacing_poses(armature, frames, found, locations)
    next(writing)
    bpy.data.objects.remove(armature)
    with pytest.raises(OptionError, match="the hand is gone"):
        next(writing)


@pytest.mark.parametrize("what", ["moved", "replaced"])
def test_keys_that_were_moved_or_replaced_are_left_alone(armature, what):
    bpy.context.view_layer.objects.active = armature
    correct(armature, 6, spread=4.0)
    correct(armature, 16, spread=0.0)
    data = armature.animation_data
    holder = channels(data.action, getattr(data, "action_slot", None))
    keys = all_keys(armature)
    if what == "replaced":
        rows = (keys.frames > 3) & (keys.frames < 9)
        quats = np.tile([0.6, 0.8, 0.0, 0.0], (rows.sum(), 16, 1))
        write_pose_keys(rig_of(armature), PoseKeys.everywhere(keys.frames[rows], quats))
    else:
        for curve in holder.fcurves:
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
    assert armature.manient.corrections == ""


def test_a_touched_up_corrected_frame_is_still_known(armature):
    captured = all_keys(armature)
    correct(armature)
    armature.manient.betas = [2.0, -2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    armature.manient.betas = hand_of(armature).track.betas
    quats, location = moved_pose(armature, 6, size=0.0)
    quats[4] = [0.6, 0.8, 0.0, 0.0]
    write_pose_keys(rig_of(armature), PoseKeys.everywhere(np.array([6.0]), quats[None], location[None]))
    assert corrections.displaced(armature) == []
    corrections.clear_corrections(armature)
    others = np.delete(np.arange(16), 4)
    assert same_rotations(all_keys(armature).quats[:, others], captured.quats[:, others]) < 1e-4
