"""Clips in scenes of another rate: hand and picture show the same moment on every whole frame."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

import blender_manient
from blender_manient.rigs import rig_of
from blender_manient.scene import see_through, store
from blender_manient.scene.apply import apply_track
from blender_manient.scene.build import build_take
from blender_manient.scene.corrections import corrected_frames
from blender_manient.scene.keys import PoseKeys, pose_at, read_pose_keys, write_pose_keys
from blender_manient.scene.plate import load_plate
from blender_manient.scene.preview import render_plate
from blender_manient.scene.retake import retaken
from blender_manient.scene.retime import other_rate
from blender_manient.scene.timing import in_scene
from blender_manient.session import source_info
from blender_manient.session.refiner import Refiner
from handfit_core.errors import OptionError
from handfit_core.media.source import Source
from handfit_core.retiming import shown_numbers

from .conftest import HEIGHT, WIDTH

CLIP_FPS, FRAMES = 30.0, np.arange(3, 33)
"""The take has these frames of a clip of 36"""
FIRST = 101
"""The scene frame at which it begins"""


@pytest.fixture(autouse=True)
def addon(empty_file):
    blender_manient.register()
    yield
    blender_manient.unregister()


@pytest.fixture
def movie(tmp_path):
    """A clip of which frame n is as grey as 6 n."""
    cv2 = pytest.importorskip("cv2")
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), CLIP_FPS, (WIDTH, HEIGHT))
    for number in range(1, 37):
        writer.write(np.full((HEIGHT, WIDTH, 3), number * 6, dtype=np.uint8))
    writer.release()
    return path


@pytest.fixture
def take(make_take, movie):
    source = Source("video", (str(movie),))
    made = make_take(sides=("right",), source=source, fps=CLIP_FPS, frame_numbers=FRAMES).take
    (track,) = made.hands
    depth = track.keypoints_2d[..., 0] * 0.0
    second = np.concatenate([track.keypoints_2d + 1.0, track.keypoints_2d[..., :1]], axis=-1)
    second[2] = np.nan  # where the second network was not asked
    detected = {"keypoints_depth": depth, "world_landmarks": track.joints_3d, "keypoints_2020": second}
    return replace(made, hands=(replace(track, **detected),))


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


@pytest.mark.parametrize("rate", [24.0, 25.0, 23.976, 50.0, 20.0, 12.0])
def test_hand_and_picture_show_the_same_moment(take, rate):
    scene_of(rate)
    built = build_take(take, match_scene=False)
    assert built.warnings == ()
    rig = rig_of(built.hands[0].armature)
    keys = read_pose_keys(rig)
    np.testing.assert_array_equal(keys.frames, np.round(keys.frames))
    assert keys.frames[0] == FIRST
    matched = build_take(take, match_scene=True)
    hand = store.hand_of(built.hands[0].armature)
    scene_of(rate)
    for frame in range(FIRST, int(keys.frames[-1]) + 1):
        moment = float(moments(frame, rate))
        number = shown_offset(built.camera, frame)
        assert abs(number - moment) <= 0.5 + 1e-6
        # The rows of the take are those of the picture that is shown.
        (row,) = store.rows_at(built.collection, hand.take, np.array([frame]))
        assert shown_numbers([moment])[0] == number
        if frame in keys.frames and take.hands[0].detected[number - FRAMES[0]]:
            for seen in ("keypoints_2d", "keypoints_2020"):
                np.testing.assert_array_equal(
                    getattr(hand.track, seen)[row], getattr(take.hands[0], seen)[number - FRAMES[0]]
                )
    # Poses are those that the clip's own keys have between them.
    chosen = keys.frames
    there = take.hands[0].present
    at = moments(chosen, rate)
    inside = (
        there[np.floor(at).astype(int) - 3] & there[np.minimum(np.ceil(at).astype(int) - 3, len(there) - 1)]
    )
    quats, places = pose_at(rig, chosen[inside])
    wanted, wanted_places = pose_at(rig_of(matched.hands[0].armature), at[inside])
    wanted /= np.linalg.norm(wanted, axis=-1, keepdims=True)
    np.testing.assert_allclose(np.abs((quats * wanted).sum(axis=-1)), 1.0, atol=2e-4)
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


@pytest.mark.parametrize("rate", [0.1, 240.0])
def test_absurd_rates_are_refused(take, rate):
    scene_of(rate)
    with pytest.raises(OptionError, match="frames per second"):
        build_take(take, match_scene=False)
    assert not bpy.data.objects
    assert not bpy.data.collections


def test_photos_have_no_rate(make_take, picture):
    scene_of(24.0)
    built = build_take(make_take(sides=("right",), fps=30.0).take, match_scene=False)
    assert built.camera.data.animation_data is None
    assert not built.collection.manient.source_digest
    assert built.collection.manient.scene_rate == 0.0


def test_old_files_stay_as_they_were(take):
    """Fractional keys, as former versions made them."""
    scene_of(24.0)
    built = build_take(take, match_scene=True)
    kept = built.collection.manient
    kept.frame_offset, kept.frame_scale, kept.scene_rate = 98.6, 0.8, 0.0
    frames = store.scene_frames(built.collection, store.kept_take(built.collection))
    np.testing.assert_allclose(frames, 98.6 + 0.8 * FRAMES, atol=1e-4)
    rows = store.rows_at(built.collection, take, frames)
    np.testing.assert_array_equal(rows, np.arange(len(FRAMES)))


def test_what_works_on_the_frame_under_the_playhead(take, movie):
    """Rows, Capture Frame and Find Hands mean the picture that is shown."""
    scene = scene_of(24.0)
    built = build_take(take, match_scene=False)
    files = source_info.SourceFiles("video", (str(movie),))
    refiner = Refiner(built.hands[0].armature)
    for frame in range(FIRST, FIRST + 20):
        scene.frame_set(frame)
        number = int(shown_numbers([moments(frame, 24.0)])[0])
        assert source_info.shown_frame(bpy.context, files) == number
        row = refiner.row_at(frame)
        at = int(np.flatnonzero(number == FRAMES)[0])
        if take.hands[0].detected[at]:
            np.testing.assert_array_equal(refiner.track.keypoints_2d[row], take.hands[0].keypoints_2d[at])
    other = source_info.SourceFiles("video", ("/elsewhere.mp4",))
    assert source_info.shown_frame(bpy.context, other) == scene.frame_current


def test_a_correction_keys_its_scene_frame(take):
    scene_of(24.0)
    armature = build_take(take, match_scene=False).hands[0].armature
    refiner, rig = Refiner(armature), rig_of(armature)
    before = read_pose_keys(rig)
    row = refiner.row_at(FIRST + 7)
    poses = refiner.keyed_poses([row])
    turn = np.array([np.cos(0.2), 0.0, 0.0, np.sin(0.2)])
    poses.quats[0, 4] = turn
    refiner.correct(row, {8: (10.0, 20.0)}, poses, 3.0)
    after = read_pose_keys(rig)
    np.testing.assert_array_equal(after.frames, before.frames)
    quats, _ = pose_at(rig, [FIRST + 7])
    assert abs(quats[0, 4] @ turn) == pytest.approx(1.0, abs=1e-6)
    assert corrected_frames(armature) == [FIRST + 7]
    far = np.abs(after.frames - FIRST - 7) >= 3
    np.testing.assert_allclose(after.quats[far], before.quats[far], atol=1e-6)
    assert not np.allclose(after.quats[~far, 4], before.quats[~far, 4])


def test_the_exported_take_is_of_the_clips_frames(take):
    scene_of(24.0)
    hand = store.hand_of(build_take(take, match_scene=False).hands[0].armature)
    again = retaken([hand])
    assert again.fps == CLIP_FPS
    shown = shown_numbers(moments(scene_frames_of(hand), 24.0))
    np.testing.assert_array_equal(again.frame_numbers, shown)
    (track,) = again.hands
    own = take.hands[0].detected[again.frame_numbers - FRAMES[0]]
    np.testing.assert_array_equal(track.detected, own)
    np.testing.assert_array_equal(
        track.keypoints_2d[own], take.hands[0].keypoints_2d[again.frame_numbers - FRAMES[0]][own]
    )


def scene_frames_of(hand):
    return store.scene_frames(hand.collection, hand.take)


def test_motion_of_the_same_clip_keeps_its_frames(take):
    """Captured again, and put on the hand that is there."""
    scene = scene_of(24.0)
    armature = build_take(take, match_scene=False).hands[0].armature
    before = read_pose_keys(rig_of(armature))
    scene.frame_set(500)
    apply_track(armature, take, take.hands[0], "ANIMATION", 500.0)
    after = read_pose_keys(rig_of(armature))
    np.testing.assert_array_equal(after.frames, before.frames)
    np.testing.assert_allclose(np.abs((after.quats * before.quats).sum(axis=-1)), 1.0, atol=1e-6)


def turn_key(rig, frame):
    """A key that an artist has set: a bone is turned by 0.4 radians about z."""
    quats, places = pose_at(rig, [frame])
    quats[0, 4] = [np.cos(0.2), 0.0, 0.0, np.sin(0.2)]
    keyed = np.isin(np.arange(16), [4])[None]
    write_pose_keys(rig, PoseKeys(np.array([float(frame)]), quats, places, keyed, np.array([False])))
    return quats[0, 4]


def corrected(armature, frame):
    """A point dragged there: the pose is the artist's."""
    refiner = Refiner(armature)
    row = refiner.row_at(frame)
    poses = refiner.keyed_poses([row])
    poses.quats[0, 7] = [np.cos(0.3), 0.0, 0.0, np.sin(0.3)]
    refiner.correct(row, {8: (10.0, 20.0)}, poses, 2.0)
    return pose_at(rig_of(armature), [frame])


