"""The capture operator without a window: it waits for the worker and builds what it found."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view

from blender_manient.common import preferences
from blender_manient.operators.capture import new_request
from blender_manient.panels.capture import MANIENT_PT_capture
from blender_manient.scene.keys import read_pose_keys
from blender_manient.scene.store import captured_hands, hand_of
from blender_manient.session import jobs, shared_worker, source_info
from handfit_core.common.errors import HandfitError
from handfit_core.common.skeleton import FINGERS
from tests.capturing import needs_capture
from tests.drawn import drawn
from tests.waiting import alive

from .conftest import READY

pytestmark = pytest.mark.usefixtures("registered")

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rendered_hand"


@pytest.fixture
def photo(tmp_path) -> Path:
    return Path(shutil.copy(SAMPLE / "hand.0001.jpg", tmp_path / "my hand.jpg"))


@pytest.fixture
def settings():
    return bpy.context.scene.manient


def hands():
    return [hand_of(armature) for armature in captured_hands(bpy.context.scene)]


def capture() -> None:
    assert bpy.ops.manient.capture() == {"FINISHED"}


def submitted():
    return jobs.submit(new_request(bpy.context, only_frame=False))


def test_stop_stands_below_the_progress_and_is_grey_while_hands_are_built(photo, settings):
    settings.source = str(photo)
    job = submitted()
    try:
        for state, said in (("capturing", "Stop"), ("capturing", "Stopping"), ("building", "Building Hands")):
            vars(job).update(state=state, stopping=said != "Stop")
            page = drawn(MANIENT_PT_capture)
            assert said in page.rows
            assert "Capture" not in page.rows
            assert (said in page.grey) == (said != "Stop")
    finally:
        job.state = "done"
        jobs.abandon()


def test_a_worker_that_dies_fails_its_capture_alone(photo, settings, peer):
    settings.source = str(photo)
    preferences.get().python = peer(f"{READY}sys.stdin.readline(); os._exit(3)")
    with pytest.raises(RuntimeError, match=r"^Error: my hand\.jpg: The capturing process ended unexpectedly"):
        bpy.ops.manient.capture()
    (job,) = jobs.jobs()
    assert (job.state, job.activity()) == ("failed", job.result.message)
    assert job.result.message.startswith("The capturing process ended unexpectedly")
    assert "Traceback" not in job.result.summary()
    assert f"Capture of {photo.name}" in bpy.data.texts["Hand Capture Details"].as_string()
    assert not jobs.busy()
    assert hands() == []


def tick_until(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, [(j.state, j.result.message) for j in jobs.jobs()]
        jobs.tick()
        time.sleep(0.002)


@needs_capture
def test_photo(photo, settings):
    settings.source, settings.add_controls = str(photo), True
    capture()
    (hand,) = hands()
    assert (hand.side, len(hand.take.frame_numbers)) == ("right", 1)
    assert hand.track.refinable
    assert hand.armature.manient.wrist == "cap"
    assert bpy.context.view_layer.objects.active == hand.armature
    assert bpy.context.scene.camera == hand.camera
    (job,) = jobs.jobs()
    assert (job.state, job.result.message) == ("done", "1 hand in 1 frame")
    kinds = [o.type for o in hand.collection.all_objects]
    assert (kinds.count("LIGHT"), kinds.count("MESH")) == (3, 2)
    assert set(FINGERS) < set(hand.rig.controls)
    bpy.ops.manient.remove_capture(capture=hand.collection.name)
    settings.add_controls = settings.render_setup = False
    capture()
    (hand,) = hands()
    kinds = [o.type for o in hand.collection.all_objects]
    assert (kinds.count("LIGHT"), kinds.count("MESH")) == (0, 1)
    assert not hand.rig.controls


@needs_capture
def test_sequence_range_and_single_frame(settings):
    settings.source = str(SAMPLE / "hand.0003.jpg")
    settings.as_sequence = True
    settings.use_frames, settings.first_frame, settings.last_frame, settings.frame_step = True, 3, 9, 3
    capture()
    assert list(hands()[0].take.frame_numbers) == [3, 6, 9]
    bpy.context.scene.frame_set(5)
    assert bpy.ops.manient.capture(only_frame=True) == {"FINISHED"}
    assert sorted(len(h.take.frame_numbers) for h in hands()) == [1, 3]


@needs_capture
def test_a_shot_keeps_its_time_and_the_hand_begins_where_the_button_was_pressed(settings):
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1001, 1120
    scene.frame_set(1010)
    settings.source = str(SAMPLE)
    settings.use_frames, settings.first_frame, settings.last_frame = True, 3, 6
    job = submitted()
    tick_until(lambda: job.state == "building")
    scene.frame_set(1050)
    tick_until(lambda: job.finished)
    (hand,) = hands()
    assert (scene.frame_start, scene.frame_end, scene.frame_current) == (1001, 1120, 1050)
    assert (scene.render.fps, scene.render.resolution_x, scene.camera) == (24, 1920, None)
    assert tuple(hand.armature.animation_data.action.frame_range) == (1010.0, 1013.0)
    assert not job.result.matched
    assert job.result.scene_message == "Scene stays, hand at frame 1010, 24 fps"
    settings.matching = "MATCH"
    capture()
    assert (scene.frame_start, scene.frame_end) == (3, 6)
    assert jobs.jobs()[-1].result.scene_message.startswith("Scene became ")


@needs_capture
def test_onto_a_hand_that_is_there(settings):
    settings.source = str(SAMPLE)
    settings.use_frames, settings.first_frame, settings.last_frame = True, 1, 4
    capture()
    bone = hands()[0].armature.pose.bones["index_proximal.R"]
    bpy.context.scene.frame_set(20)
    before = np.array(bone.rotation_quaternion)
    settings.source, settings.target = str(SAMPLE / "hand.0016.jpg"), "POSE"
    settings.as_sequence = False
    capture()
    bpy.context.scene.frame_set(20)
    assert len(hands()) == 1
    assert np.abs(np.array(bone.rotation_quaternion) - before).max() > 0.02


@needs_capture
def test_through_the_scenes_own_camera(settings, photo):
    scene, camera = bpy.context.scene, bpy.data.objects.new("own", bpy.data.cameras.new("own"))
    camera.location, camera.rotation_euler = (1.0, 2.0, 3.0), (1.1, 0.2, 0.3)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = 640, 480
    bpy.context.view_layer.update()
    settings.source, settings.camera = str(photo), "ACTIVE"
    capture()
    (hand,) = hands()
    assert scene.camera == camera == hand.camera
    bpy.context.view_layer.update()
    wrist = hand.armature.matrix_world @ hand.armature.pose.bones["wrist.R"].head
    seen = world_to_camera_view(scene, camera, wrist)
    expected = hand.track.keypoints_2d[0, 0]
    assert [seen.x * 640, (1 - seen.y) * 480] == pytest.approx(list(expected), abs=25.0)
    assert seen.z > 0.1


@needs_capture
@pytest.mark.parametrize("what", ["renamed", "gone", "scene gone"])
def test_what_happens_to_the_hand_and_the_scene_meanwhile(settings, photo, what):
    """A renamed hand is found, one that is gone is built anew, where the scene is gone in the open one."""
    settings.source = str(photo)
    capture()
    settings.target = "POSE" if what != "scene gone" else "NEW"
    scene, job = bpy.context.scene, submitted()
    tick_until(lambda: job.state == "capturing")
    armature = hands()[0].armature
    armature.name = "another name"
    if what == "gone":
        bpy.data.objects.remove(armature)
    elif what == "scene gone":
        bpy.context.window.scene = bpy.data.scenes.new("Other")
        bpy.data.scenes.remove(scene)
    tick_until(lambda: job.finished)
    assert job.state == "done", job.result.message
    assert (len(hands()), bool(job.result.warnings)) == (1, what != "renamed")


@needs_capture
@pytest.mark.parametrize(("numbers", "expected"), [((1, 4), [[1], [1]]), ((3, 4, 5), [[3, 4, 5]])])
def test_dropped_pictures(numbers, expected):
    files = [{"name": f"hand.{number:04}.jpg"} for number in numbers]
    options = {"as_sequence": True} if len(expected) == 1 else {}
    assert bpy.ops.manient.drop_media(directory=str(SAMPLE), files=files, **options) == {"FINISHED"}
    assert [list(hand.take.frame_numbers) for hand in hands()] == expected


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"source": ""}, "Choose a photo"),
        ({"source": "/nowhere/gone.jpg"}, "not there any more"),
        ({"target": "POSE"}, "select the captured hand"),
        ({"camera": "ACTIVE"}, "no active camera"),
        ({"model": "MANO"}, "choose your MANO files"),
        ({"as_sequence": True, "use_frames": True, "first_frame": 9, "last_frame": 3}, "last frame lies"),
    ],
)
def test_what_is_missing_is_said_before_anything_starts(settings, values, said):
    settings.source = str(SAMPLE / "hand.0001.jpg")
    for name, value in values.items():
        setattr(settings, name, value)
    with pytest.raises(HandfitError, match=said):
        new_request(bpy.context, only_frame=False)
    assert shared_worker.current() is None or not alive(shared_worker.current())


@pytest.mark.parametrize(("frame", "there"), [(5, True), (25, False), (0, False), (-39, False)])
def test_a_frame_outside_the_clip_is_refused(settings, frame, there):
    settings.source, settings.as_sequence = str(SAMPLE / "hand.0003.jpg"), True  # 1 to 24
    bpy.context.scene.frame_set(frame)
    if there:
        assert new_request(bpy.context, only_frame=True).options.frames.first == frame
    else:
        with pytest.raises(HandfitError, match="go to its frames 1 to 24"):
            new_request(bpy.context, only_frame=True)


def test_settings_become_the_options_of_the_worker(settings):
    settings.source = str(SAMPLE / "hand.0001.jpg")
    settings.preset, settings.experiment = "PAPER", "paper-c"
    settings.use_hand_length, settings.hand_length = True, 17.0
    settings.camera, settings.focal_length = "FOCAL", 72.0
    options = new_request(bpy.context, only_frame=False).options.to_message()
    assert options["solver"] == "paper-c"
    assert "quality" not in options
    assert options["hand_length"] == pytest.approx(0.17)
    assert options["lens"] == pytest.approx([2.0, 0.5, 0.5])
    for quality, expected in (
        ("DRAFT", {"quality": "draft", "plain_detection": True}),
        ("STANDARD", {}),
        ("BEST", {"quality": "best"}),
    ):
        settings.preset = quality
        options = new_request(bpy.context, only_frame=False).options.to_message()
        others = ("quality", "plain_detection", "solver")
        assert {name: value for name, value in options.items() if name in others} == expected


@pytest.fixture
def own_camera():
    """The scene's camera, an artist's that moves."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    for frame, place in ((90, (0.0, -3.0, 1.0)), (140, (1.0, -2.0, 1.5))):
        camera.location = place
        camera.keyframe_insert("location", frame=frame)
    return camera


