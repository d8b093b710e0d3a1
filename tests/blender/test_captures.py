"""Captures in a scene: which is active and shown, what goes when one is removed, and which scenes take over
the footage's rate, range, size and camera."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

import blender_manient
from blender_manient.rigs import rig_of
from blender_manient.scene import captures, store
from blender_manient.scene.keys import read_pose_keys
from blender_manient.scene.matching import Footage, clear_view, matches, scene_sentence, why_kept
from blender_manient.session import source_info
from handfit_core.media.source import Source

from .characters import one_handed
from .conftest import FRAMES, HEIGHT, WIDTH
from .test_live_link import alike


@pytest.fixture(autouse=True)
def start_up_file(empty_file):
    """The file that Blender starts with."""
    blender_manient.register()
    bpy.ops.wm.read_factory_settings()
    yield
    blender_manient.unregister()


def brought_in(take, tmp_path, **choices):
    """The armature of one hand that importing the take builds."""
    before = set(bpy.data.objects)
    path = str(take.save(tmp_path / "hand.take.npz"))
    assert bpy.ops.manient.import_take(filepath=path, **choices) == {"FINISHED"}
    return next(o for o in set(bpy.data.objects) - before if o.type == "ARMATURE")


@pytest.fixture
def imported(make_take, picture, tmp_path):
    """imported(stem, matching="AUTO", **fields of the take) -> the collection that importing it builds."""

    def bring(stem: str, matching: str = "AUTO", **fields):
        file = tmp_path / f"{stem}.png"
        file.write_bytes(picture.read_bytes())
        take = make_take(**{"sides": ("right",), "source": Source("video", (str(file),)), **fields}).take
        return brought_in(take, tmp_path, matching=matching).manient.capture

    return bring


def chosen(capture) -> None:
    """Click a row of the list."""
    bpy.context.scene.manient_capture = bpy.data.collections.find(capture.name)


def seen(*found) -> list[bool]:
    """Which captures viewports and renders show: both or neither."""
    bpy.context.view_layer.update()
    shown = [captures.is_shown(c, bpy.context.view_layer) for c in found]
    assert shown == [not c.hide_render for c in found]
    assert shown == [armature_of(c).visible_get() for c in found]
    return shown


def armature_of(capture) -> bpy.types.Object:
    return next(o for o in capture.objects if o.type == "ARMATURE")


def test_a_click_shows_one_and_hides_the_other(imported):
    scene = bpy.context.scene
    a, b = imported("a"), imported("b")
    assert captures.captures(scene) == [a, b]
    assert seen(a, b) == [False, True], "the last one is active"
    assert scene.camera == b.manient.camera
    chosen(a)
    assert seen(a, b) == [True, False]
    assert scene.camera == a.manient.camera
    assert bpy.data.collections[scene.manient_capture] == a
    assert bpy.ops.manient.hide_captures(hide=False) == {"FINISHED"}
    assert seen(a, b) == [True, True]
    chosen(b)
    assert seen(a, b) == [True, True], "who shows all goes on seeing all"
    assert scene.camera == b.manient.camera
    bpy.ops.manient.hide_captures()
    assert seen(a, b) == [False, True]


def test_size_and_time_follow_while_they_are_the_footages(imported):
    scene = bpy.context.scene
    a = imported("a", fps=30.0)
    b = imported("b", matching="MATCH", fps=50.0, width=320, frame_numbers=FRAMES + 100)
    assert (scene.render.fps, scene.frame_start, scene.render.resolution_x) == (50, FRAMES[0] + 100, 320)
    chosen(a)
    assert (scene.render.fps, scene.frame_start, scene.render.resolution_x) == (30, FRAMES[0], WIDTH)
    assert scene.frame_start <= scene.frame_current <= scene.frame_end
    scene.render.resolution_x, scene.frame_end = 1920, 500
    chosen(b)
    assert (scene.render.fps, scene.frame_end, scene.render.resolution_x) == (30, 500, 1920), "the artist's"
    assert scene.camera == b.manient.camera


@pytest.mark.parametrize("why", ["own camera", "Keep", "pose mode"])
def test_the_artists_view_is_not_taken(imported, why):
    scene = bpy.context.scene
    a = imported("a")
    if why == "own camera":
        own_camera(scene)
    camera = scene.camera
    if why == "pose mode":
        bpy.context.view_layer.objects.active = armature_of(a)
        bpy.ops.object.mode_set(mode="POSE")
    b = imported("b", matching="KEEP" if why == "Keep" else "AUTO", fps=50.0)
    assert seen(a, b) == [True, True]
    assert scene.camera == camera
    if why == "own camera":
        bpy.ops.manient.hide_captures()
        for one, other in ((a, b), (b, a)):
            chosen(one)
            assert seen(one, other) == [True, False]
            assert scene.camera == camera
            assert captures.active_capture(scene) == one


def blocks() -> set[str]:
    kinds = "objects collections actions armatures meshes cameras lights images materials shape_keys".split()
    return {f"{kind}/{block.name}" for kind in kinds for block in getattr(bpy.data, kind)}


def test_removing_leaves_nothing_and_the_other_comes_back(imported, model):
    scene = bpy.context.scene
    a = imported("a", model=model)
    before, camera = blocks(), scene.camera
    b = imported("b", model=model, source=Source("photo", (a.manient.camera.name,)), frame_numbers=FRAMES)
    bpy.context.view_layer.objects.active = armature = armature_of(b)
    armature.select_set(True)
    assert bpy.ops.manient.simplify_keys() == {"FINISHED"}
    assert any(action.use_fake_user for action in bpy.data.actions)
    bpy.ops.object.mode_set(mode="POSE")
    assert bpy.ops.manient.remove_capture(capture=b.name) == {"FINISHED"}
    assert blocks() == before
    assert scene.camera == camera
    assert seen(a) == [True]
    assert bpy.context.mode == "OBJECT"


def test_what_is_not_the_captures_stays(imported, tmp_path):
    """Where it stood: in the capture's collection or in another one, on a hand that is hidden or copied."""
    a = imported("a")
    armature = armature_of(a)
    armature.location = (3.0, 0.0, 0.0)
    props = bpy.data.collections.new("props")
    bpy.context.scene.collection.children.link(props)
    a.children.link(bpy.data.collections.new("inner"))
    for collection in (a, props):
        prop = bpy.data.objects.new(f"prop of {collection.name}", None)
        prop.parent, prop.location = armature, (0.0, 2.0, 0.0)
        collection.objects.link(prop)
    copy, skin = armature.copy(), armature.children[0].copy()
    skin.parent = copy
    for thing in (copy, skin):
        a.objects.link(thing)
    names = [thing.name for thing in (copy, skin)]
    imported("b")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert bpy.data.collections["a"].hide_viewport
    bpy.context.view_layer.update()
    scene, other = bpy.context.scene, bpy.data.scenes.new("other")
    other.collection.children.link(bpy.data.collections["b"])
    for name in "ab":
        bpy.ops.manient.remove_capture(capture=name)
    assert [c.name for c in captures.captures(other)] == ["b"], "another scene keeps what it shares"
    bpy.context.view_layer.update()
    assert {"prop of a", *names} <= set(scene.collection.objects.keys())
    assert "inner" in scene.collection.children
    assert store.hand_of(bpy.data.objects[names[0]]) is not None
    for name in ("prop of a", "prop of props"):
        place = bpy.data.objects[name].matrix_world.translation
        np.testing.assert_allclose(place, (3.0, 2.0, 0.0), atol=1e-5)


