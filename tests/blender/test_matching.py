"""Which scenes take over the footage's rate, range, size and camera, and what is said about it."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

import blender_manient
from blender_manient.rigs import rig_of
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import read_pose_keys
from blender_manient.scene.matching import Footage, clear_view, matches, scene_sentence, why_kept
from blender_manient.session import source_info
from handfit_core.media.source import Source

from .conftest import FRAMES, HEIGHT, UNSEEN, WIDTH


@pytest.fixture(autouse=True)
def start_up_file(empty_file):
    """The file that Blender starts with: a cube, a light and a camera that nobody has set up."""
    blender_manient.register()
    bpy.ops.wm.read_factory_settings()
    yield
    blender_manient.unregister()


@pytest.fixture
def clip(make_take, picture):
    """A video of 30 frames per second, whose pictures this Blender cannot read: no matter here."""
    return make_take(sides=("right",), source=Source("video", (str(picture),)), fps=30.0).take


def state() -> tuple:
    """All of the scene that matching changes."""
    scene, render = bpy.context.scene, bpy.context.scene.render
    return (
        (render.fps, render.fps_base, scene.frame_start, scene.frame_end, scene.frame_current),
        (render.resolution_x, render.resolution_y, render.pixel_aspect_x, render.pixel_aspect_y),
        scene.camera.name if scene.camera else None,
    )


def brought_in(take, tmp_path, **choices):
    """The armature that importing the take builds."""
    before = set(bpy.data.objects)
    assert bpy.ops.manient.import_take(filepath=str(take.save(tmp_path / "hand.take.npz")), **choices)
    return next(o for o in set(bpy.data.objects) - before if o.type == "ARMATURE")


def own_camera(scene):
    camera = bpy.data.objects.new("Shot Camera", bpy.data.cameras.new("Shot Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera


def animated(obj):
    obj.keyframe_insert("location", frame=1)


def pushed_down(obj):
    animated(obj)
    action, data = obj.animation_data.action, obj.animation_data
    data.action = None
    data.nla_tracks.new().strips.new("moves", 1, action)


def cut(scene):
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    strips.new_image("strip", "gone.png", 1, 1)


SIGNS = {
    "rate": (lambda s: setattr(s.render, "fps", 25), "settings of its own"),
    "range": (lambda s: setattr(s, "frame_end", 100), "settings of its own"),
    "start": (lambda s: setattr(s, "frame_start", 0), "settings of its own"),
    "size": (lambda s: setattr(s.render, "resolution_x", 1280), "settings of its own"),
    "camera": (own_camera, "its camera is Shot Camera"),
    "moved camera": (lambda s: setattr(s.camera, "location", (0, -5, 0)), "its camera is Camera"),
    "lens": (lambda s: setattr(s.camera.data, "lens", 35), "its camera is Camera"),
    "keys": (lambda s: animated(s.objects["Cube"]), "Cube is animated"),
    "light": (lambda s: s.objects["Light"].data.keyframe_insert("energy", frame=3), "Light is animated"),
    "strips": (lambda s: pushed_down(s.objects["Cube"]), "Cube is animated"),
    "material": (
        lambda s: s.objects["Cube"].active_material.keyframe_insert("roughness", frame=3),
        "Material is animated",
    ),
    "preview": (lambda s: setattr(s, "use_preview_range", True), "preview range"),
    "strip": (cut, "strips in the sequencer"),
    "marker": (lambda s: s.timeline_markers.new("cut", frame=20), "markers"),
}


@pytest.mark.parametrize("sign", SIGNS)
def test_what_tells_of_a_shot_keeps_the_scene(clip, tmp_path, sign):
    scene = bpy.context.scene
    touch, why = SIGNS[sign]
    touch(scene)
    scene.frame_set(41)
    before = state()
    assert why in why_kept(scene)
    told = scene_sentence(scene, "AUTO", Footage.of_take(clip), scene.frame_current)
    rate = scene.render.fps
    assert told.startswith(f"Hand comes at frame 41, {rate} fps: the scene stays, as ")
    assert told.endswith(". The clip of 30 fps is retimed to it")
    armature = brought_in(clip, tmp_path)
    assert state() == before
    keyed = read_pose_keys(rig_of(armature)).frames
    # Every whole frame on which the clip shows a picture with the hand has a key.
    frames = np.arange(41, 41 + int((FRAMES[-1] - FRAMES[0]) * rate / 30) + 1)
    pictures = np.floor(FRAMES[0] + (frames - 41) * 30 / rate + 0.5)
    np.testing.assert_array_equal(keyed, frames[np.isin(pictures, np.delete(FRAMES, UNSEEN))])


def test_the_start_up_scene_is_matched(clip, tmp_path):
    scene = bpy.context.scene
    scene.frame_set(41)
    told = scene_sentence(scene, "AUTO", Footage.of_take(clip), 41)
    assert (
        told == f"Scene becomes 30 fps, {FRAMES[0]}-{FRAMES[-1]}, {WIDTH}×{HEIGHT}, with the footage's camera"
    )
    armature = brought_in(clip, tmp_path)
    assert (scene.render.fps, scene.frame_start, scene.frame_end) == (30, FRAMES[0], FRAMES[-1])
    assert (scene.render.resolution_x, scene.render.resolution_y) == (WIDTH, HEIGHT)
    assert scene.camera == armature.manient.capture.manient.camera


def test_the_choice_is_the_artists(clip, tmp_path):
    scene = bpy.context.scene
    before = state()
    brought_in(clip, tmp_path, matching="KEEP")
    assert state() == before
    animated(scene.objects["Cube"])
    assert not matches(scene, "AUTO", Footage.of_take(clip))
    brought_in(clip, tmp_path, matching="MATCH")
    assert (scene.render.fps, scene.frame_end) == (30, FRAMES[-1])


def test_a_second_clip_leaves_the_first_ones_time_alone(clip, make_take, picture, tmp_path):
    brought_in(clip, tmp_path)
    scene = bpy.context.scene
    scene.frame_set(10)
    before = state()
    other = make_take(sides=("left",), source=Source("video", (str(picture),)), fps=50.0).take
    assert "right hand of photo of a hand is animated" in why_kept(scene, Footage.of_take(other))
    armature = brought_in(other, tmp_path)
    assert state()[:2] == before[:2]
    assert scene.camera == armature.manient.capture.manient.camera, "it is looked at, the first one is hidden"


def test_the_same_clip_again_lies_on_the_same_frames(clip, tmp_path):
    first = brought_in(clip, tmp_path)
    bpy.context.scene.frame_set(10)
    second = brought_in(clip, tmp_path)
    frames = [read_pose_keys(rig_of(armature)).frames.tolist() for armature in (first, second)]
    assert frames[0] == frames[1]
    # But not before a camera of the artist's.
    own_camera(bpy.context.scene)
    assert why_kept(bpy.context.scene, Footage.of_take(clip)) == "its camera is Shot Camera"


def test_pictures_follow_each_other_and_a_clip_may_follow_them(make_take, clip, tmp_path):
    scene = bpy.context.scene
    for seed in (1, 2):
        brought_in(make_take(sides=("right",), seed=seed, frame_numbers=np.array([7])).take, tmp_path)
        assert (scene.frame_start, scene.frame_end, scene.render.resolution_x) == (1, 250, WIDTH)
    brought_in(clip, tmp_path)
    assert (scene.render.fps, scene.frame_end) == (30, FRAMES[-1])


def test_a_picture_does_not_enter_a_shot_of_its_size(make_take, tmp_path):
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1001, 1120
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.frame_set(1040)
    before = state()
    armature = brought_in(make_take(sides=("right",), frame_numbers=np.array([7])).take, tmp_path)
    assert state() == before
    assert read_pose_keys(rig_of(armature)).frames.tolist() == [1040]


def test_a_scene_whose_captures_were_deleted_is_nobodys_again(clip, make_take, picture, tmp_path):
    scene = bpy.context.scene
    brought_in(clip, tmp_path)
    for obj in list(bpy.data.objects):
        if obj.type != "CAMERA":
            bpy.data.objects.remove(obj)
    assert why_kept(scene) == ""
    scene.frame_end += 1
    assert why_kept(scene) == "it has settings of its own"


@pytest.mark.parametrize("fps", [30000 / 1001, 24000 / 1001, 12.5, 25.0])
def test_a_rate_that_no_whole_number_tells_is_known_again(make_take, fps):
    take = make_take(sides=("right",), fps=fps).take
    build_take(take)
    assert Footage.of_take(take).is_applied_to(bpy.context.scene)


def test_a_pictures_shot_keeps_the_range_that_the_artist_set(make_take, clip, tmp_path):
    """Matched to a picture, which has no time, and brought a clip later."""
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1001, 1120
    brought_in(make_take(sides=("right",), frame_numbers=np.array([7])).take, tmp_path, matching="MATCH")
    assert scene.render.resolution_x == WIDTH
    assert why_kept(scene, Footage.of_take(clip)) == "it has settings of its own"
    brought_in(clip, tmp_path)
    assert (scene.frame_start, scene.frame_end) == (1001, 1120)


def test_all_that_matching_changes_is_said(clip):
    scene = bpy.context.scene
    told = scene_sentence(scene, "MATCH", Footage.of_take(clip), 1, render_setup=True)
    for word in ("30 fps", f"{FRAMES[0]}-{FRAMES[-1]}", f"{WIDTH}×{HEIGHT}", "camera", "suns", "Standard"):
        assert word in told
    own = Footage.of_take(clip, own_camera=True)
    assert (
        scene_sentence(scene, "MATCH", own, 1, render_setup=True)
        == f"Scene becomes 30 fps, {FRAMES[0]}-{FRAMES[-1]}"
    )


def test_one_frame_of_a_clip_has_no_time(clip):
    scene = bpy.context.scene
    info = source_info.SourceInfo(
        "", False, source_info.SourceFiles("video", ("a.mp4",)), width=64, height=48
    )
    info.fps, info.first, info.last = 25.0, 1, 60
    whole, one = (source_info.footage(scene.manient, info, only=only) for only in (None, 7))
    assert (
        scene_sentence(scene, "AUTO", whole, 7)
        == "Scene becomes 25 fps, 1-60, 64×48, with the footage's camera"
    )
    assert scene_sentence(scene, "AUTO", one, 7) == "Scene becomes 64×48, with the footage's camera"


def test_nothing_known_of_the_footage_is_said_without_figures():
    told = scene_sentence(bpy.context.scene, "AUTO", None, 1)
    assert told == "Scene becomes what the footage has: rate, range, size and camera"
    # Before a camera of the scene's own its size stays, and a picture has no time.
    assert scene_sentence(bpy.context.scene, "MATCH", Footage(25.0, 1, 60), 1) == "Scene becomes 25 fps, 1-60"
    assert scene_sentence(bpy.context.scene, "MATCH", Footage(25.0, 4, 4), 1) == "Hand comes at frame 4"
    assert (
        scene_sentence(bpy.context.scene, "KEEP", None, 7)
        == "Hand comes at frame 7, 24 fps: the scene stays as it is"
    )


@pytest.fixture
def capture():
    """A camera at the world's origin, in a collection of its own; nothing else."""
    bpy.data.batch_remove(list(bpy.data.objects))
    collection = bpy.data.collections.new("capture")
    bpy.context.scene.collection.children.link(collection)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    collection.objects.link(camera)
    return camera, collection


