"""Refining through the real worker, on a capture of rendered pictures: pins, spread, locks, ranges, undo."""

from __future__ import annotations

import os
import re
import signal
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Matrix

import blender_manient
from blender_manient.common import preferences
from blender_manient.exporters.take import retaken
from blender_manient.operators.edit_keypoints import MANIENT_OT_edit_keypoints
from blender_manient.operators.grip import _near
from blender_manient.operators.modes.keypoints import KeypointMode
from blender_manient.operators.refit_range import replaced
from blender_manient.operators.touch import MANIENT_OT_press_together, MANIENT_OT_touch, touching_range
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import corrections
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import (
    PoseKeys,
    displayed_pose,
    read_pose_keys,
    remove_pose_keys,
    write_pose_keys,
)
from blender_manient.scene.own_keys import keyed_by_hand
from blender_manient.scene.store import hand_of
from blender_manient.session import shared_worker
from blender_manient.session.refiner import Refiner, why_not_smoothable
from handfit_core.common.skeleton import FINGER_JOINTS
from handfit_core.edit.corrections import changed_quats, correction_between
from handfit_core.take import Take
from handfit_core.worker.client import Worker
from tests.capturing import needs_capture
from tests.drawn import drawn
from tests.takes import seen_as
from tests.waiting import alive, pid_of, stopping, wait_for

from .conftest import READY, joint_heads
from .importing import imported, read_back
from .looking import select_bones

ROOT = Path(__file__).resolve().parents[2]
TIP = 8
"""The index fingertip"""
THUMB = 4
FIRST, LAST = 9, 16
"""Frames in which points are made to touch"""
TOUCH = {"scope": "CUSTOM", "first": FIRST, "last": LAST}
FRAME = 12
SPREAD = 4
FARTHER = np.array([25.0, -15.0])
"""pixels"""


pytestmark = needs_capture


@pytest.fixture(scope="module")
def take_file(tmp_path_factory) -> Path:
    """A capture of the rendered hand, 24 frames, with its detections."""
    path = tmp_path_factory.mktemp("captured") / "hand.take.npz"
    pictures = sorted(str(p) for p in (ROOT / "samples" / "rendered_hand").glob("*.jpg"))
    with stopping(Worker()) as worker:
        wait_for(worker, worker.submit("capture", input=pictures, output=str(path)), timeout=300)
    return path


@pytest.fixture(scope="module", autouse=True)
def addon():
    """Registered once: the worker stays warm from test to test."""
    blender_manient.register()
    yield
    blender_manient.unregister()


@pytest.fixture
def armature(take_file):
    built = build_take(Take.load(take_file))
    bpy.context.view_layer.objects.active = built.hands[0].armature
    bpy.context.scene.manient.spread = SPREAD
    bpy.context.scene.frame_set(FRAME)
    bpy.ops.ed.undo_push(message="Built")
    return built.hands[0].armature


def all_keys(armature) -> PoseKeys:
    return read_pose_keys(rig_of(armature))


def landmarks(armature, frame: int = FRAME) -> np.ndarray:
    refiner = Refiner(armature)
    return refiner.keyed_poses([refiner.row_at(frame)]).landmarks[0]


def drag(armature, keypoint: int = TIP, by=FARTHER, frame: int = FRAME) -> np.ndarray:
    place = landmarks(armature, frame)[keypoint] + by
    done = bpy.ops.manient.move_keypoint(
        hand=armature.name, frame=frame, keypoint=keypoint, x=place[0], y=place[1]
    )
    assert done == {"FINISHED"}
    return place


def turned(a: PoseKeys, b: PoseKeys) -> np.ndarray:
    """(N, 16) radians by which the keys differ."""
    return np.linalg.norm(correction_between(a.quats, b.quats), axis=-1)


def key_by_hand(armature, frame: int, joints, by: float) -> None:
    """Rotate bones and key them, as an artist does."""
    keys = all_keys(armature)
    here = keys.frames == frame
    moved = changed_quats(keys.quats[here], np.zeros((1, 16, 3)), np.full((1, 16, 3), by))
    keyed = np.isin(np.arange(16), joints)[None]
    one = PoseKeys(keys.frames[here], moved, keys.locations[here], keyed, np.zeros(1, dtype=bool))
    write_pose_keys(rig_of(armature), one)


def test_a_pin_lands_where_it_was_put(armature):
    before = landmarks(armature)
    place = drag(armature)
    after = landmarks(armature)
    assert np.linalg.norm(after[TIP] - place) < 1.0
    # Other fingers stay.
    others = [k for k in range(21) if k not in (5, 6, 7, 8)]
    assert np.linalg.norm(after - before, axis=-1)[others].max() < 2.0
    # The bones stand there already.
    np.testing.assert_allclose(Refiner(armature).shown_landmarks(), after, atol=0.05)