ODD = {
    "renamed": lambda _, b: setattr(b, "name", "other"),
    "unlinked": lambda scene, b: scene.collection.children.unlink(b),
    "deleted": lambda _, b: bpy.data.collections.remove(b),
    "damaged": lambda _, b: setattr(b.manient, "digest", b.manient.digest[::-1]),
    "excluded": lambda *_: setattr(bpy.context.view_layer.layer_collection.children["b"], "exclude", True),
}


@pytest.mark.parametrize("how", ODD)
def test_odd_captures_raise_nothing(imported, how):
    scene = bpy.context.scene
    imported("a")
    b = imported("b")
    bpy.ops.manient.hide_captures(hide=False)
    ODD[how](scene, b)
    found = captures.captures(scene)
    assert len(found) == (1 if how in ("unlinked", "deleted") else 2)
    for capture in found:
        captures.in_words(bpy.context.scene, capture)
        chosen(capture)
        assert captures.active_capture(scene) == capture
        assert captures.is_shown(capture, bpy.context.view_layer)
    for capture in list(found):
        bpy.ops.manient.remove_capture(capture=capture.name)
    assert captures.captures(scene) == []
    assert scene.manient_capture == -1


def test_a_hidden_hand_moves_a_character(imported):
    a = imported("a")
    imported("b", sides=("left",))
    hand = store.hand_of(armature_of(a))
    assert not hand.armature.visible_get()
    target = one_handed(bend=0.4, stretch=0.2)
    bpy.context.view_layer.objects.active = target
    assert bpy.ops.manient.apply_to_character() == {"FINISHED"}
    assert target.animation_data.action.frame_range[:] == (FRAMES[0], FRAMES[-1])
    chosen(a)  # directions() looks at what is evaluated
    assert all(alike(hand, target, frame) for frame in (3, 5, 14))


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
    assert told.startswith(f"Scene stays, hand at frame 41, {rate} fps. It stays, as ")
    assert told.endswith(". The clip of 30 fps is retimed to it")
    brought_in(clip, tmp_path)
    assert state() == before