def put_behind(camera, path: Path, first: int):
    """Have the camera show a Movie Clip from a scene frame on."""
    background = camera.data.background_images.new()
    background.source, background.clip = "MOVIE_CLIP", bpy.data.movieclips.load(str(path))
    background.clip.frame_start = first
    return background


def pictures(folder: Path, kind: str) -> Path:
    """Ten pictures of a hand, as a sequence from number 2 on or as a clip of 12 frames per second."""
    files = [SAMPLE / f"hand.{number:04}.jpg" for number in range(2, 12)]
    if kind != "MOVIE":
        return min([Path(shutil.copy(file, folder)) for file in files])
    cv2 = pytest.importorskip("cv2")
    read = [cv2.imread(str(file)) for file in files]
    path = folder / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 12.0, read[0].shape[1::-1])
    for picture in read:
        writer.write(picture)
    writer.release()
    return path


def test_what_is_no_clip_of_the_cameras(settings, own_camera, tmp_path):
    """No clip, three of them, or one whose file is gone: a sentence, and the source stays."""
    settings.source = str(SAMPLE)
    own_camera.data.background_images.new().image = bpy.data.images.new("Beside", 8, 8)
    assert not bpy.ops.manient.use_background_clip.poll()
    made = [Path(shutil.copy(SAMPLE / "hand.0001.jpg", tmp_path / f"{name}.jpg")) for name in "abc"]
    backgrounds = [put_behind(own_camera, path, 1) for path in made]
    with pytest.raises(RuntimeError, match="Camera has 3 clips: hide all but one"):
        bpy.ops.manient.use_background_clip()
    for background in backgrounds[1:]:
        background.show_background_image = False
    made[0].unlink()
    with pytest.raises(RuntimeError, match="not there any more"):
        bpy.ops.manient.use_background_clip()
    assert (settings.source, settings.camera) == (str(SAMPLE), "SOLVE")