def test_two_pins_hold_and_their_removal_leads_all_the_way_back(armature):
    before = all_keys(armature)
    first = drag(armature)
    one = all_keys(armature)
    second = drag(armature, keypoint=THUMB, by=np.array([-10.0, 12.0]))
    there = landmarks(armature)
    assert np.linalg.norm(there[TIP] - first) < 1.5
    assert np.linalg.norm(there[THUMB] - second) < 1.5
    assert bpy.ops.manient.move_keypoint(frame=FRAME, keypoint=THUMB, remove=True) == {"FINISHED"}
    assert turned(all_keys(armature), one).max() < 1e-4
    assert bpy.ops.manient.move_keypoint(frame=FRAME, keypoint=TIP, remove=True) == {"FINISHED"}
    assert turned(before, all_keys(armature)).max() < 1e-5
    assert corrections.corrections_text(armature) == ""
    for keypoint, place in ((THUMB, second), (TIP, first)):
        bpy.ops.manient.move_keypoint(frame=FRAME, keypoint=keypoint, x=place[0], y=place[1])
    np.testing.assert_allclose(landmarks(armature), there, atol=0.05)


def test_a_second_corrected_frame_starts_from_what_the_first_did_to_it(armature):
    """The hand must not fall back when another point of a neighbouring frame is moved."""
    drag(armature)
    inherited = landmarks(armature, FRAME + 2)
    for _ in range(2):
        drag(armature, keypoint=20, by=np.array([3.0, 0.0]), frame=FRAME + 2)
        np.testing.assert_allclose(landmarks(armature, FRAME + 2)[TIP], inherited[TIP], atol=0.5)


def test_locked_joints_stay(armature):
    before = all_keys(armature)
    select_bones(armature, [])
    with pytest.raises(RuntimeError, match="No bone"):
        bpy.ops.manient.lock_joints()
    select_bones(armature, [bone_names(armature.manient.side)[5]])
    for joints, locked in (("SELECTED", [5]), ("INDEX", list(FINGER_JOINTS["index"]))):
        assert bpy.ops.manient.lock_joints(joints=joints) == {"FINISHED"}
        assert [j for j, on in enumerate(armature.manient.locked) if on] == sorted({5, *locked})
    assert bpy.ops.manient.lock_joints(joints="SELECTED", lock=False) == {"FINISHED"}
    locked = [j for j, on in enumerate(armature.manient.locked) if on]
    drag(armature)
    moved = turned(before, all_keys(armature))
    assert moved[:, locked].max() < 1e-5
    assert moved[before.frames == FRAME].max() > 1e-3
    assert bpy.ops.manient.lock_joints(joints="ALL", lock=False) == {"FINISHED"}
    assert not any(armature.manient.locked)


def test_fitting_a_range_again(armature):
    """It replaces keys by hand, and says so before; after it there is nothing of the artist's but the pin."""
    place = drag(armature, by=0.5 * FARTHER)
    key_by_hand(armature, 14, range(16), 0.2)
    assert "Replaces 16 keys set by hand, on 1 frame" in replaced(bpy.context, 9, 15)[0]
    before = all_keys(armature)
    assert bpy.ops.manient.refit_range(scope="CUSTOM", first=9, last=15) == {"FINISHED"}
    after = all_keys(armature)
    np.testing.assert_array_equal(after.frames, before.frames)
    inside = (before.frames >= 9) & (before.frames <= 15)
    np.testing.assert_array_equal(after.quats[~inside], before.quats[~inside])
    np.testing.assert_array_equal(after.locations[~inside], before.locations[~inside])
    assert turned(before, after)[before.frames == 14].max() > 0.1
    assert "Replaces no key set by hand" in replaced(bpy.context, 9, 15)[0]
    # The pin still holds, and is all that is left of the correction.
    assert np.linalg.norm(landmarks(armature)[TIP] - place) < 6.0
    field = corrections.corrections_of(armature)
    assert set(field.pins(FRAME)) == {TIP}
    assert not field.at(np.array([FRAME]))[0].any()


def smooth(strength: float, **others) -> None:
    assert bpy.ops.manient.smooth_motion(strength=strength, **others) == {"FINISHED"}


def jerk(keys: PoseKeys) -> float:
    """How much rotations change from key to key, beyond going on as before; radians."""
    turns = correction_between(keys.quats[:-1], keys.quats[1:])
    return float(np.linalg.norm(np.diff(turns, axis=0), axis=-1).mean())


def test_smoothing_afterwards(armature):
    captured = all_keys(armature)
    found, fitted = {}, {}
    for strength in (0.0, 3.0, 0.0):
        smooth(strength)
        if strength in found:  # what comes out does not depend on what was smoothed before
            np.testing.assert_allclose(all_keys(armature).quats, found[strength].quats, atol=1e-5)
            continue
        found[strength] = all_keys(armature)
        assert armature.manient.smoothing == bpy.context.window_manager.manient_smoothing == strength
        assert bpy.ops.manient.refit_range() == {"FINISHED"}
        fitted[strength] = jerk(all_keys(armature))
    assert jerk(found[3.0]) < jerk(captured) < jerk(found[0.0])
    assert fitted[3.0] < fitted[0.0], "a range is fitted as smoothly as the hand is"
    assert not keyed_by_hand(hand_of(armature), np.arange(24)).any()
    smooth(1.0)
    assert np.degrees(np.median(turned(captured, all_keys(armature)))) < 1.0
    smooth(3.0, scope="CUSTOM", first=8, last=16)
    by = turned(captured, all_keys(armature)).mean(axis=1)
    assert by[[7, 15]].max() < 0.5 * by[9:14].max(), "it leads to what is around"
    assert np.degrees(np.delete(by, range(7, 16)).max()) < 1.0