def test_the_start_up_scene_is_matched(clip, tmp_path):
    scene = bpy.context.scene
    scene.frame_set(41)
    told = scene_sentence(scene, "AUTO", Footage.of_take(clip), 41)
    news = f"30 fps, {FRAMES[0]}-{FRAMES[-1]}, {WIDTH}×{HEIGHT}"
    assert told == f"Scene: {news}. It looks through the footage's camera"
    armature = brought_in(clip, tmp_path)
    assert (scene.render.fps, scene.frame_start, scene.frame_end) == (30, FRAMES[0], FRAMES[-1])
    assert (scene.render.resolution_x, scene.render.resolution_y) == (WIDTH, HEIGHT)
    assert scene.camera == armature.manient.capture.manient.camera


def test_the_choice_is_the_artists(clip, tmp_path):
    scene = bpy.context.scene
    before = state()
    brought_in(clip, tmp_path, matching="KEEP")
    assert state() == before
    scene.frame_end, scene.frame_start = 1120, 1001
    assert not matches(scene, "AUTO", Footage.of_take(clip))
    brought_in(clip, tmp_path, matching="MATCH")
    assert (scene.render.fps, scene.frame_end) == (30, FRAMES[-1])


@pytest.mark.parametrize("frame", [FRAMES[0], 10])
def test_a_second_clip_leaves_the_first_ones_time_alone(clip, make_take, picture, tmp_path, frame):
    brought_in(clip, tmp_path)
    scene = bpy.context.scene
    scene.frame_set(frame)
    before = state()
    other = make_take(sides=("left",), source=Source("video", (str(picture),)), fps=50.0).take
    assert "right hand of photo of a hand is animated" in why_kept(scene, Footage.of_take(other))
    armature = brought_in(other, tmp_path)
    assert state()[:2] == before[:2]
    assert scene.camera == armature.manient.capture.manient.camera, "it is looked at, the first one is hidden"


def test_a_picture_has_no_time(make_take, clip, tmp_path):
    """A clip may follow it, but a shot that the artist has set keeps its time for both."""
    scene, picture = bpy.context.scene, make_take(sides=("right",), frame_numbers=np.array([7])).take
    for _ in range(2):
        brought_in(picture, tmp_path)
        assert (scene.frame_start, scene.frame_end, scene.render.resolution_x) == (1, 250, WIDTH)
    scene.frame_start, scene.frame_end = 1001, 1120
    scene.frame_set(1040)
    before = state()
    armature = brought_in(picture, tmp_path)
    assert state()[:2] == before[:2]
    assert read_pose_keys(rig_of(armature)).frames.tolist() == [1040]
    assert why_kept(scene, Footage.of_take(clip)) == "it has settings of its own"
    scene.frame_start, scene.frame_end = 1, 250
    brought_in(clip, tmp_path)
    assert (scene.render.fps, scene.frame_end) == (30, FRAMES[-1])


def test_all_that_matching_changes_is_said(clip):
    scene, footage = bpy.context.scene, Footage.of_take(clip)
    told = scene_sentence(scene, "MATCH", footage, 1)
    for word in ("30 fps", f"{FRAMES[0]}-{FRAMES[-1]}", f"{WIDTH}×{HEIGHT}", "camera"):
        assert word in told
    info = source_info.SourceInfo(
        "", False, source_info.SourceFiles("video", ("a.mp4",)), width=64, height=48
    )
    info.fps, info.first, info.last = 25.0, 1, 60
    whole, one = (source_info.footage(scene.manient, info, only=only) for only in (None, 7))
    # Before a camera of the scene's own its size stays, and a picture or one frame has no time.
    for matching, known, expected in (
        ("AUTO", whole, "Scene: 25 fps, 1-60, 64×48. It looks through the footage's camera"),
        ("AUTO", one, "Scene: 64×48. It looks through the footage's camera"),
        ("MATCH", Footage.of_take(clip, own_camera=True), "Scene: 30 fps, 3-18"),
        ("KEEP", None, "Scene stays, hand at frame 7, 24 fps"),
    ):
        assert scene_sentence(scene, matching, known, 7) == expected


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


def test_the_start_up_cube_is_hidden(capture):
    thing, layer = cube(), bpy.context.view_layer
    said = "Cube is hidden now, in renders too, since the capture's camera stands inside it"
    assert clear_view(*capture, layer) == [said]
    assert thing.hide_get()
    assert thing.hide_render
    assert clear_view(*capture, layer) == []


@pytest.mark.parametrize("options", [{"name": "Room"}, {"size": 5.0, "location": (0.5, 0.0, 0.0)}])
def test_what_the_artist_has_made_is_only_named(capture, options):
    """And what stands elsewhere or is seen through is not."""
    thing = cube(**options)
    cube("Elsewhere", location=(3.0, 0.0, 0.0))
    cube("Bounds").display_type = "BOUNDS"
    cube("Hidden").hide_set(True)
    cube("Flat", scale=(1.0, 1.0, 0.0))
    own = cube("Own")
    own.users_collection[0].objects.unlink(own)
    capture[1].objects.link(own)
    said = f"the capture's camera stands inside {thing.name}: hide that to see the picture"
    assert clear_view(*capture, bpy.context.view_layer) == [said]
    assert not thing.hide_get()
