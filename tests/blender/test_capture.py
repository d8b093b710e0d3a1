"""The capture operator without a window: it waits for the worker and builds what it found."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from blender_manient.operators.capture import new_job  # noqa: E402
from blender_manient.scene.store import captured_hands, hand_of  # noqa: E402
from blender_manient.session import jobs, shared_worker  # noqa: E402
from handfit_core.errors import HandfitError  # noqa: E402
from handfit_core.skeleton import FINGERS  # noqa: E402
from tests.capturing import needs_capture  # noqa: E402

pytestmark = pytest.mark.usefixtures("registered")

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rendered_hand"


@pytest.fixture
def photo(tmp_path) -> Path:
    return Path(shutil.copy(SAMPLE / "hand.0001.jpg", tmp_path / "my hand.jpg"))


@pytest.fixture
def settings():
    return bpy.context.scene.manient


def _hands():
    return [hand_of(armature) for armature in captured_hands(bpy.context.scene)]


@needs_capture
def test_photo(photo, settings):
    settings.source = str(photo)
    assert bpy.ops.manient.capture() == {"FINISHED"}
    (hand,) = _hands()
    assert (hand.side, len(hand.take.frame_numbers)) == ("right", 1)
    assert hand.track.refinable
    assert hand.armature.manient.wrist == "forearm"
    assert bpy.context.view_layer.objects.active == hand.armature
    assert bpy.context.scene.camera == hand.camera
    (job,) = jobs.jobs()
    assert (job.state, job.message) == ("done", "1 hand in 1 frame")


@needs_capture
def test_new_hands_have_controls_where_that_is_asked_for(photo, settings):
    settings.source, settings.add_controls = str(photo), True
    assert bpy.ops.manient.capture() == {"FINISHED"}
    (hand,) = _hands()
    assert set(FINGERS) < set(hand.rig.controls)
    bpy.ops.manient.remove_controls()
    settings.add_controls = False
    assert bpy.ops.manient.capture() == {"FINISHED"}
    assert not any(hand.rig.controls for hand in _hands())


@needs_capture
def test_sequence_range_and_single_frame(settings):
    settings.source = str(SAMPLE / "hand.0003.jpg")
    settings.as_sequence = True
    settings.use_frames, settings.first_frame, settings.last_frame, settings.frame_step = True, 3, 9, 3
    assert bpy.ops.manient.capture() == {"FINISHED"}
    assert list(_hands()[0].take.frame_numbers) == [3, 6, 9]
    bpy.context.scene.frame_set(5)
    assert bpy.ops.manient.capture(only_frame=True) == {"FINISHED"}
    assert sorted(len(h.take.frame_numbers) for h in _hands()) == [1, 3]


@needs_capture
def test_a_shot_keeps_its_time_and_the_hand_begins_where_the_button_was_pressed(settings):
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1001, 1120
    scene.frame_set(1010)
    settings.source = str(SAMPLE)
    settings.use_frames, settings.first_frame, settings.last_frame = True, 3, 6
    job = new_job(bpy.context, only_frame=False)
    jobs.submit(job)
    _tick_until(lambda: job.state == "building")
    scene.frame_set(1050)
    _tick_until(lambda: job.finished)
    assert job.state == "done", job.message
    (hand,) = _hands()
    assert (scene.frame_start, scene.frame_end, scene.frame_current) == (1001, 1120, 1050)
    assert (scene.render.fps, scene.render.resolution_x, scene.camera) == (24, 1920, None)
    action = hand.armature.animation_data.action
    assert tuple(action.frame_range) == (1010.0, 1013.0)
    assert not job.matched
    assert job.scene_message == "Hand came at frame 1010, 24 fps: the scene stays as it is"
    settings.matching = "MATCH"
    assert bpy.ops.manient.capture() == {"FINISHED"}
    assert (scene.frame_start, scene.frame_end) == (3, 6)
    assert jobs.jobs()[-1].scene_message.startswith("Scene became ")


@needs_capture
def test_onto_a_hand_that_is_there(settings, photo):
    settings.source = str(SAMPLE)
    settings.use_frames, settings.first_frame, settings.last_frame = True, 1, 4
    bpy.ops.manient.capture()
    (hand,) = _hands()
    bone = hand.armature.pose.bones["index_proximal.R"]
    bpy.context.scene.frame_set(20)
    before = np.array(bone.rotation_quaternion)
    settings.source, settings.target = str(SAMPLE / "hand.0016.jpg"), "POSE"
    settings.as_sequence = False
    assert bpy.ops.manient.capture() == {"FINISHED"}
    bpy.context.scene.frame_set(20)
    assert len(_hands()) == 1
    assert np.abs(np.array(bone.rotation_quaternion) - before).max() > 0.02


@needs_capture
def test_through_the_scenes_own_camera(settings, photo):
    data = bpy.data.cameras.new("own")
    camera = bpy.data.objects.new("own", data)
    camera.location, camera.rotation_euler = (1.0, 2.0, 3.0), (1.1, 0.2, 0.3)
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = 640, 480
    bpy.context.view_layer.update()
    settings.source, settings.camera = str(photo), "ACTIVE"
    assert bpy.ops.manient.capture() == {"FINISHED"}
    (hand,) = _hands()
    assert bpy.context.scene.camera == camera == hand.camera
    bpy.context.view_layer.update()

    from bpy_extras.object_utils import world_to_camera_view

    wrist = hand.armature.matrix_world @ hand.armature.pose.bones["wrist.R"].head
    seen = world_to_camera_view(bpy.context.scene, camera, wrist)
    expected = hand.track.keypoints_2d[0, 0]
    assert [seen.x * 640, (1 - seen.y) * 480] == pytest.approx(list(expected), abs=25.0)
    assert seen.z > 0.1


@needs_capture
@pytest.mark.parametrize("gone", [False, True])
def test_a_hand_that_is_renamed_meanwhile_is_found_and_one_that_is_gone_is_built_anew(settings, photo, gone):
    settings.source = str(photo)
    bpy.ops.manient.capture()
    settings.target = "POSE"
    job = new_job(bpy.context, only_frame=False)
    jobs.submit(job)
    _tick_until(lambda: job.state == "capturing")
    armature = _hands()[0].armature
    armature.name = "another name"
    if gone:
        bpy.data.objects.remove(armature)
    _tick_until(lambda: job.finished)
    assert job.state == "done", job.message
    assert (len(_hands()), bool(job.warnings)) == (1, gone)


@needs_capture
def test_a_scene_that_is_deleted_meanwhile_costs_neither_the_hands_nor_the_open_scene(settings, photo):
    settings.source = str(photo)
    first, other = bpy.context.scene, bpy.data.scenes.new("Other")
    job = new_job(bpy.context, only_frame=False)
    jobs.submit(job)
    jobs.tick()
    bpy.context.window.scene = other
    bpy.data.scenes.remove(first)
    size = (other.render.resolution_x, other.render.resolution_y, other.camera)
    _tick_until(lambda: job.finished)
    assert job.state == "done", job.message
    assert len(captured_hands(other)) == 1
    assert (other.render.resolution_x, other.render.resolution_y, other.camera) == size
    assert any("gone" in warning for warning in job.warnings)


@needs_capture
@pytest.mark.parametrize("ready", [True, False])
def test_the_first_render_is_set_up_unless_the_artist_opts_out(settings, photo, ready):
    settings.source = str(photo)
    settings.render_setup = ready
    bpy.ops.manient.capture()
    kinds = [o.type for o in _hands()[0].collection.all_objects]
    assert kinds.count("LIGHT") == (3 if ready else 0)
    assert kinds.count("MESH") == (2 if ready else 1)


@needs_capture
def test_dropped_pictures(settings):
    def dropped(*names, **options):
        files = [{"name": name} for name in names]
        result = bpy.ops.manient.drop_media(directory=str(SAMPLE), files=files, **options)
        takes = [list(hand.take.frame_numbers) for hand in _hands()]
        bpy.ops.wm.read_factory_settings(use_empty=True)
        return result, takes

    assert dropped("hand.0001.jpg", "hand.0004.jpg") == ({"FINISHED"}, [[1], [1]])
    some = [f"hand.{n:04}.jpg" for n in (3, 4, 5)]
    assert dropped(*some, as_sequence=True) == ({"FINISHED"}, [[3, 4, 5]])


@needs_capture
def test_a_painted_picture_stays_in_the_file(settings, photo, tmp_path):
    picture = bpy.data.images.load(str(photo))
    picture.pack()
    picture.filepath = ""
    bpy.ops.manient.use_source(kind="IMAGE", name=picture.name)
    copy = Path(settings.source)
    assert bpy.ops.manient.capture() == {"FINISHED"}
    plate = _hands()[0].camera.data.background_images[0].image
    copy.unlink()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert plate.packed_file


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


def test_files_and_preferences_that_are_older_keep_their_quality(settings):
    """They hold numbers: of Fast, of Best, which is Standard now, and of Paper."""
    numbers = {item.identifier: item.value for item in settings.bl_rna.properties["preset"].enum_items}
    assert numbers == {"DRAFT": 0, "STANDARD": 1, "PAPER": 2, "BEST": 3}


def test_pictures_of_the_open_file_as_sources(settings, tmp_path):
    picture = bpy.data.images.load(str(SAMPLE / "hand.0001.jpg"))
    assert bpy.ops.manient.use_source(kind="IMAGE", name=picture.name) == {"FINISHED"}
    assert settings.source == str(SAMPLE / "hand.0001.jpg")
    picture.pack()
    picture.filepath = "/nowhere/gone.jpg"
    assert bpy.ops.manient.use_source(kind="IMAGE", name=picture.name) == {"FINISHED"}
    assert Path(settings.source).is_file()
    clip = bpy.data.movieclips.load(str(SAMPLE / "hand.0002.jpg"))
    assert bpy.ops.manient.use_source(kind="CLIP", name=clip.name) == {"FINISHED"}
    assert settings.source == str(SAMPLE / "hand.0002.jpg")
    painted = bpy.data.images.new("Painted", 32, 16)
    painted.pixels.foreach_set(np.tile([1.0, 0.5, 0.0, 1.0], 32 * 16).astype(np.float32))
    assert bpy.ops.manient.use_source(kind="IMAGE", name=painted.name) == {"FINISHED"}
    written = bpy.data.images.load(settings.source)
    assert tuple(written.size) == (32, 16)
    assert list(written.pixels[:4]) == pytest.approx([1.0, 0.5, 0.0, 1.0], abs=0.01)
    assert painted.filepath == ""
    with pytest.raises(RuntimeError, match="no image"):
        bpy.ops.manient.use_source(kind="IMAGE", name="nothing")


def _tick_until(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, [(j.state, j.message) for j in jobs.jobs()]
        jobs.tick()
        time.sleep(0.002)


@needs_capture
def test_the_list_of_captures_and_its_buttons(settings, photo):
    settings.source = str(photo)
    bpy.ops.manient.capture()
    (hand,) = _hands()
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

    waiting = [new_job(bpy.context, only_frame=False) for _ in range(2)]
    for job in waiting:
        jobs.submit(job)
    assert bpy.ops.manient.cancel_capture(index=1) == {"FINISHED"}
    assert [job.state for job in waiting] == ["cancelled", "waiting"]
    assert bpy.ops.manient.cancel_capture() == {"FINISHED"}
    assert not jobs.busy()
    assert bpy.ops.manient.clear_captures() == {"FINISHED"}
    assert jobs.jobs() == ()
