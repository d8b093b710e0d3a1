"""Clips in scenes of another rate: hand and picture show the same moment on every whole frame."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient.exporters.take import retaken
from blender_manient.rigs import rig_of
from blender_manient.rigs.arm import ArmBones
from blender_manient.scene import own_keys, store
from blender_manient.scene.apply import apply_track
from blender_manient.scene.background import load_plate
from blender_manient.scene.build import build_take
from blender_manient.scene.corrections import corrected_frames
from blender_manient.scene.keys import PoseKeys, pose_at, read_pose_keys, write_pose_keys
from blender_manient.scene.preview import render_plate
from blender_manient.scene.retime import other_rate
from blender_manient.scene.timing import in_scene
from blender_manient.session import source_info
from blender_manient.session.refiner import Refiner
from handfit_core.capturing.retiming import shown_numbers
from handfit_core.common.errors import OptionError
from handfit_core.geometry.rotations import quat_multiply, rotvec_to_quat
from tests.takes import seen_as, with_arms

from .conftest import movie

pytestmark = pytest.mark.usefixtures("registered")

CLIP_FPS, FRAMES = 30.0, np.arange(3, 33)
"""The take has these frames of a clip of 40"""
FIRST = 101
"""The scene frame at which it begins"""


@pytest.fixture
def take(make_take, tmp_path):
    source = movie(tmp_path / "clip.avi")
    made = make_take(sides=("right",), source=source, fps=CLIP_FPS, frame_numbers=FRAMES).take
    (track,) = made.hands
    depth = track.keypoints_2d[..., 0] * 0.0
    second = np.concatenate([track.keypoints_2d + 1.0, track.keypoints_2d[..., :1]], axis=-1)
    second[2] = np.nan  # where the second network was not asked
    detected = {"keypoints_depth": depth, "world_landmarks": track.joints_3d, "keypoints_2020": second}
    return replace(made, hands=(seen_as(track, **detected),))


def scene_of(rate: float):
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = round(rate), round(rate) / rate
    scene.frame_set(FIRST)
    return scene


def moments(frames, rate):
    """The source frames that scene frames show, written out."""
    return FRAMES[0] + (np.asarray(frames) - FIRST) * CLIP_FPS / rate


def shown_offset(camera, frame: int) -> int:
    """The picture that the camera's background shows on a scene frame, by Blender's own arithmetic."""
    bpy.context.scene.frame_set(frame)
    shown = camera.evaluated_get(bpy.context.evaluated_depsgraph_get())
    user = shown.data.background_images[0].image_user
    return min(max(frame - user.frame_start + 1, 0), user.frame_duration) + user.frame_offset


def rotated_alike(one, other, atol=1e-6) -> None:
    np.testing.assert_allclose(np.abs((one * other).sum(axis=-1)), 1.0, atol=atol)


@pytest.mark.parametrize("rate", [25.0, 23.976, 50.0, 12.0])
def test_hand_and_picture_show_the_same_moment(take, rate):
    scene_of(rate)
    built = build_take(take, match_scene=False)
    assert built.warnings == ()
    hand = store.hand_of(built.hands[0].armature)
    keys = read_pose_keys(hand.rig).frames
    np.testing.assert_array_equal(keys, np.round(keys))
    assert keys[0] == FIRST
    (captured,) = take.hands
    for frame in range(FIRST, int(keys[-1]) + 1):
        number = shown_offset(built.camera, frame)
        assert abs(number - moments(frame, rate)) <= 0.5 + 1e-6
        # The rows of the take are those of the picture that is shown.
        (row,) = store.rows_at(built.collection, hand.take, np.array([frame]))
        if frame in keys and captured.detected[number - FRAMES[0]]:
            for seen in ("keypoints_2d", "keypoints_2020"):
                theirs = getattr(captured.rows, seen)[number - FRAMES[0]]
                np.testing.assert_array_equal(getattr(hand.track.rows, seen)[row], theirs)
    # Poses are those that the clip's own keys have between them.
    matched = build_take(take, match_scene=True)
    rows, there = moments(keys, rate) - FRAMES[0], captured.present
    inside = there[np.floor(rows).astype(int)] & there[np.minimum(np.ceil(rows).astype(int), len(there) - 1)]
    quats, places = pose_at(hand.rig, keys[inside])
    wanted, wanted_places = pose_at(rig_of(matched.hands[0].armature), rows[inside] + FRAMES[0])
    wanted /= np.linalg.norm(wanted, axis=-1, keepdims=True)
    rotated_alike(quats, wanted, 2e-4)
    np.testing.assert_allclose(places, wanted_places, atol=1e-3)


def test_the_picture_in_renders(take):
    """Rendered, so that Blender's own arithmetic is what is tested."""
    scene = scene_of(24.0)
    _, _, clip = in_scene(scene, take)
    plate, _ = load_plate(take, clip)
    for frame in (FIRST - 1, FIRST, 102, 103, 105, 107, 110, 115, 120, 124):
        rows = render_plate(plate, take, frame, 1.0)
        wanted = 6 * shown_numbers([moments(frame, 24.0)])[0]
        assert np.median(rows[..., 0]) * 255 == pytest.approx(wanted, abs=2.5)