def test_smoothing_leaves_what_the_artist_did(armature):
    drag(armature)
    key_by_hand(armature, 18, [5], 0.3)
    before, tip = all_keys(armature), landmarks(armature)[TIP]
    smooth(3.0)
    after = all_keys(armature)
    at, here = before.frames == FRAME, before.frames == 18
    np.testing.assert_array_equal(after.quats[at], before.quats[at])
    np.testing.assert_array_equal(after.locations[at], before.locations[at])
    np.testing.assert_array_equal(after.quats[here, 5], before.quats[here, 5])
    assert (turned(before, after)[here] > 1e-5).sum() >= 10, "the other bones of that frame are smoothed"
    assert set(np.flatnonzero(keyed_by_hand(hand_of(armature), np.arange(24)).any(axis=1))) == {17}
    assert jerk(after) < 1.2 * jerk(before), "keys next to both lead there"
    np.testing.assert_allclose(landmarks(armature)[TIP], tip, atol=1e-6)
    assert set(corrections.corrections_of(armature).pins(FRAME)) == {TIP}
    bpy.ops.manient.clear_corrections(scope="ALL")
    assert np.linalg.norm(landmarks(armature)[TIP] - tip) > 10, "what is left is the smoothed motion"
    assert jerk(all_keys(armature)) < jerk(before)


@pytest.mark.parametrize("what", ["smooth", "touch"])
def test_it_is_one_step(armature, what):
    before, name = all_keys(armature), armature.name
    touch() if what == "touch" else smooth(3.0)
    assert turned(before, all_keys(armature)).max() > 1e-3
    bpy.ops.ed.undo_push(message=what)
    bpy.ops.ed.undo()
    np.testing.assert_array_equal(all_keys(bpy.data.objects[name]).quats, before.quats)
    assert bpy.context.window_manager.manient_smoothing == 1.0
    assert corrections.corrections_text(bpy.data.objects[name]) == ""


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("mirrored", "a mirrored hand"),
        ("added", "added by hand"),
        ("other program", "poses are those of HaMeR"),
    ],
)
def test_hands_without_keypoints_say_why_they_are_not_smoothed(armature, what, said):
    hand = hand_of(armature)
    assert why_not_smoothable(hand) is None
    nothing = np.zeros(len(hand.track.detected), dtype=bool)
    if what == "other program":
        hand = replace(hand, take=replace(hand.take, solver="HaMeR"))
    else:
        placed = None if what == "mirrored" else np.full((len(nothing), 21, 2), np.nan)
        hand = replace(hand, track=seen_as(replace(hand.track, placed=placed), detected=nothing))
    assert said in why_not_smoothable(hand)


def test_a_point_dragged_in_a_relaxed_frame_starts_from_there_and_goes_back_to_it(armature):
    assert bpy.ops.manient.apply_pose(pose="Relaxed") == {"FINISHED"}
    relaxed = all_keys(armature)
    ring = landmarks(armature)[16]
    drag(armature, by=0.5 * FARTHER)
    assert np.linalg.norm(landmarks(armature)[16] - ring) < 4.0, "the other fingers stay relaxed"
    assert bpy.ops.manient.move_keypoint(frame=FRAME, keypoint=TIP, remove=True) == {"FINISHED"}
    assert turned(all_keys(armature), relaxed).max() < 1e-4
    assert corrections.corrected_frames(armature) == [FRAME]


def gap(armature, first: int = FIRST, last: int = LAST) -> np.ndarray:
    """Metres between the skins of thumb and index tips, in these frames."""
    refiner = Refiner(armature)
    rows = [refiner.row_at(frame) for frame in range(first, last + 1)]
    return refiner.gaps(refiner.keyed_poses(rows), [{TIP: THUMB}] * len(rows))


def touch() -> None:
    assert bpy.ops.manient.touch(point=str(THUMB), other=str(TIP), **TOUCH) == {"FINISHED"}


def test_points_are_made_to_touch_over_a_range_and_let_go_again(armature):
    before = all_keys(armature)
    assert gap(armature).max() > 0.005
    touch()
    after = all_keys(armature)
    assert np.abs(gap(armature)).max() < 0.001
    # It fades out over Spread; other fingers and the wrist never move.
    moved = turned(before, after)
    reach = (before.frames > FIRST - SPREAD) & (before.frames < LAST + SPREAD)
    assert moved[~reach].max() == 0.0
    both = [*FINGER_JOINTS["thumb"], *FINGER_JOINTS["index"]]
    assert np.delete(moved, both, axis=1).max() < 1e-5
    assert moved[(before.frames > FIRST - SPREAD) & (before.frames < FIRST)].max(axis=1).min() > 1e-3
    # No pop: no step is larger than the whole correction fading out over Spread makes it.
    steps = np.abs(np.diff(moved, axis=0))
    assert steps.max() < 1.5 * moved.max() / SPREAD
    assert corrections.corrected_frames(armature) == list(range(FIRST, LAST + 1))
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    assert turned(before, all_keys(armature)).max() < 1e-5
    assert corrections.corrections_text(armature) == ""