@needs_capture
@pytest.mark.parametrize("kind", ["MOVIE", "SEQUENCE", "IMAGES"])
def test_the_cameras_own_clip_lies_where_the_camera_shows_it(settings, own_camera, tmp_path, kind):
    scene, path, camera = bpy.context.scene, pictures(tmp_path, kind), own_camera
    scene.render.fps, scene.render.resolution_x, scene.render.resolution_y = 30, 640, 480
    scene.frame_set(150)
    if kind == "IMAGES":
        background = camera.data.background_images.new()
        background.image = bpy.data.images.load(str(path))
        background.image.source = "SEQUENCE"
        user = background.image_user
        user.frame_start, user.frame_offset, user.frame_duration = 101, 4, 20
        background.frame_method, background.scale = "FIT", 0.5
        scene.render.resolution_x = 1280
        first, part = 98, np.array([0.25, 0.5])  # picture 2: on 101 it shows 5
    else:
        put_behind(camera, path, 101).clip.frame_offset = 3
        first, part = 98, np.ones(2)  # the first file's
    assert bpy.ops.manient.use_background_clip() == {"FINISHED"}
    assert (settings.source, settings.camera) == (str(path), "ACTIVE")
    assert "Camera's clip" in drawn(MANIENT_PT_capture).said
    assert f"Hand at frame {first}, with the camera's clip" in drawn(MANIENT_PT_capture).said
    if kind == "MOVIE":
        assert source_info.dropped_footage(settings, path).placed.offset == first - 1
    settings.matching = "MATCH"  # which the scene is not, since the clip is in it
    capture()
    (job,) = jobs.jobs()
    assert (job.result.matched, job.result.warnings) == (False, ())
    (hand,) = hands()
    assert hand.armature.animation_data.action.frame_range[:] == (first, first + 9)
    assert (scene.frame_current, scene.render.fps, len(camera.data.background_images)) == (150, 30, 1)
    for row in range(10):
        scene.frame_set(first + row)
        wrist = hand.armature.matrix_world @ hand.armature.pose.bones["wrist.R"].head
        seen = world_to_camera_view(scene, camera, wrist)
        expected = hand.track.keypoints_2d[row, 0] / (hand.take.width, hand.take.height) - 0.5
        assert [seen.x - 0.5, 0.5 - seen.y] == pytest.approx(list(expected * part), abs=0.03)
    assert bpy.ops.manient.capture(only_frame=True) == {"FINISHED"}
    assert [n.take.frame_numbers.tolist() for n in hands() if len(n.take.frame_numbers) == 1] == [
        [hand.take.frame_numbers[-1]]
    ]
    settings.source = str(SAMPLE)
    assert settings.camera == "SOLVE", "it was the camera's clip that was seen by it"