@pytest.mark.parametrize("matched", [False, True])
@pytest.mark.parametrize("rate", [25.0, 60.0, 12.0, 30.0])
def test_another_rate_is_noticed_and_put_right(take, rate, matched):
    scene = scene_of(24.0)
    built = build_take(take, match_scene=matched)
    armature, collection = built.hands[0].armature, built.collection
    was = 30.0 if matched else 24.0
    first = FRAMES[0] if matched else FIRST
    assert not other_rate(scene, collection)
    pose = corrected(armature, first + 10)
    by_hand = turn_key(rig_of(armature), first + 3)
    scene.render.fps, scene.render.fps_base = round(rate), 1.0
    if rate == was:
        assert not other_rate(scene, collection)
        return
    assert other_rate(scene, collection) == pytest.approx(was)
    assert bpy.ops.manient.retime(hand=armature.name) == {"FINISHED"}
    assert not other_rate(scene, collection)
    rig = rig_of(armature)
    keys = read_pose_keys(rig)
    np.testing.assert_array_equal(keys.frames, np.round(keys.frames))
    # The corrected frame is the nearest one, with its pose and its point.
    moved = first + int(10 * rate / was + 0.5)
    assert corrected_frames(armature) == [moved]
    now = pose_at(rig, [moved])
    np.testing.assert_allclose(np.abs((now[0] * pose[0]).sum(axis=-1)), 1.0, atol=1e-6)
    np.testing.assert_allclose(now[1], pose[1], atol=1e-6)
    hand = store.hand_of(armature)
    refiner = Refiner(armature)
    assert refiner.pins(refiner.row_at(moved)) == {8: (10.0, 20.0)}
    if (3 * rate / was).is_integer():
        quats, _ = pose_at(rig, [first + 3 * rate / was])
        assert abs(quats[0, 4] @ by_hand) == pytest.approx(1.0, abs=1e-6)
    # Hand, rows and picture are in step.
    for frame in range(first, int(keys.frames[-1]) + 1):
        moment = FRAMES[0] + (frame - first) * CLIP_FPS / rate
        assert abs(shown_offset(built.camera, frame) - moment) <= 0.5 + 1e-6
        (row,) = store.rows_at(collection, hand.take, np.array([frame]))
        assert row == frame - first
    assert hand.take.fps == pytest.approx(rate)
    assert store.captured_take(collection).fps == CLIP_FPS