def test_touching_points_are_kept_by_drags_ranges_files_and_takes(armature, tmp_path):
    touch()
    place = drag(armature, by=0.5 * FARTHER)
    assert np.linalg.norm(landmarks(armature)[TIP] - place) < 1.5
    assert np.abs(gap(armature)).max() < 0.001, "the thumb follows the index finger"
    assert bpy.ops.manient.move_keypoint(frame=FRAME, keypoint=TIP, remove=True) == {"FINISHED"}
    assert np.abs(gap(armature)).max() < 0.001, "without the pin they still touch"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "touch.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "touch.blend"))
    armature = next(obj for obj in bpy.data.objects if obj.manient.is_hand)
    bpy.context.view_layer.objects.active = armature
    assert corrections.corrections_of(armature).touching(FRAME) == {TIP: THUMB}
    assert bpy.ops.manient.refit_range(scope="CUSTOM", first=FIRST, last=LAST) == {"FINISHED"}
    assert np.abs(gap(armature)).max() < 0.001
    assert corrections.corrections_of(armature).touching(FRAME) == {TIP: THUMB}
    retaken([hand_of(armature)]).save(tmp_path / "hand.take.npz")
    again = build_take(Take.load(tmp_path / "hand.take.npz")).hands[0].armature
    assert corrections.corrections_of(again).touching(FRAME) == {TIP: THUMB}


def test_what_lies_over_each_other_is_pressed_together_and_let_go_again(armature):
    refiner, before = Refiner(armature), all_keys(armature)
    rows = [refiner.row_at(frame) for frame in range(FIRST, LAST + 1)]
    poses = refiner.keyed_poses(rows)
    crossing = refiner.lying_over(poses)
    crossed = np.array([bool(of_row) for of_row in crossing])
    assert 2 < crossed.sum() < len(rows)
    assert np.nanmax(refiner.gaps(poses, crossing)) > 0.002
    dialog = drawn(MANIENT_OT_press_together, scope="CUSTOM", first=FIRST, last=LAST)
    assert re.search(r"Thumb,Index,\w*,?\w*andPalmare\d", dialog.said.replace(" ", ""))
    assert bpy.ops.manient.press_together(**TOUCH) == {"FINISHED"}
    after = refiner.keyed_poses(rows)
    assert np.nanmax(np.abs(refiner.gaps(after, crossing))) < 0.001
    moved = np.linalg.norm(after.landmarks - poses.landmarks, axis=-1).max(axis=1)
    moved /= np.ptp(poses.landmarks, axis=1).max(axis=1)
    assert np.median(moved) < 0.01
    assert moved.max() < 0.06, "they stay where the picture has them, but for wide gaps"
    assert corrections.corrected_frames(armature) == np.arange(FIRST, LAST + 1)[crossed].tolist()
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    assert turned(before, all_keys(armature)).max() < 1e-5


def test_the_frames_in_which_points_are_near_are_suggested(armature):
    first, last = touching_range(bpy.context, TIP, THUMB)
    refiner = Refiner(armature)
    near = gap(armature, first, last)
    here = gap(armature, FRAME, FRAME)[0]
    assert first <= FRAME <= last
    assert near.max() <= here + 0.005
    beyond = [frame for frame in (first - 1, last + 1) if refiner.row_at(frame) is not None]
    assert all(gap(armature, frame, frame)[0] > here + 0.005 for frame in beyond)
    dialog = drawn(MANIENT_OT_touch, point="4", other="8", scope="CUSTOM", first=first, last=last)
    assert "mmapartthere" in dialog.said.replace(" ", "")


BALL = 0.02
"""metres: the radius of what the hand grips"""


@pytest.fixture
def ball(armature):
    """A ball into which the index fingertip sinks on one frame."""
    mesh, shape = bpy.data.meshes.new("ball"), bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=4, radius=1.0)
    shape.to_mesh(mesh)
    shape.free()
    ball = bpy.data.objects.new("ball", mesh)
    bpy.context.scene.collection.objects.link(ball)
    tip = armature.pose.bones[rig_of(armature).bones[3]]
    ball.location = armature.matrix_world @ (tip.tail + 0.7 * BALL * tip.z_axis)
    ball.scale = (BALL, BALL, -BALL)
    bpy.context.view_layer.update()
    return ball


def gaps_to(ball, armature) -> np.ndarray:
    """Metres from the ball of the hand's vertices, as they are shown."""
    shown = hand_of(armature).meshes[0].evaluated_get(bpy.context.evaluated_depsgraph_get())
    places = np.empty(3 * len(shown.data.vertices))
    shown.data.vertices.foreach_get("co", places)
    world = np.array(shown.matrix_world)
    places = places.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]
    return np.linalg.norm(places - np.array(ball.matrix_world.translation), axis=1) - BALL