@needs_capture
def test_a_hand_that_is_there_moves_when_the_camera_shows_it(settings, own_camera, photo, tmp_path):
    settings.source = str(photo)
    capture()
    put_behind(own_camera, pictures(tmp_path, "SEQUENCE"), 101)
    bpy.ops.manient.use_background_clip()
    settings.target = "ANIMATION"
    bpy.context.scene.frame_set(150)
    capture()
    (hand,) = hands()
    assert read_pose_keys(hand.rig).frames.tolist() == [1, *range(101, 111)]


def solved(path: Path):
    """A Movie Clip in which Blender's tracker has found a camera that moves aside."""
    clip = bpy.data.movieclips.load(str(path))
    focal, (width, height) = clip.tracking.camera.focal_length_pixels, clip.size
    for number, place in enumerate(np.random.default_rng(0).uniform(-1, 1, (12, 3)) + [0, 0, 5]):
        track = clip.tracking.tracks.new(name=f"track {number}", frame=1)
        for frame in range(1, 6):
            x, y, depth = place - [0.2 * frame, 0.05 * frame, 0.0]
            co = (0.5 + focal * x / depth / width, 0.5 + focal * y / depth / height)
            track.markers.insert_frame(frame, co=co)
    clip.tracking.objects[0].keyframe_a, clip.tracking.objects[0].keyframe_b = 1, 5
    area = bpy.context.screen.areas[0]
    area.type = "CLIP_EDITOR"
    area.spaces.active.clip = clip
    with bpy.context.temp_override(window=bpy.context.window, area=area, region=area.regions[-1]):
        assert bpy.ops.clip.solve_camera() == {"FINISHED"}
    return clip


def test_a_tracked_clip_whose_file_is_gone(settings, own_camera, tmp_path):
    settings.source = str(SAMPLE)
    path = pictures(tmp_path, "SEQUENCE")
    solved(path)
    shutil.move(path, tmp_path / "elsewhere.jpg")
    assert own_camera == bpy.context.scene.camera
    with pytest.raises(RuntimeError, match="not there any more"):
        bpy.ops.manient.use_background_clip()
    assert (settings.source, settings.camera) == (str(SAMPLE), "SOLVE")