def test_there_and_back_keeps_the_correction(take):
    scene = scene_of(24.0)
    armature = build_take(take, match_scene=False).hands[0].armature
    pose = corrected(armature, FIRST + 10)
    for rate in (60, 48, 24):
        scene.render.fps = rate
        assert bpy.ops.manient.retime(hand=armature.name) == {"FINISHED"}
    assert corrected_frames(armature) == [FIRST + 10]
    now = pose_at(rig_of(armature), [FIRST + 10])
    np.testing.assert_allclose(np.abs((now[0] * pose[0]).sum(axis=-1)), 1.0, atol=1e-6)


def test_keys_of_the_former_rate_do_not_come_back(take):
    scene = scene_of(24.0)
    armature = build_take(take, match_scene=False).hands[0].armature
    bpy.context.view_layer.objects.active = armature
    assert bpy.ops.manient.simplify_keys() == {"FINISHED"}
    scene.render.fps = 48
    assert bpy.ops.manient.retime(hand=armature.name) == {"FINISHED"}
    assert not bpy.ops.manient.restore_keys.poll()


def test_clearing_works_after_it(take):
    """Without its correction the frame is as its neighbours lead to it."""
    scene = scene_of(24.0)
    armature = build_take(take, match_scene=False).hands[0].armature
    plain = pose_at(rig_of(armature), [FIRST + 10])[0]
    corrected(armature, FIRST + 10)
    scene.render.fps = 48
    bpy.ops.manient.retime(hand=armature.name)
    bpy.context.view_layer.objects.active = armature
    assert bpy.ops.manient.clear_corrections(scope="ALL") == {"FINISHED"}
    now = pose_at(rig_of(armature), [FIRST + 20])[0]
    np.testing.assert_allclose(np.abs((now * plain).sum(axis=-1)), 1.0, atol=1e-5)