def test_fingers_are_laid_on_an_object_and_let_go_again(armature, ball):
    before = all_keys(armature)
    assert gaps_to(ball, armature).min() < -0.004
    assert bpy.ops.manient.grip(prop="ball", **TOUCH) == {"FINISHED"}
    bpy.context.scene.frame_set(FRAME)
    assert -0.001 < gaps_to(ball, armature).min() < 0.002
    moved = turned(before, all_keys(armature))
    reach = (before.frames > FIRST - SPREAD) & (before.frames < LAST + SPREAD)
    assert moved[~reach].max() == 0.0
    assert moved[before.frames == FRAME, FINGER_JOINTS["index"][0]] > 1e-3
    assert set(corrections.corrected_frames(armature)) <= set(range(FIRST, LAST + 1))
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    assert turned(before, all_keys(armature)).max() < 1e-5


def key_values(owner, path: str, **values: float) -> None:
    """Key a number on frames, given as f12=0.5."""
    for frame, value in values.items():
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=int(frame[1:]))


@pytest.mark.parametrize("by", ["shape key", "modifier"])
def test_an_object_that_changes_its_shape_is_followed(armature, ball, by):
    """It grows: that is seen on each frame."""
    if by == "shape key":
        ball.shape_key_add(name="Basis")
        grown = ball.shape_key_add(name="grown")
        for point, vertex in zip(grown.data, ball.data.vertices, strict=True):
            point.co = 1.1 * vertex.co
        key_values(grown, "value", f11=0.0, f12=1.0)
    else:
        grown = ball.modifiers.new("grown", "DISPLACE")
        grown.mid_level = 0.0
        key_values(grown, "strength", f11=0.0, f12=0.1)
    assert bpy.ops.manient.grip(prop="ball", **TOUCH) == {"FINISHED"}
    bpy.context.scene.frame_set(FRAME)
    assert -0.001 < gaps_to(ball, armature).min() - 0.1 * BALL < 0.002


def world_of(prop, frame: float) -> np.ndarray:
    bpy.context.scene.frame_set(int(frame), subframe=frame % 1)
    return np.array(prop.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world)


def test_an_object_rides_with_the_hand_and_stays_where_it_leaves_it(armature, ball, tmp_path, capfd):
    """Between first and last frame it keeps its place in the hand, and jumps at neither end."""
    start = world_of(ball, FRAME)
    wrist = armature.pose.bones[rig_of(armature).bones[0]]
    for _ in range(2):  # The second time it rides already.
        assert bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH) == {"FINISHED"}
        assert len(ball.constraints) == 1
        np.testing.assert_allclose(world_of(ball, FRAME), start, atol=2e-3)
        in_hand = []
        for frame in range(FIRST, LAST + 1):
            place = world_of(ball, frame)
            in_hand.append(np.linalg.inv(np.array(armature.matrix_world @ wrist.matrix)) @ place)
        assert np.ptp(in_hand, axis=0).max() < 1e-5
        taken = world_of(ball, FIRST)
        for frame in (1, FIRST - 1, FIRST - 0.01, FIRST + 0.01):
            np.testing.assert_allclose(world_of(ball, frame), taken, atol=1e-4)
        left = world_of(ball, LAST)
        assert np.abs(left - taken).max() > 0.003
        np.testing.assert_allclose(world_of(ball, LAST - 0.01), left, atol=1e-4)
        for frame in (LAST + 0.5, LAST + 1, LAST + 5):
            np.testing.assert_allclose(world_of(ball, frame), left, atol=1e-5)
        bpy.context.scene.frame_set(FRAME)
    assert bpy.ops.manient.export_hand(filepath=str(tmp_path / "a.glb"), file_format="glb") == {"FINISHED"}
    assert "without ball: only hands are exported" in capfd.readouterr().out
    key_before = all_keys(armature)
    with pytest.raises(RuntimeError, match="rides with this hand in a part of the range"):
        bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH | {"last": LAST + 3})
    np.testing.assert_array_equal(all_keys(armature).quats, key_before.quats)


def test_an_object_that_rides_is_moved_into_the_palm_and_gripped_again(armature, ball):
    """The wrist gives way without it, and it keeps its new place in the hand, the last frame included."""
    assert bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH) == {"FINISHED"}
    bpy.context.scene.frame_set(FIRST)
    rig = rig_of(armature)
    wrist, knuckle = (armature.pose.bones[rig.bones[joint]] for joint in (0, 4))
    palm = 0.4 * wrist.head + 0.6 * knuckle.head + 2.0 * BALL * knuckle.z_axis
    ball.location = armature.matrix_world @ palm
    ball.keyframe_insert("location", frame=FIRST)
    taken = world_of(ball, FIRST)
    assert gaps_to(ball, armature).min() < -0.004
    assert bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH) == {"FINISHED"}
    np.testing.assert_allclose(world_of(ball, FIRST), taken, atol=1e-6)
    places = np.array([place_on(ball, armature, frame) for frame in range(FIRST, LAST + 1)])
    assert np.ptp(places, axis=0).max() * BALL < 1e-5
    for frame in (FIRST, FRAME, LAST):
        world_of(ball, frame)
        assert gaps_to(ball, armature).min() > -0.002


def place_on(prop, armature, frame: float) -> np.ndarray:
    """The wrist's matrix (4, 4) as the prop sees it."""
    world = world_of(prop, frame)
    wrist = armature.pose.bones[rig_of(armature).bones[0]]
    return np.linalg.inv(world) @ np.array(armature.matrix_world @ wrist.matrix)