@needs_capture
@pytest.mark.parametrize("how", ["animated", "solver"])
def test_a_tracked_clip_is_the_scene_cameras(settings, own_camera, tmp_path, how):
    """Without it in the background, too; the picture that is put there goes with the capture."""
    path = pictures(tmp_path, "SEQUENCE")
    own_camera.data.background_images.new().image = bpy.data.images.new("Beside", 8, 8)
    clip = solved(path)
    clip.frame_start = 101
    if how == "solver":
        own_camera.animation_data_clear()
        settings.source = str(path)
        assert settings.camera == "SOLVE", "the camera stands, and has nothing to do with the clip"
        settings.source = ""
        own_camera.constraints.new("CAMERA_SOLVER").clip = clip
    settings.source, settings.as_sequence = str(path), True
    assert settings.camera == "ACTIVE"
    assert "Tracked clip" in drawn(MANIENT_PT_capture).said
    capture()
    (hand,) = hands()
    assert hand.armature.animation_data.action.frame_range[:] == (101, 110)
    _, background = own_camera.data.background_images
    assert (background.image_user.frame_start, background.image_user.frame_offset) == (101, 1)
    assert bpy.ops.manient.remove_capture(capture=hand.collection.name) == {"FINISHED"}
    assert [each.image.name for each in own_camera.data.background_images] == ["Beside"]
    assert [image.name for image in bpy.data.images] == ["Beside"]
    path.unlink()
    with pytest.raises(RuntimeError, match="not there any more"):
        bpy.ops.manient.use_background_clip()


@needs_capture
def test_removing_takes_the_picture_from_the_artists_camera(settings, own_camera, photo):
    """But not from another capture before it; nor does it mind that the camera is gone."""
    settings.source, settings.camera = str(photo), "ACTIVE"
    for _ in range(2):
        capture()
    first, second = (hand.collection for hand in hands())
    assert len(own_camera.data.background_images) == 1
    assert bpy.ops.manient.remove_capture(capture=first.name) == {"FINISHED"}
    assert len(own_camera.data.background_images) == 1
    assert [job.is_gone for job in jobs.jobs()] == [True, False]
    assert drawn(MANIENT_PT_capture).said.count("1 hand in 1 frame") == 1
    assert bpy.ops.manient.remove_capture(capture=second.name) == {"FINISHED"}
    assert (len(own_camera.data.background_images), len(bpy.data.images)) == (0, 0)
    capture()
    (hand,) = hands()
    bpy.data.objects.remove(own_camera)
    assert bpy.ops.manient.remove_capture(capture=hand.collection.name) == {"FINISHED"}
    assert not bpy.data.armatures


@needs_capture
def test_bones_are_selected_for_the_timeline(settings, photo):
    settings.source = str(photo)
    capture()
    (hand,) = hands()

    timeline = next(area for area in bpy.context.screen.areas if area.type == "DOPESHEET_EDITOR")
    with bpy.context.temp_override(area=timeline, region=timeline.regions[-1]):
        assert timeline.spaces.active.dopesheet.show_only_selected
        keyed = {curve.data_path.split('"')[1] for curve in bpy.context.visible_fcurves}
    assert keyed == set(hand.rig.bones)

    def selected() -> list[str]:
        bpy.ops.object.mode_set(mode="POSE")
        names = [bone.name for bone in bpy.context.selected_pose_bones]
        bpy.ops.object.mode_set(mode="OBJECT")
        return names

    bones = hand.armature.pose.bones
    for bone in bones if hasattr(bones[0], "select") else hand.armature.data.bones:
        bone.select = bone.name == "wrist.R"
    settings.target = "POSE"
    capture()
    assert selected() == ["wrist.R"], "the artist's selection"


@needs_capture
def test_the_list_of_captures_and_its_buttons(settings, photo):
    settings.source = str(photo)
    capture()
    (hand,) = hands()
    for obj in bpy.context.scene.objects:
        obj.select_set(False)
    bpy.context.view_layer.objects.active = None
    assert bpy.ops.manient.select_hand(hand=hand.armature.name) == {"FINISHED"}
    assert bpy.context.view_layer.objects.active == hand.armature
    assert hand.armature.select_get()
    hand.armature.hide_set(True)
    with pytest.raises(RuntimeError, match="hidden"):
        bpy.ops.manient.select_hand(hand=hand.armature.name)
    with pytest.raises(RuntimeError, match="not in this scene"):
        bpy.ops.manient.select_hand(hand="nobody")

    waiting = [submitted() for _ in range(2)]
    assert bpy.ops.manient.cancel_capture(index=1) == {"FINISHED"}
    assert [job.state for job in waiting] == ["cancelled", "waiting"]
    assert bpy.ops.manient.cancel_capture() == {"FINISHED"}
    assert not jobs.busy()
    assert bpy.ops.manient.clear_captures() == {"FINISHED"}
    assert jobs.jobs() == ()
