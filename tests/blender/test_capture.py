"""The capture operator without a window: it waits for the worker and builds what it found."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view

from blender_manient.operators.capture import new_job
from blender_manient.panels.capture import MANIENT_PT_capture
from blender_manient.scene.store import captured_hands, hand_of
from blender_manient.session import jobs, shared_worker
from handfit_core.common.errors import HandfitError
from handfit_core.common.skeleton import FINGERS
from tests.capturing import needs_capture
from tests.drawn import drawn

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
    job = new_job(bpy.context, only_frame=False)
    jobs.submit(job)
    return job


def test_stop_takes_the_place_of_capture_and_is_grey_while_hands_are_built(photo, settings):
    settings.source = str(photo)
    job = submitted()
    try:
        for state, said in (("capturing", "Stop"), ("capturing", "Stopping"), ("building", "Building Hands")):
            vars(job).update(state=state, _stopping=said != "Stop")
            page = drawn(MANIENT_PT_capture)
            assert said in page.rows
            assert "Capture" not in page.rows
            assert (said in page.grey) == (said != "Stop")
    finally:
        job.state = "done"
        jobs.abandon()


def tick_until(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, [(j.state, j.message) for j in jobs.jobs()]
        jobs.tick()
        time.sleep(0.002)


@needs_capture
def test_photo(photo, settings):
    settings.source, settings.add_controls = str(photo), True
    capture()
    (hand,) = hands()
    assert (hand.side, len(hand.take.frame_numbers)) == ("right", 1)
    assert hand.track.refinable
    assert hand.armature.manient.wrist == "forearm"
    assert bpy.context.view_layer.objects.active == hand.armature
    assert bpy.context.scene.camera == hand.camera
    (job,) = jobs.jobs()
    assert (job.state, job.message) == ("done", "1 hand in 1 frame")
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
    assert not job.matched
    assert job.scene_message == "Hand came at frame 1010, 24 fps: the scene stays as it is"
    settings.matching = "MATCH"
    capture()
    assert (scene.frame_start, scene.frame_end) == (3, 6)
    assert jobs.jobs()[-1].scene_message.startswith("Scene became ")


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
    assert job.state == "done", job.message
    assert (len(hands()), bool(job.warnings)) == (1, what != "renamed")


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
        new_job(bpy.context, only_frame=False)
    assert shared_worker.current() is None or not shared_worker.current().alive


def test_settings_become_the_options_of_the_worker(settings):
    settings.source = str(SAMPLE / "hand.0001.jpg")
    settings.preset, settings.experiment = "PAPER", "paper-c"
    settings.use_hand_length, settings.hand_length = True, 17.0
    settings.camera, settings.focal_length = "FOCAL", 72.0
    options = new_job(bpy.context, only_frame=False).options.to_message()
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
        options = new_job(bpy.context, only_frame=False).options.to_message()
        others = ("quality", "plain_detection", "solver")
        assert {name: value for name, value in options.items() if name in others} == expected


def test_the_cameras_background_clip_as_source(settings, tmp_path):
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    assert not bpy.ops.manient.use_background_clip.poll()
    bpy.context.scene.camera = camera
    camera.data.background_images.new().image = bpy.data.images.new("Beside", 8, 8)
    assert not bpy.ops.manient.use_background_clip.poll()
    picture = Path(shutil.copy(SAMPLE / "hand.0002.jpg", tmp_path))
    background = camera.data.background_images.new()
    background.source, background.clip = "MOVIE_CLIP", bpy.data.movieclips.load(str(picture))
    assert bpy.ops.manient.use_background_clip() == {"FINISHED"}
    assert settings.source == str(picture)
    picture.unlink()
    with pytest.raises(RuntimeError, match="not there any more"):
        bpy.ops.manient.use_background_clip()


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