def test_it_survives_a_file_without_scripts(take, tmp_path):
    scene_of(24.0)
    name = build_take(take, match_scene=False).camera.name
    path = str(tmp_path / "shot.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path, use_scripts=False)
    camera = bpy.data.objects[name]
    (driver,) = camera.data.animation_data.drivers
    assert driver.driver.is_simple_expression
    numbers = [shown_offset(camera, f) for f in range(FIRST, FIRST + 20)]
    np.testing.assert_array_equal(numbers, shown_numbers(moments(np.arange(FIRST, FIRST + 20), 24.0)))
    hand = store.hand_of(store.captured_hands(bpy.context.scene)[0])
    assert hand.take.fps == pytest.approx(24.0)
    assert store.captured_take(hand.collection).fps == CLIP_FPS
    np.testing.assert_allclose(
        store.clip_timing(hand.collection).source_frames([FIRST, 110]), moments([FIRST, 110], 24.0)
    )


@pytest.fixture
def retimed(take):
    """A hand of a clip of 30 frames per second in a scene of 24."""
    scene_of(24.0)
    armature = build_take(take, match_scene=False).hands[0].armature
    bpy.context.view_layer.objects.active = armature
    return store.hand_of(armature)


def test_what_works_on_the_frame_under_the_playhead(retimed, take):
    """Rows, Capture Frame and Find Hands mean the picture that is shown."""
    files = source_info.SourceFiles("video", take.source.files)
    refiner, (captured,) = Refiner(retimed.armature), take.hands
    for frame in range(FIRST, FIRST + 20):
        bpy.context.scene.frame_set(frame)
        number = int(shown_numbers([moments(frame, 24.0)])[0])
        assert source_info.shown_frame(bpy.context, files) == number
        seen = refiner.track.keypoints_2d[refiner.row_at(frame)]
        if captured.detected[number - FRAMES[0]]:
            np.testing.assert_array_equal(seen, captured.keypoints_2d[number - FRAMES[0]])
    other = source_info.SourceFiles("video", ("/elsewhere.mp4",))
    assert source_info.shown_frame(bpy.context, other) == bpy.context.scene.frame_current


def test_the_exported_take_is_of_the_clips_frames(retimed, take):
    again = retaken([retimed])
    assert again.fps == CLIP_FPS
    frames = store.scene_frames(retimed.collection, retimed.take)
    np.testing.assert_array_equal(again.frame_numbers, shown_numbers(moments(frames, 24.0)))
    (track,), (captured,), rows = again.hands, take.hands, again.frame_numbers - FRAMES[0]
    own = captured.detected[rows]
    np.testing.assert_array_equal(track.detected, own)
    np.testing.assert_array_equal(track.keypoints_2d[own], captured.keypoints_2d[rows][own])


def test_motion_of_the_same_clip_keeps_its_frames(retimed, take):
    """Captured again, and put on the hand that is there."""
    before = read_pose_keys(retimed.rig)
    bpy.context.scene.frame_set(500)
    apply_track(retimed.armature, take, take.hands[0], "ANIMATION", 500.0)
    after = read_pose_keys(retimed.rig)
    np.testing.assert_array_equal(after.frames, before.frames)
    rotated_alike(after.quats, before.quats)


def retime(armature, rate: float, **fields) -> None:
    bpy.context.scene.render.fps, bpy.context.scene.render.fps_base = round(rate), 1.0
    assert bpy.ops.manient.retime(hand=armature.name, **fields) == {"FINISHED"}


def corrected(armature, frame: int):
    """A point dragged there: the pose is the artist's."""
    refiner = Refiner(armature)
    row = refiner.row_at(frame)
    poses = refiner.keyed_poses([row])
    poses.quats[0, 7] = [np.cos(0.3), 0.0, 0.0, np.sin(0.3)]
    refiner.correct(row, {8: (10.0, 20.0)}, poses, 2.0)
    return pose_at(rig_of(armature), [frame])


def turn_key(rig, frame: int) -> np.ndarray:
    """A key that an artist has changed: a bone is turned by 0.2 degrees about z."""
    quats, places = pose_at(rig, [frame])
    quats[0, 4] = quat_multiply(quats[0, 4], rotvec_to_quat(np.array([0.0, 0.0, np.radians(0.2)])))
    keyed = np.isin(np.arange(16), [4])[None]
    write_pose_keys(rig, PoseKeys(np.array([float(frame)]), quats, places, keyed, np.array([False])))
    return quats[0, 4]


@pytest.mark.parametrize(("rate", "matched"), [(25.0, False), (60.0, False), (12.0, True)])
def test_another_rate_is_noticed_and_put_right(take, rate, matched):
    scene = scene_of(24.0)
    built = build_take(take, match_scene=matched)
    armature, collection = built.hands[0].armature, built.collection
    was, first = (30.0, FRAMES[0]) if matched else (24.0, FIRST)
    assert not other_rate(scene, collection)
    pose = corrected(armature, first + 10)
    by_hand = turn_key(rig_of(armature), first + 4)
    scene.render.fps, scene.render.fps_base = round(rate), 1.0
    assert other_rate(scene, collection) == pytest.approx(was)
    retime(armature, rate)
    assert not other_rate(scene, collection)
    hand = store.hand_of(armature)
    keys = read_pose_keys(hand.rig).frames
    np.testing.assert_array_equal(keys, np.round(keys))
    # The corrected frame is the nearest one, with its pose and its point.
    moved = first + int(10 * rate / was + 0.5)
    assert corrected_frames(armature) == [moved]
    now = pose_at(hand.rig, [moved])
    rotated_alike(now[0], pose[0])
    np.testing.assert_allclose(now[1], pose[1], atol=1e-6)
    refiner = Refiner(armature)
    assert refiner.pins(refiner.row_at(moved)) == {8: (10.0, 20.0)}
    if (4 * rate / was).is_integer():
        rotated_alike(pose_at(hand.rig, [first + 4 * rate / was])[0][0, 4], by_hand)
        assert own_keys.keyed_by_hand(hand, np.array([round(4 * rate / was)]))[0, 4]
    # Hand, rows and picture are in step.
    for frame in range(first, int(keys[-1]) + 1):
        moment = FRAMES[0] + (frame - first) * CLIP_FPS / rate
        assert abs(shown_offset(built.camera, frame) - moment) <= 0.5 + 1e-6
        assert store.rows_at(collection, hand.take, np.array([frame])).tolist() == [frame - first]
    assert hand.take.fps == pytest.approx(rate)
    assert store.captured_take(collection).fps == CLIP_FPS


def test_arms_are_sampled_too(take):
    """On whole frames, as the hand: stretched keys would lie between them."""
    scene_of(24.0)
    armature = build_take(with_arms(take), match_scene=False).hands[0].armature
    arm = ArmBones(armature)
    before = read_pose_keys(arm).frames
    quats, places = pose_at(arm, FIRST + 0.5 * np.arange(80))
    quats /= np.linalg.norm(quats, axis=-1, keepdims=True)
    retime(armature, 48.0)
    keys = read_pose_keys(arm)
    rows = keys.frames.astype(int) - FIRST
    np.testing.assert_array_equal(keys.frames, FIRST + rows)
    assert set(FIRST + 2 * (before - FIRST)) <= set(keys.frames)
    assert len(rows) > 1.8 * len(before)
    rotated_alike(keys.quats, quats[rows])
    np.testing.assert_allclose(keys.locations, places[rows], atol=1e-6)


def test_there_and_back_keeps_the_correction_which_can_be_cleared(retimed):
    """Without it the frame is as its neighbours lead to it. Keys of the former rate do not come back."""
    armature, frame = retimed.armature, [FIRST + 10]
    plain = pose_at(retimed.rig, frame)[0]
    pose = corrected(armature, FIRST + 10)
    assert bpy.ops.manient.simplify_keys() == {"FINISHED"}
    for rate in (60, 48, 24):
        retime(armature, rate)
    assert not bpy.ops.manient.restore_keys.poll()
    assert corrected_frames(armature) == frame
    rotated_alike(pose_at(retimed.rig, frame)[0], pose[0])
    retime(armature, 48)
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    rotated_alike(pose_at(retimed.rig, [FIRST + 20])[0], plain, 1e-4)


def test_the_rate_is_put_back(take):
    scene = scene_of(23.976)
    built = build_take(take, match_scene=False)
    armature = built.hands[0].armature
    before = read_pose_keys(rig_of(armature)).frames
    retime(armature, 25, back=True)
    assert scene.render.fps / scene.render.fps_base == pytest.approx(23.976, rel=1e-5)
    assert not other_rate(scene, built.collection)
    np.testing.assert_array_equal(read_pose_keys(rig_of(armature)).frames, before)


@pytest.mark.parametrize(("rate", "said"), [(25, "clip.avi is not there"), (240, "240 frames per")])
def test_what_cannot_be_retimed_stays(retimed, tmp_path, rate, said):
    kept = retimed.collection.manient
    before = read_pose_keys(retimed.rig), kept.digest, kept.scene_rate
    if rate == 25:
        (tmp_path / "clip.avi").unlink()
    with pytest.raises(RuntimeError, match=said):
        retime(retimed.armature, rate)
    after = read_pose_keys(retimed.rig), kept.digest, kept.scene_rate
    np.testing.assert_array_equal(after[0].frames, before[0].frames)
    assert after[1:] == before[1:]


def test_absurd_rates_are_refused_and_photos_have_none(take, make_take):
    for rate in (0.1, 240.0):
        scene_of(rate)
        with pytest.raises(OptionError, match="frames per second"):
            build_take(take, match_scene=False)
    assert not bpy.data.objects
    assert not bpy.data.collections
    scene_of(24.0)
    built = build_take(make_take(sides=("right",), fps=30.0).take, match_scene=False)
    assert built.camera.data.animation_data is None
    assert not built.collection.manient.source_digest
    assert built.collection.manient.scene_rate == 0.0
