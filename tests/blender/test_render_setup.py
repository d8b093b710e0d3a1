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
from blender_manient.scene.build import build_take
from blender_manient.scene.matching import clear_view
from blender_manient.scene.plate import rows_of
from handfit_core.media.source import Source

from .conftest import HEIGHT, WIDTH, world, write_png


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


def ramp() -> np.ndarray:
    """The picture of conftest: red grows to the right, green downwards."""
    rows = np.full((HEIGHT, WIDTH, 3), 0.25)
    rows[..., 0] = np.linspace(0, 1, WIDTH)
    rows[..., 1] = np.linspace(0, 1, HEIGHT)[:, None]
    return rows


def built_and_cleared(take):
    """A capture as the button makes it: the start-up cube, in which its camera stands, out of the way."""
    built = build_take(take)
    clear_view(built.camera, built.collection, bpy.context.view_layer)
    return built


def hand_pixels(made, row: int) -> np.ndarray:
    """(N, 2) columns and rows of the hands' vertices."""
    pixels = np.concatenate([made.take.intrinsics.project(v[row]) for v in made.vertices.values()])
    return np.floor(pixels).astype(int)


def own(collection: bpy.types.Collection, kind: str) -> list[bpy.types.Object]:
    return [o for o in collection.all_objects if o.type == kind]


def test_the_first_render_shows_lit_hands_in_their_picture(make_take, start_up, tmp_path):
    made = make_take()
    built_and_cleared(made.take)
    row, frame = made.seen[2]
    start_up.frame_set(frame)
    shown = rendered(start_up, tmp_path / "f12.png")
    assert shown.shape == (HEIGHT, WIDTH, 3)
    off = np.abs(shown - ramp()).max(axis=-1)
    pixels = hand_pixels(made, row)
    columns, rows = pixels[((pixels > 0) & (pixels < [WIDTH - 1, HEIGHT - 1])).all(-1)].T
    assert (off[rows, columns] > 0.04).mean() > 0.85, "there are hands where the hands are"
    # Further than the mesh reaches between its vertices there is the picture, with its own colours.
    near = np.zeros((HEIGHT, WIDTH), dtype=bool)
    for column, line in pixels.tolist():
        near[max(0, line - 7) : max(0, line + 8), max(0, column - 7) : max(0, column + 8)] = True
    assert (~near).mean() > 0.2
    assert off[~near].max() < 0.03
    # Lit skin: redder than blue, and mostly far from black.
    skin = shown[rows, columns]
    assert np.median(skin[:, 0]) > 0.45
    assert np.median(skin[:, 0] - skin[:, 2]) > 0.12


def test_the_picture_moves_with_the_clip(make_take, start_up, tmp_path):
    files = []
    for number in (3, 4, 5):
        rows = np.full((HEIGHT, WIDTH, 4), number / 10.0)
        rows[..., 3] = 1.0
        files.append(str(write_png(tmp_path / f"frame.{number:04d}.png", rows)))
    take = make_take(source=Source("sequence", tuple(files)), frame_numbers=np.array([3, 4, 5])).take
    built_and_cleared(take)
    for number in (5, 3, 4):
        start_up.frame_set(number)
        shown = rendered(start_up, tmp_path / "f12.png")
        assert abs(float(np.median(shown)) - number / 10.0) < 0.02, "frame by frame as behind the camera"


def test_the_card_is_in_nobodys_way(make_take, start_up):
    built = build_take(make_take().take)
    (card,) = [o for o in own(built.collection, "MESH") if o.name.startswith("picture")]
    assert card.hide_viewport
    assert card.hide_select
    assert not card.visible_shadow
    assert not card.visible_diffuse
    bpy.context.view_layer.update()
    assert card.matrix_world.to_translation().length < 1e-6
    depth = min((card.matrix_world @ v.co).y for v in card.data.vertices)
    assert depth > max(world(v)[..., 1].max() for v in make_take().vertices.values())
    assert depth < built.camera.data.clip_end


def test_lights_go_where_the_camera_goes(make_take, start_up):
    built = build_take(make_take().take)
    lights = own(built.collection, "LIGHT")
    assert len(lights) == len(render_setup.SUNS)
    bpy.context.view_layer.update()
    before = [o.matrix_world.to_3x3() for o in lights]
    built.camera.rotation_euler.z = 1.0
    bpy.context.view_layer.update()
    for light, was in zip(lights, before, strict=True):
        turned = Matrix.Rotation(1.0, 3, "Z") @ was
        np.testing.assert_allclose(np.array(light.matrix_world.to_3x3()), np.array(turned), atol=1e-5)


@pytest.mark.parametrize("what", ["lamp", "moved start-up lamp", "sky"])
def test_an_artists_light_stays_alone(make_take, start_up, what):
    if what == "lamp":
        start_up.collection.objects.link(bpy.data.objects.new("mine", bpy.data.lights.new("mine", "AREA")))
    elif what == "sky":
        start_up.world.use_nodes = True
        start_up.world.node_tree.nodes.new("ShaderNodeTexSky")
    else:
        bpy.data.objects["Light"].location.x += 1.0
        bpy.context.view_layer.update()
    lamps = {o.name: o.data.energy for o in start_up.objects if o.type == "LIGHT"}
    world_ = start_up.world
    built = build_take(make_take().take)
    assert own(built.collection, "LIGHT") == []
    assert {o.name: o.data.energy for o in start_up.objects if o.type == "LIGHT"} == lamps
    assert start_up.world == world_
    assert any(o.name.startswith("picture") for o in own(built.collection, "MESH"))