def test_a_hand_rides_with_an_object_that_moves(armature, ball):
    """It keeps its place on it through more than half a turn, fades out without a jump, and is let go."""
    before, wrist = all_keys(armature), armature.pose.bones[rig_of(armature).bones[0]]
    turn = Matrix.Rotation(0.4, 4, "X")
    armature.matrix_world, ball.location = turn @ armature.matrix_world, turn @ ball.location
    start = tuple(ball.location)
    for frame, by in ((FIRST - 2, -0.5), (FRAME, 0.0), (LAST + 2, 0.7)):
        ball.location, ball.rotation_euler.z = start + np.array([0.2 * by, 0.0, 0.1 * by]), 6.0 * by
        for path in ("location", "rotation_euler"):
            ball.keyframe_insert(path, frame=frame)
    bpy.context.scene.frame_set(FRAME)
    assert bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH) == {"FINISHED"}
    assert not ball.constraints
    on_ball = np.array([place_on(ball, armature, frame) for frame in np.arange(FIRST, LAST + 0.1, 0.5)])
    assert np.ptp(on_ball[::2], axis=0)[:3, 3].max() * BALL < 1e-5
    assert np.ptp(on_ball[::2], axis=0)[:3, :3].max() * BALL < 1e-5
    assert np.ptp(on_ball, axis=0)[:3, 3].max() * BALL < 0.015
    for frame in (FIRST, FRAME, LAST):
        bpy.context.scene.frame_set(frame)
        assert -0.001 < gaps_to(ball, armature).min() < 0.002
    heads = []
    for frame in range(FIRST - SPREAD, LAST + SPREAD + 1):
        bpy.context.scene.frame_set(frame)
        heads.append(np.array(armature.matrix_world @ wrist.head))
    steps = np.linalg.norm(np.diff(heads, axis=0), axis=1)
    for fading in (steps[:SPREAD], steps[-SPREAD:]):
        assert fading.max() < 0.5 * fading.sum()
    moved = turned(before, all_keys(armature))
    assert moved[(before.frames <= FIRST - SPREAD) | (before.frames >= LAST + SPREAD)].max() == 0.0
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    assert turned(before, all_keys(armature)).max() < 1e-5


def test_a_second_hand_rides_with_what_the_first_one_carries(armature, ball, take_file):
    """The second one stands on the other side of it, and goes along; the constraint stays one."""
    assert bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH) == {"FINISHED"}
    bpy.context.scene.frame_set(FRAME)
    middle = Matrix.Translation(ball.matrix_world.translation)
    other = build_take(Take.load(take_file)).hands[0].armature
    other.matrix_world = middle @ Matrix.Rotation(np.pi, 4, "Z") @ middle.inverted() @ other.matrix_world
    bpy.context.view_layer.objects.active = other
    bpy.context.view_layer.update()
    first = all_keys(armature)
    assert bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH) == {"FINISHED"}
    assert [child.target for child in ball.constraints] == [armature]
    np.testing.assert_array_equal(all_keys(armature).quats, first.quats)
    places = np.array([place_on(ball, other, frame) for frame in range(FIRST, LAST + 1)])
    assert np.ptp(places, axis=0).max() * BALL < 1e-5
    for frame in (FIRST, FRAME, LAST):
        world_of(ball, frame)
        for hand in (armature, other):
            assert -0.001 < gaps_to(ball, hand).min() < 0.002


@pytest.mark.parametrize("fmt", ["fbx", "glb"])
def test_a_hand_that_holds_something_is_exported_as_it_is_shown(armature, ball, tmp_path, fmt):
    assert bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH) == {"FINISHED"}
    expected = {}
    for frame in (FIRST, FRAME, LAST):
        bpy.context.scene.frame_set(frame)
        expected[frame] = joint_heads(armature, "right")
    path = str(tmp_path / f"a.{fmt}")
    assert bpy.ops.manient.export_hand(filepath=path, file_format=fmt) == {"FINISHED"}
    scene = bpy.context.scene
    read_back(Path(path), first=scene.frame_start, fps=scene.render.fps)
    for frame, heads in expected.items():
        bpy.context.scene.frame_set(frame)
        np.testing.assert_allclose(joint_heads(imported("right"), "right"), heads, atol=5e-4)


def test_half_the_strength_goes_half_the_way(armature, ball):
    before = all_keys(armature)
    moved = []
    for strength in (1.0, 0.5):
        assert bpy.ops.manient.grip(prop="ball", strength=strength, **TOUCH) == {"FINISHED"}
        moved.append(turned(before, all_keys(armature))[before.frames == FRAME])
        assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    np.testing.assert_allclose(moved[1], 0.5 * moved[0], atol=1e-4)


