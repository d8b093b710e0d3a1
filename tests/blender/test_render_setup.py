"""The first F12 after a capture: the hands, lit, in their picture."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

import blender_manient
from blender_manient.exporters.export_hands import export_take
from blender_manient.scene import render_setup
from blender_manient.scene.background import rows_of
from blender_manient.scene.build import build_take
from blender_manient.scene.matching import clear_view

from .conftest import HEIGHT, WIDTH, world


@pytest.fixture
def start_up() -> bpy.types.Scene:
    """The scene that Blender starts with."""
    bpy.ops.wm.read_factory_settings()
    return bpy.context.scene


def rendered(scene: bpy.types.Scene, path: Path) -> np.ndarray:
    """Press F12, few samples: rows (H, W, 3) of sRGB values 0..1, the first row on top."""
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 8
    scene.cycles.use_denoising = False
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    return rows_of(image)[..., :3]


def near_hands(made, row: int, reach: int) -> np.ndarray:
    """(H, W) where vertices are no further than `reach` pixels away."""
    pixels = np.concatenate([made.take.intrinsics.project(v[row]) for v in made.vertices.values()])
    near = np.zeros((HEIGHT, WIDTH), dtype=bool)
    for column, line in np.floor(pixels).astype(int).tolist():
        if -reach <= column < WIDTH + reach and -reach <= line < HEIGHT + reach:
            near[max(0, line - reach) : line + reach + 1, max(0, column - reach) : column + reach + 1] = True
    return near


@pytest.mark.parametrize("exported", [False, True])
def test_the_first_render_shows_lit_hands_in_their_picture(make_take, start_up, tmp_path, exported):
    made = make_take()
    built = build_take(made.take)
    # As the button does: the start-up cube, in which the camera stands, is out of the way.
    clear_view(built.camera, built.collection, bpy.context.view_layer)
    row, frame = made.seen[2]
    scene = start_up
    if exported:
        (path,) = export_take(built, made.take, tmp_path, "hands", "blend")
        bpy.ops.wm.open_mainfile(filepath=str(path))
        scene = bpy.data.scenes["photo of a hand"]
    scene.frame_set(frame)
    shown = rendered(scene, tmp_path / "f12.png")
    picture = np.full((HEIGHT, WIDTH, 3), 0.25)
    picture[..., 0] = np.linspace(0, 1, WIDTH)
    picture[..., 1] = np.linspace(0, 1, HEIGHT)[:, None]
    off = np.abs(shown - picture).max(axis=-1)
    hands, beside = near_hands(made, row, 0), ~near_hands(made, row, 7)
    assert (off[hands] > 0.04).mean() > 0.85, "there are hands where the hands are"
    # Further than the mesh reaches between its vertices there is the picture, with its own colours.
    assert beside.mean() > 0.2
    assert off[beside].max() < 0.03
    # Lit skin: redder than blue, and mostly far from black.
    skin = shown[hands]
    assert np.median(skin[:, 0]) > 0.45
    assert np.median(skin[:, 0] - skin[:, 2]) > 0.12


def lights(built) -> list[bpy.types.Object]:
    return [o for o in built.collection.all_objects if o.type == "LIGHT"]


def cards(built) -> list[bpy.types.Object]:
    return [o for o in built.collection.all_objects if o.type == "MESH" and o.name.startswith("picture")]


def test_the_card_is_in_nobodys_way_and_lights_go_where_the_camera_goes(make_take, start_up):
    made = make_take()
    built = build_take(made.take)
    (card,) = cards(built)
    assert card.hide_viewport
    assert card.hide_select
    assert not card.visible_shadow
    assert not card.visible_diffuse
    bpy.context.view_layer.update()
    assert card.matrix_world.to_translation().length < 1e-6
    depth = min((card.matrix_world @ v.co).y for v in card.data.vertices)
    assert max(world(v)[..., 1].max() for v in made.vertices.values()) < depth < built.camera.data.clip_end
    before = [light.matrix_world.to_3x3() for light in lights(built)]
    assert len(before) == len(render_setup.SUNS)
    built.camera.rotation_euler.z = 1.0
    bpy.context.view_layer.update()
    for light, was in zip(lights(built), before, strict=True):
        turned = Matrix.Rotation(1.0, 3, "Z") @ was
        np.testing.assert_allclose(np.array(light.matrix_world.to_3x3()), np.array(turned), atol=1e-5)


def add_lamp(shown: bool = True, excluded: bool = False) -> None:
    collection = bpy.data.collections.new("lamps")
    bpy.context.scene.collection.children.link(collection)
    lamp = bpy.data.objects.new("mine", bpy.data.lights.new("mine", "AREA"))
    collection.objects.link(lamp)
    lamp.hide_render = not shown
    bpy.context.view_layer.layer_collection.children["lamps"].exclude = excluded


def move_lamp() -> None:
    bpy.data.objects["Light"].location.x += 1.0
    bpy.context.view_layer.update()


def add_sky() -> None:
    bpy.context.scene.world.use_nodes = True
    bpy.context.scene.world.node_tree.nodes.new("ShaderNodeTexSky")


def choose_exposure() -> None:
    bpy.context.scene.view_settings.exposure = 0.5


@pytest.mark.parametrize(
    ("before", "options", "lit", "pictured", "transform"),
    [
        (None, {}, True, True, "Standard"),
        (add_lamp, {}, False, True, "Standard"),
        (move_lamp, {}, False, True, "Standard"),
        (add_sky, {}, False, True, "Standard"),
        # A lamp that renders do not show lights nothing.
        (lambda: add_lamp(shown=False), {}, True, True, "Standard"),
        (lambda: add_lamp(excluded=True), {}, True, True, "Standard"),
        (choose_exposure, {}, True, True, "AgX"),
        (None, {"picture": False}, True, False, "AgX"),
        (None, {"render_setup": False}, False, False, "AgX"),
        (None, {"match_scene": False}, False, False, "AgX"),
        (None, {"camera": "Camera"}, False, False, "AgX"),
    ],
)
def test_what_the_artist_chose_stays(make_take, start_up, before, options, lit, pictured, transform):
    if before is not None:
        before()
    lamps = {o.name: o.data.energy for o in start_up.objects if o.type == "LIGHT"}
    sky = start_up.world
    built = build_take(make_take().take, **{k: bpy.data.objects.get(str(v), v) for k, v in options.items()})
    assert len(lights(built)) == lit * len(render_setup.SUNS)
    assert len(cards(built)) == pictured
    assert start_up.view_settings.view_transform == transform
    if not lit:
        assert {o.name: o.data.energy for o in start_up.objects if o.type == "LIGHT"} == lamps
        assert start_up.world == sky


@pytest.fixture
def registered(start_up):
    blender_manient.register()
    yield
    blender_manient.unregister()


def shown_of(built) -> set[bool]:
    """Whether renders show a capture's card and suns."""
    ours = [o for o in built.collection.all_objects if render_setup.OURS in o]
    assert len(ours) == 1 + len(render_setup.SUNS)
    return {not o.hide_render for o in ours}