@pytest.mark.parametrize("how", ["opted out", "not matched", "own camera"])
def test_scenes_that_are_not_matched_get_nothing(make_take, start_up, how):
    options = {
        "opted out": {"render_setup": False},
        "not matched": {"match_scene": False},
        "own camera": {"camera": bpy.data.objects["Camera"]},
    }[how]
    built = build_take(make_take().take, **options)
    assert own(built.collection, "LIGHT") == []
    assert len(own(built.collection, "MESH")) == 2
    assert start_up.view_settings.view_transform == "AgX"


def test_colours_that_somebody_chose_stay(make_take, start_up):
    start_up.view_settings.exposure = 0.5
    build_take(make_take().take)
    assert start_up.view_settings.view_transform == "AgX"


def test_without_a_picture_there_is_light_alone(make_take, start_up):
    built = build_take(make_take().take, picture=False)
    assert len(own(built.collection, "LIGHT")) == len(render_setup.SUNS)
    assert len(own(built.collection, "MESH")) == 2
    assert start_up.view_settings.view_transform == "AgX"


def test_a_later_capture_shows_its_own_picture(make_take, start_up):
    first, second = (build_take(make_take(seed=seed).take) for seed in (1, 2))
    cards = [[o for o in own(b.collection, "MESH") if o.name.startswith("picture")] for b in (first, second)]
    assert [[card.hide_render for card in each] for each in cards] == [[True], [False]]
    lights = [own(b.collection, "LIGHT") for b in (first, second)]
    assert [len(each) for each in lights] == [len(render_setup.SUNS)] * 2, "each can stand alone"
    assert [{light.hide_render for light in each} for each in lights] == [{True}, {False}]


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
    scene, layer = bpy.context.scene, bpy.context.view_layer
    first, second = (build_take(make_take(seed=seed).take) for seed in (1, 2))
    for camera, shown in ((first.camera, [True, False]), (second.camera, [False, True])):
        scene.camera = camera
        layer.update()
        assert [shown_of(first), shown_of(second)] == [{each} for each in shown]
    scene.camera = bpy.data.objects["Camera"]
    layer.update()
    assert [shown_of(first), shown_of(second)] == [{False}, {True}], "a camera of the artist's has none"
    names = [second.camera.name, first.camera.name]
    first.camera.name, second.camera.name = "swapped", names[1]
    first.camera.name = names[0]
    layer.update()
    render_setup.follow_camera(scene)
    assert [shown_of(first), shown_of(second)] == [{False}, {True}], "whatever it is called"
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
    bpy.context.view_layer.update()
    assert [shown_of(first), shown_of(second)] == [{False}, {True}]
    bpy.ops.object.select_all(action="DESELECT")
    deleted = list(second.collection.all_objects)
    for thing in deleted:
        thing.hide_viewport = thing.hide_select = False
    bpy.context.view_layer.update()
    for thing in deleted:
        thing.select_set(True)
    bpy.ops.object.delete()
    bpy.context.view_layer.update()
    assert len(second.collection.all_objects) == 0
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


@pytest.mark.parametrize("how", ["hidden from renders", "excluded"])
def test_a_lamp_that_renders_do_not_show_lights_nothing(make_take, start_up, how):
    collection = bpy.data.collections.new("lamps")
    start_up.collection.children.link(collection)
    lamp = bpy.data.objects.new("mine", bpy.data.lights.new("mine", "AREA"))
    collection.objects.link(lamp)
    lamp.hide_render = how == "hidden from renders"
    bpy.context.view_layer.layer_collection.children["lamps"].exclude = how == "excluded"
    assert len(own(build_take(make_take().take).collection, "LIGHT")) == len(render_setup.SUNS)


def test_skin_and_nails_are_two_slots(make_take, model):
    mesh = build_take(make_take(model=model, sides=("right",)).take).hands[0].mesh.data
    slots = np.empty(len(mesh.polygons), dtype=np.int32)
    mesh.polygons.foreach_get("material_index", slots)
    if model == "open-hand":
        assert [m.name.partition(".")[0] for m in mesh.materials] == ["Hand Skin", "Hand Nails"]
        assert np.bincount(slots).tolist() == [len(slots) - 46, 46]
    else:
        assert [m.name.partition(".")[0] for m in mesh.materials] == ["Hand Skin"]
        assert not slots.any()


def test_an_exported_file_renders_alike(make_take, start_up, tmp_path):
    made = make_take()
    (path,) = export_take(build_take(made.take), made.take, tmp_path, "hands", "blend")
    bpy.ops.wm.open_mainfile(filepath=str(path))
    shown = rendered(bpy.data.scenes["photo of a hand"], tmp_path / "f12.png")
    pixels = hand_pixels(made, 0)
    top = max(0, int(pixels[:, 1].min()) - 8)
    assert top > 10
    assert np.abs(shown - ramp())[:top].max() < 0.03
    assert np.median(shown[top:] - ramp()[top:]) != 0.0