def test_near_fingers_are_ticked(armature, ball):
    own, tip = hand_of(armature), armature.pose.bones[rig_of(armature).bones[3]]
    ball.location = armature.matrix_world @ (tip.tail + 1.5 * BALL * tip.y_axis)
    bpy.context.view_layer.update()
    assert (_near(own, ball)[1], _near(own, ball)[4]) == (True, False)
    armature.scale = (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    assert len(_near(own, ball)) == 5
    armature.scale = (1.0, 1.0, 1.0)
    ball.location.z += 1.0
    bpy.context.view_layer.update()
    assert _near(own, ball) == [True] * 5
    ball.scale = (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    assert _near(own, ball) == [True] * 5
    ball.data.clear_geometry()
    bpy.context.view_layer.update()
    assert _near(own, ball) == [True] * 5
    assert _near(own, None) == [True] * 5


def into_another_scene(ball) -> None:
    bpy.context.scene.collection.objects.unlink(ball)
    bpy.data.scenes.new("elsewhere").collection.objects.link(ball)


@pytest.mark.parametrize(
    ("spoil", "fields", "said"),
    [
        (None, {"first": LAST, "last": FIRST}, "runs backwards"),
        (None, {"first": 90, "last": 95}, "none of the frames"),
        (None, {"prop": "right hand of hand"}, "has no surface"),
        (lambda ball: setattr(ball.location, "z", 1.0), {}, "no finger comes near 'ball'"),
        (lambda ball: setattr(ball, "scale", (0.0, 0.0, 0.0)), {}, "has no faces"),
        (lambda ball: setattr(ball, "scale", (1e5, 1e5, 1e5)), {}, "no finger comes near 'ball'"),
        (lambda _: setattr(bpy.context.object, "scale", (0.0, 0.0, 0.0)), {}, "the hand is scaled to zero"),
        (lambda ball: ball.data.clear_geometry(), {}, "has no faces"),
        (lambda ball: setattr(ball, "hide_viewport", True), {}, "'ball' is hidden"),
        (into_another_scene, {}, "choose an object of this scene"),
        (lambda ball: bpy.data.objects.remove(ball), {}, "choose an object of this scene"),
    ],
)
@pytest.mark.parametrize("together", [None, "still", "moving"])
def test_what_cannot_be_gripped_says_so(armature, ball, spoil, fields, said, together):
    before = all_keys(armature)
    if together == "moving":
        for frame in (FIRST, LAST):
            ball.delta_location.x = 1e-4 * frame
            ball.keyframe_insert("delta_location", frame=frame)
    if spoil is not None:
        spoil(ball)
    with pytest.raises(RuntimeError, match=said):
        bpy.ops.manient.grip(**{"prop": "ball", "rides": bool(together)} | TOUCH | fields)
    assert corrections.corrections_text(armature) == ""
    np.testing.assert_array_equal(all_keys(armature).quats, before.quats)
    assert bpy.context.scene.frame_current == FRAME
    assert not any(prop.constraints for prop in bpy.data.objects if prop.name == "ball")


def test_an_object_is_deleted_after(armature, ball):
    before = all_keys(armature)
    assert bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH) == {"FINISHED"}
    bpy.data.objects.remove(ball)
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    assert turned(before, all_keys(armature)).max() < 1e-5


def linked(ball, path: Path):
    """Return the ball linked from a file."""
    bpy.data.libraries.write(str(path), {ball})
    bpy.data.objects.remove(ball)
    with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.objects = ["ball"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    return wanted.objects[0]


def test_a_linked_object_is_gripped_and_rides_as_an_override(armature, ball, tmp_path):
    ball = linked(ball, tmp_path / "props.blend")
    with pytest.raises(RuntimeError, match="'ball' or its action is linked and cannot ride"):
        bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH)
    assert corrections.corrections_text(armature) == ""
    assert bpy.ops.manient.grip(prop="ball", **TOUCH) == {"FINISHED"}
    bpy.context.scene.collection.objects.unlink(ball)
    own = ball.override_create()
    bpy.context.scene.collection.objects.link(own)
    bpy.context.scene.frame_set(FRAME)
    assert bpy.ops.manient.grip(prop=own.name, rides=True, **TOUCH) == {"FINISHED"}
    places = np.array([place_on(own, armature, frame) for frame in range(FIRST, LAST + 1)])
    assert np.ptp(places, axis=0).max() * BALL < 1e-5


def test_a_hand_rides_with_a_linked_object_that_moves(armature, ball, tmp_path):
    for frame in (FIRST, LAST):
        ball.delta_location.x = 0.01 * (frame - FRAME)
        ball.keyframe_insert("delta_location", frame=frame)
    ball = linked(ball, tmp_path / "props.blend")
    armature.manient.locked[0] = True
    with pytest.raises(RuntimeError, match="the wrist is locked"):
        bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH)
    armature.manient.locked[0] = False
    assert bpy.ops.manient.grip(prop="ball", rides=True, **TOUCH) == {"FINISHED"}
    places = np.array([place_on(ball, armature, frame) for frame in range(FIRST, LAST + 1)])
    assert np.ptp(places, axis=0).max() * BALL < 1e-5


def test_frames_without_keys_are_gripped_too(armature, ball):
    remove_pose_keys(rig_of(armature), FIRST - 2, np.inf)
    assert bpy.ops.manient.grip(prop="ball", **TOUCH) == {"FINISHED"}
    assert len(corrections.corrected_frames(armature)) == LAST - FIRST + 1
    assert -0.001 < gaps_to(ball, armature).min() < 0.002


def test_a_hand_without_keys_grips_nothing(armature, ball):
    armature.animation_data_clear()
    with pytest.raises(RuntimeError, match="keys"):
        bpy.ops.manient.grip(prop="ball", **TOUCH)
    assert corrections.corrections_text(armature) == ""