def test_renders_follow_the_scenes_camera(make_take, registered):
    """A later capture shows its own picture; a camera of the artist's has none."""
    scene, layer = bpy.context.scene, bpy.context.view_layer
    first, second = (build_take(make_take(seed=seed).take) for seed in (1, 2))
    assert [shown_of(first), shown_of(second)] == [{False}, {True}]
    for camera, shown in ((first.camera, 0), (second.camera, 1), (bpy.data.objects["Camera"], 1)):
        scene.camera = camera
        layer.update()
        assert [shown_of(first), shown_of(second)] == [{shown == 0}, {shown == 1}]
    scene.camera = first.camera
    bpy.ops.ed.undo_push(message="before its turn has come")
    layer.update()
    bpy.ops.ed.undo_push(message="afterwards")
    names = [o.name for o in first.collection.all_objects if render_setup.OURS in o]
    bpy.ops.ed.undo()
    assert not any(bpy.data.objects[name].hide_render for name in names)


@pytest.mark.parametrize("camera", ["the capture's", "the artist's"])
def test_a_deleted_capture_gives_way_to_the_one_before(make_take, registered, camera):
    first, second = (build_take(make_take(seed=seed).take) for seed in (1, 2))
    if camera == "the artist's":
        bpy.context.scene.camera = bpy.data.objects["Camera"]
    bpy.ops.object.select_all(action="DESELECT")
    deleted = list(second.collection.all_objects)
    for thing in deleted:
        thing.hide_viewport = thing.hide_select = False
    bpy.context.view_layer.update()
    for thing in deleted:
        thing.select_set(True)
    bpy.ops.object.delete()
    bpy.context.view_layer.update()
    assert shown_of(first) == {True}


def test_what_the_artist_hides_stays_hidden(make_take, registered):
    scene = bpy.context.scene
    built = build_take(make_take().take)
    for thing in list(built.collection.all_objects):
        thing.hide_render = True
    scene.collection.objects.link(bpy.data.objects.new("another", None))
    for camera in (bpy.data.objects["Camera"], built.camera):
        scene.camera = camera
        bpy.context.view_layer.update()
        assert shown_of(built) == {False}