def test_the_rate_is_put_back(take):
    scene = scene_of(23.976)
    built = build_take(take, match_scene=False)
    scene.render.fps, scene.render.fps_base = 25, 1.0
    before = read_pose_keys(rig_of(built.hands[0].armature)).frames
    assert bpy.ops.manient.retime(hand=built.hands[0].armature.name, back=True) == {"FINISHED"}
    assert scene.render.fps / scene.render.fps_base == pytest.approx(23.976, rel=1e-5)
    assert not other_rate(scene, built.collection)
    np.testing.assert_array_equal(read_pose_keys(rig_of(built.hands[0].armature)).frames, before)


@pytest.mark.parametrize("trouble", ["gone", "rate"])
def test_what_cannot_be_retimed_stays(take, movie, trouble):
    scene = scene_of(24.0)
    built = build_take(take, match_scene=False)
    armature, kept = built.hands[0].armature, built.collection.manient
    before = read_pose_keys(rig_of(armature)), kept.digest, kept.scene_rate
    scene.render.fps = 25 if trouble == "gone" else 240
    if trouble == "gone":
        movie.unlink()
    with pytest.raises(
        RuntimeError, match="clip.avi is not there" if trouble == "gone" else "240 frames per"
    ):
        bpy.ops.manient.retime(hand=armature.name)
    after = read_pose_keys(rig_of(armature)), kept.digest, kept.scene_rate
    np.testing.assert_array_equal(after[0].frames, before[0].frames)
    assert after[1:] == before[1:]


def test_the_picture_over_the_hand_is_in_step_too(take):
    scene_of(24.0)
    built = build_take(take, match_scene=False)
    camera = built.camera.data
    see_through.lay_over(camera, 0.5)
    bpy.context.scene.frame_set(FIRST + 13)
    shown = built.camera.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.background_images
    assert [one.display_depth for one in shown] == ["BACK", "FRONT"]
    assert shown[0].image_user.frame_offset == shown[1].image_user.frame_offset == 4
    see_through.take_away(camera)
    assert len(camera.animation_data.drivers) == 1