@pytest.mark.parametrize(
    ("operator", "fields", "said"),
    [
        ("touch", TOUCH | {"point": "8", "other": "6"}, "choose points of two fingers, or of a finger and"),
        ("touch", TOUCH | {"point": "8", "other": "8"}, "choose points of two fingers, or of a finger and"),
        ("press_together", TOUCH | {"first": 1, "last": 5}, "nothing lies over each other in these frames"),
        ("press_together", {"scope": "CUSTOM", "first": 90, "last": 95}, "90 to 95 was captured"),
        ("refit_range", {"scope": "CUSTOM", "first": 100, "last": 120}, r"100 to 120 was captured.*1 to 24"),
        ("move_keypoint", {"frame": 99, "keypoint": TIP, "x": 1, "y": 1}, "frame 99 was not captured"),
        ("move_keypoint", {"frame": FRAME, "keypoint": TIP, "remove": True}, "no pin"),
        ("move_keypoint", {"hand": "nobody", "keypoint": TIP}, "no captured hand 'nobody'"),
        ("edit_keypoints", {}, "move_keypoint"),
    ],
)
def test_what_cannot_be_done_says_so(armature, operator, fields, said):
    with pytest.raises(RuntimeError, match=said):
        getattr(bpy.ops.manient, operator)(**fields)
    assert corrections.corrections_text(armature) == ""
    assert MANIENT_OT_edit_keypoints.current is None


def test_a_worker_that_dies_changes_nothing_and_the_next_one_works(armature, peer):
    before = all_keys(armature)
    preferences.get().python = peer(f"{READY}sys.stdin.readline(); sys.exit(3)")
    place = landmarks(armature)[TIP] + FARTHER
    try:
        with pytest.raises(RuntimeError, match="capturing process ended unexpectedly") as caught:
            bpy.ops.manient.move_keypoint(frame=FRAME, keypoint=TIP, x=place[0], y=place[1])
    finally:
        preferences.get().python = ""
    assert "Traceback" not in str(caught.value)
    np.testing.assert_array_equal(all_keys(armature).quats, before.quats)
    assert corrections.corrections_text(armature) == ""
    drag(armature)
    # One that dies between two moves is not even noticed.
    os.kill(pid_of(shared_worker.worker()), signal.SIGKILL)
    deadline = time.monotonic() + 5.0
    while alive(shared_worker.worker()) and time.monotonic() < deadline:
        time.sleep(0.01)
    drag(armature)


@pytest.mark.parametrize(
    ("operator", "fields"),
    [("refit_range", {}), ("touch", TOUCH), ("smooth_motion", {"strength": 2.0}), ("add_arms", {})],
)
def test_a_worker_that_dies_in_the_middle_is_a_sentence(armature, peer, operator, fields):
    before = all_keys(armature)
    preferences.get().python = peer(f"{READY}sys.stdin.readline(); os._exit(3)")
    try:
        with pytest.raises(RuntimeError, match=r"(?i)^error: the capturing process ended"):
            getattr(bpy.ops.manient, operator)(**fields)
    finally:
        preferences.get().python = ""
    np.testing.assert_array_equal(all_keys(armature).quats, before.quats)
    assert corrections.corrections_text(armature) == ""


def test_another_frame_while_dragging_shows_its_own_pose(armature):
    mode, scene = KeypointMode.__new__(KeypointMode), bpy.context.scene  # but for what it draws
    mode.refiner, mode.address, mode._warming, mode._solved_in = Refiner(armature), 0, None, 0.0
    mode.drag, mode.message, mode.done, mode.undone = None, "", 0, 0
    mode.view = SimpleNamespace(shows=lambda _: False)
    mode._frame, mode._places = scene.frame_current_final, mode.picture_places()
    scene.frame_set(FRAME + 4)
    expected = displayed_pose(rig_of(armature))
    scene.frame_set(FRAME)
    before = all_keys(armature)
    mode.drag = mode._new_drag(TIP, mode.row())
    mode.drag.place, mode.drag.moved = landmarks(armature)[TIP] + FARTHER, True
    deadline = time.monotonic() + 120.0
    while (mode.drag.waiting or mode.drag.needs_request) and time.monotonic() < deadline:
        mode.tick(bpy.context)
        time.sleep(0.005)
    assert mode.drag.answer is not None
    scene.frame_set(FRAME + 4)
    mode.tick(bpy.context)
    assert mode.drag is None
    np.testing.assert_allclose(displayed_pose(rig_of(armature)), expected, atol=1e-6)
    np.testing.assert_array_equal(all_keys(armature).quats, before.quats)


def test_what_cannot_be_refined_says_why(armature, make_take):
    assert bpy.ops.manient.edit_keypoints.poll()
    old = build_take(make_take(sides=("left",)).take).hands[0].armature
    bpy.context.view_layer.objects.active = old
    for operator in ("edit_keypoints", "refit_range", "clear_corrections"):
        assert not getattr(bpy.ops.manient, operator).poll()
    with pytest.raises(RuntimeError, match="capture the footage again"):
        bpy.ops.manient.edit_keypoints()
