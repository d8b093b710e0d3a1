"""Several captures in one scene: which is active, what is shown, and what goes when one is removed."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

import blender_manient
from blender_manient.scene import captures, store
from blender_manient.scene.characters import keep_map
from blender_manient.scene.render_setup import OURS
from handfit_core.media.source import Source

from .characters import build_armature, hand_specs, map_of
from .conftest import FRAMES, WIDTH
from .test_live_link import alike, curl, settle


@pytest.fixture(autouse=True)
def start_up_file(empty_file):
    """The file that Blender starts with."""
    blender_manient.register()
    bpy.ops.wm.read_factory_settings()
    yield
    blender_manient.unregister()


@pytest.fixture
def imported(make_take, picture, tmp_path):
    """imported(stem, matching="AUTO", **fields of the take) -> the collection that importing it builds."""

    def bring(stem: str, matching: str = "AUTO", **fields):
        file = tmp_path / f"{stem}.png"
        if not file.exists():
            file.write_bytes(picture.read_bytes())
        take = make_take(**{"sides": ("right",), "source": Source("video", (str(file),)), **fields}).take
        before = set(bpy.data.collections)
        saved = str(take.save(tmp_path / "x.take.npz"))
        assert bpy.ops.manient.import_take(filepath=saved, matching=matching) == {"FINISHED"}
        (made,) = set(bpy.data.collections) - before
        return made

    return bring


def chosen(capture) -> None:
    """Click a row of the list."""
    bpy.context.scene.manient_capture = bpy.data.collections.find(capture.name)


def seen(*found) -> list[bool]:
    """Which captures viewports and renders show: both or neither."""
    bpy.context.view_layer.update()
    shown = [captures.is_shown(c, bpy.context.view_layer) for c in found]
    assert shown == [not c.hide_render for c in found]
    armatures = [next(o for o in c.objects if o.type == "ARMATURE") for c in found]
    assert shown == [armature.visible_get() for armature in armatures]
    return shown


def shot_camera():
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Shot Camera", bpy.data.cameras.new("Shot Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    return camera


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
    assert bpy.context.active_object in a.objects.values()
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


def test_a_second_clip_keeps_the_time_and_brings_its_camera_lights_and_picture(imported):
    scene = bpy.context.scene
    a = imported("a", fps=30.0)
    b = imported("b", fps=50.0, width=320)
    assert scene.render.fps == 30
    assert scene.render.resolution_x == 320, "its picture fills the frame"
    kinds = {o.type for o in b.objects if OURS in o and not o.hide_render}
    assert kinds == {"LIGHT"} | ({"MESH"} if b.manient.camera.data.background_images else set())
    chosen(a)
    assert scene.render.resolution_x == WIDTH


@pytest.mark.parametrize("why", ["own camera", "Keep", "pose mode"])
def test_the_artists_view_is_not_taken(imported, why):
    scene = bpy.context.scene
    a = imported("a")
    camera = shot_camera() if why == "own camera" else scene.camera
    if why == "pose mode":
        bpy.context.view_layer.objects.active = next(o for o in a.objects if o.type == "ARMATURE")
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


def test_what_the_artist_hid_stays_hidden(imported):
    a, b = imported("a"), imported("b")
    chosen(a)
    mesh = next(o for o in a.objects if o.type == "MESH" and OURS not in o)
    mesh.hide_set(True)
    a.hide_render = True
    chosen(b)
    chosen(a)
    assert mesh.hide_get()
    assert a.hide_render
    assert not a.hide_viewport


def test_undo_is_one_step(imported):
    imported("a"), imported("b")
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.manient.hide_captures(hide=False)
    bpy.ops.ed.undo_push(message="Show All")
    bpy.ops.ed.undo()
    assert seen(*(bpy.data.collections[n] for n in "ab")) == [False, True]
    bpy.ops.manient.remove_capture(capture="b")
    bpy.ops.ed.undo_push(message="Remove Capture")
    bpy.ops.ed.undo()
    a, b = (bpy.data.collections[n] for n in "ab")
    assert seen(a, b) == [False, True]
    assert bpy.context.scene.camera == b.manient.camera
    assert len(store.captured_hands(bpy.context.scene)) == 2


def blocks() -> set[str]:
    kinds = "objects collections actions armatures meshes cameras lights images materials shape_keys".split()
    return {f"{kind}/{block.name}" for kind in kinds for block in getattr(bpy.data, kind)}


def test_removing_leaves_nothing_and_the_other_comes_back(imported, model):
    scene = bpy.context.scene
    a = imported("a", model=model)
    before, camera = blocks(), scene.camera
    bpy.context.view_layer.objects.active = None
    b = imported("b", model=model, source=Source("photo", (a.manient.camera.name,)), frame_numbers=FRAMES)
    armature = next(o for o in b.objects if o.type == "ARMATURE")
    bpy.context.view_layer.objects.active = armature
    armature.select_set(True)
    assert bpy.ops.manient.simplify_keys() == {"FINISHED"}
    assert any(action.use_fake_user for action in bpy.data.actions)
    bpy.ops.object.mode_set(mode="POSE")
    assert bpy.ops.manient.remove_capture(capture=b.name) == {"FINISHED"}
    assert blocks() == before
    assert scene.camera == camera
    assert seen(a) == [True]
    assert bpy.context.mode == "OBJECT"


def test_what_is_not_the_captures_stays(imported):
    scene, layer = bpy.context.scene, bpy.context.view_layer
    a = imported("a")
    armature = next(o for o in a.objects if o.type == "ARMATURE")
    ring = bpy.data.objects.new("ring", bpy.data.meshes.new("ring"))
    ring.parent, ring.location = armature, (0.0, 2.0, 0.0)
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
    for mine in (ring, lamp):
        a.objects.link(mine)
    inner = bpy.data.collections.new("inner")
    a.children.link(inner)
    layer.update()
    place = np.array(ring.matrix_world)
    bpy.ops.manient.remove_capture(capture="a")
    layer.update()
    assert {"ring", "lamp"} <= set(scene.collection.objects.keys())
    assert "inner" in scene.collection.children
    np.testing.assert_allclose(np.array(ring.matrix_world), place, atol=1e-6)
    assert captures.captures(scene) == []


def test_what_hangs_on_a_hidden_hand_stays_where_it_stood(imported, tmp_path):
    a = imported("a")
    armature = next(o for o in a.objects if o.type == "ARMATURE")
    armature.location = (3.0, 0.0, 0.0)
    props = bpy.data.collections.new("props")
    bpy.context.scene.collection.children.link(props)
    for collection in (a, props):
        prop = bpy.data.objects.new(f"prop of {collection.name}", None)
        prop.parent, prop.location = armature, (0.0, 2.0, 0.0)
        collection.objects.link(prop)
    imported("b")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert bpy.data.collections["a"].hide_viewport
    bpy.ops.manient.remove_capture(capture="a")
    bpy.context.view_layer.update()
    for name in ("prop of a", "prop of props"):
        place = bpy.data.objects[name].matrix_world.translation
        np.testing.assert_allclose(place, (3.0, 2.0, 0.0), atol=1e-5)


def test_a_copied_hand_stays(imported):
    a = imported("a")
    armature = next(o for o in a.objects if o.type == "ARMATURE")
    (mesh,) = armature.children
    copy, skin = armature.copy(), mesh.copy()
    skin.parent = copy
    for thing in (copy, skin):
        a.objects.link(thing)
    bpy.ops.manient.remove_capture(capture="a")
    assert [o.name for o in store.captured_hands(bpy.context.scene)] == [copy.name]
    assert store.hand_of(copy) is not None
    assert skin.name in bpy.context.scene.objects


def test_a_hand_that_lies_elsewhere_too_keeps_its_take(imported):
    scene = bpy.context.scene
    a = imported("a")
    armature = next(o for o in a.objects if o.type == "ARMATURE")
    mine = bpy.data.collections.new("mine")
    scene.collection.children.link(mine)
    mine.objects.link(armature)
    imported("b")
    assert armature.visible_get(), "the artist's collection shows it"
    bpy.ops.manient.remove_capture(capture="a")
    assert armature.users_collection == (mine,)
    assert store.hand_of(armature) is not None
    assert [c.name for c in captures.captures(scene)] == ["b"]


def test_another_scene_keeps_what_it_shares(imported):
    a = imported("a")
    other = bpy.data.scenes.new("other")
    other.collection.children.link(a)
    bpy.ops.manient.remove_capture(capture="a")
    assert captures.captures(bpy.context.scene) == []
    assert captures.captures(other) == [a]
    assert len(store.captured_hands(other)) == 1


@pytest.mark.parametrize(
    "how", ["renamed", "nested", "unlinked", "deleted", "damaged", "excluded", "linked twice"]
)
def test_old_and_odd_captures_raise_nothing(imported, how, tmp_path):
    scene = bpy.context.scene
    imported("a")
    b = imported("b")
    bpy.ops.manient.hide_captures(hide=False)
    for name in ("capture", "rendered_camera"):  # as a file of before knows nothing of this
        scene.manient.property_unset(name)
    parent = bpy.data.collections.new("parent")
    scene.collection.children.link(parent)
    if how == "renamed":
        b.name = "other"
    elif how == "nested":
        scene.collection.children.unlink(b)
        parent.children.link(b)
    elif how == "unlinked":
        scene.collection.children.unlink(b)
    elif how == "deleted":
        bpy.data.collections.remove(b)
    elif how == "damaged":
        b.manient.digest = b.manient.digest[::-1]
    elif how == "excluded":
        bpy.context.view_layer.layer_collection.children["b"].exclude = True
    elif how == "linked twice":
        parent.children.link(b)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "old.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "old.blend"))
    scene = bpy.context.scene
    found = captures.captures(scene)
    assert len(found) == (1 if how in ("unlinked", "deleted") else 2)
    for capture in found:
        captures.facts(capture)
        chosen(capture)
        assert captures.active_capture(scene) == capture
        assert captures.is_shown(capture, bpy.context.view_layer)
        if len(found) > 1:
            bpy.ops.manient.hide_captures()
    for capture in list(found):
        bpy.ops.manient.remove_capture(capture=capture.name)
    assert captures.captures(scene) == []
    assert scene.manient_capture == -1


@pytest.mark.parametrize("how", ["applied", "linked"])
def test_a_hidden_hand_moves_a_character_and_is_exported(imported, how, tmp_path):
    a = imported("a")
    imported("b", source=Source("data", (str(tmp_path / "b.json"),)), sides=("left",))
    hand = store.hand_of(next(o for o in a.objects if o.type == "ARMATURE"))
    assert hand is not None
    assert not hand.armature.visible_get()
    target = build_armature(hand_specs("right", np.random.default_rng(3), bend=0.4, stretch=0.2))
    keep_map(target, map_of("right"))
    character = target.manient.character
    character.contacts = False
    bpy.context.view_layer.objects.active = target
    if how == "applied":
        assert bpy.ops.manient.apply_to_character() == {"FINISHED"}
    else:
        character.live = True
        settle()
        curl(hand, 5)
        captures.show(bpy.context.scene, a)
        settle()
        captures.hide_others(bpy.context.scene)
    assert target.animation_data.action.frame_range[:] == (FRAMES[0], FRAMES[-1])
    chosen(a)  # directions() looks at what is evaluated
    assert all(alike(hand, target, frame) for frame in (3, 5, 14))
    chosen(bpy.data.collections["b"])
    bpy.context.view_layer.objects.active = hand.armature  # in the Outliner
    file = str(tmp_path / "hand.fbx")
    assert bpy.ops.manient.export_hand(filepath=file, file_format="fbx") == {"FINISHED"}
    before = set(bpy.data.objects)
    bpy.ops.import_scene.fbx(filepath=file)
    assert {o.type for o in set(bpy.data.objects) - before} == {"ARMATURE", "MESH"}