def cube(name: str = "Cube", **options) -> bpy.types.Object:
    bpy.ops.mesh.primitive_cube_add(**options)
    thing = bpy.context.view_layer.objects.active
    thing.name = name
    bpy.context.view_layer.update()
    return thing


def said_of(capture) -> list[str]:
    return clear_view(*capture, bpy.context.view_layer)


def test_the_start_up_cube_is_hidden(capture):
    thing = cube()
    assert said_of(capture) == [
        "Cube is hidden now, in renders too, since the capture's camera stands inside it"
    ]
    assert thing.hide_get()
    assert thing.hide_render
    assert said_of(capture) == []


@pytest.mark.parametrize(
    ("name", "options"), [("Room", {}), ("Cube", {"size": 5.0, "location": (0.5, 0.0, 0.0)})]
)
def test_what_the_artist_has_made_is_only_named(capture, name, options):
    thing = cube(name, **options)
    assert said_of(capture) == [f"the capture's camera stands inside {name}: hide that to see the picture"]
    assert not thing.hide_get()


def test_what_stands_elsewhere_or_is_seen_through_is_left_alone(capture):
    cube(location=(3.0, 0.0, 0.0))
    cube("Bounds").display_type = "BOUNDS"
    cube("Hidden").hide_set(True)
    cube("Flat", scale=(1.0, 1.0, 0.0))
    own = cube("Own")
    own.users_collection[0].objects.unlink(own)
    capture[1].objects.link(own)
    assert said_of(capture) == []
