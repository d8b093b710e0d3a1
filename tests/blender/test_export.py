"""Files read back into an empty Blender show the same hands on the same frames, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest

import blender_manient
from blender_manient.exporters import EXPORTERS
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.export import export_take
from handfit_core.errors import OptionError, OutputError

from .conftest import evaluated_vertices, joint_heads, world


@pytest.fixture
def exported(make_take, model, tmp_path):
    """exported(fmt) -> (made, files), with another take and a cube in the file to get in the way."""

    def export(fmt: str):
        if EXPORTERS[fmt].why_not():
            pytest.skip(f"this Blender cannot write {fmt}")
        bpy.ops.mesh.primitive_cube_add()
        bpy.context.object.name = "Foreign"
        build_take(make_take(sides=("left",), seed=7, frame_numbers=np.arange(1, 40), fps=25.0).take)
        made = make_take(model=model)
        built = build_take(made.take)
        bpy.context.scene.frame_end = 900  # the user's range is not the take's
        bpy.context.scene.frame_set(77)
        before = sorted(o.name for o in bpy.data.objects), len(bpy.data.scenes)
        files = export_take(built, made.take, tmp_path, "hand of take", fmt)
        assert (sorted(o.name for o in bpy.data.objects), len(bpy.data.scenes)) == before
        assert bpy.context.scene.frame_current == 77
        assert sorted(tmp_path.iterdir()) == sorted(files), "nothing half-written is left"
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.scene.render.fps = 30
        return made, files

    return export


def imported_armature(side):
    found = [o for o in bpy.data.objects if o.type == "ARMATURE" and bone_names(side)[0] in o.pose.bones]
    assert len(found) == 1
    return found[0]


def worst_joint_error(made, sides=("left", "right")) -> float:
    """Largest distance in metres between imported bone heads and the take's joints."""
    worst = 0.0
    for row, frame in made.seen:
        bpy.context.scene.frame_set(frame)
        for side in sides:
            heads = joint_heads(imported_armature(side), side)
            error = np.linalg.norm(heads - world(made.joints[side][row]), axis=-1)
            worst = max(worst, error.max())
    print(f"worst joint error {worst * 1000:.5f} mm")
    return worst


def worst_vertex_error(made) -> float:
    """Largest distance in metres from an imported vertex to the model's vertex nearest to it."""
    worst = 0.0
    meshes = [o for o in bpy.data.objects if o.type == "MESH" and not o.hide_viewport]
    assert len(meshes) == len(made.vertices)
    for row, frame in made.seen:
        bpy.context.scene.frame_set(frame)
        clouds = [evaluated_vertices(o) for o in meshes]
        for vertices in made.vertices.values():
            expected = world(vertices[row])
            cloud = min(clouds, key=lambda c, e=expected: np.linalg.norm(c.mean(0) - e.mean(0)))
            if len(cloud) == len(expected):
                error = np.linalg.norm(cloud - expected, axis=-1)
            else:  # split along texture seams: same places, more vertices
                error = np.array([np.linalg.norm(expected - p, axis=-1).min() for p in cloud[::5]])
            worst = max(worst, error.max())
    print(f"worst vertex error {worst * 1000:.5f} mm")
    return worst


def unclamp_shape_keys():
    """The files hold values outside 0..1, but Blender's importers leave the sliders at 0..1."""
    for mesh in bpy.data.meshes:
        for key in mesh.shape_keys.key_blocks if mesh.shape_keys else ():
            key.slider_min, key.slider_max = -2.0, 2.0


def assert_nothing_foreign():
    assert not [o.name for o in bpy.data.objects if "Foreign" in o.name or "Cube" in o.name]
    assert len([o for o in bpy.data.objects if o.type == "ARMATURE"]) <= 2


def test_gltf_round_trip(exported):
    made, files = exported("glb")
    bpy.ops.import_scene.gltf(filepath=str(files[0]), bone_heuristic="BLENDER")
    for extra in [o for o in bpy.data.objects if o.type == "MESH" and "hand" not in o.name]:
        bpy.data.objects.remove(extra)  # the importer's own bone shape
    assert_nothing_foreign()
    assert worst_joint_error(made) < 1e-3
    unclamp_shape_keys()
    assert worst_vertex_error(made) < 1e-3


def test_fbx_round_trip(exported):
    made, files = exported("fbx")
    bpy.ops.import_scene.fbx(filepath=str(files[0]), anim_offset=0.0)
    assert_nothing_foreign()
    assert not [b for o in bpy.data.objects if o.type == "ARMATURE" for b in o.data.bones if "_end" in b.name]
    assert worst_joint_error(made) < 1e-3
    assert worst_vertex_error(made) < 1e-3


def test_bvh_round_trip(exported):
    made, files = exported("bvh")
    assert [f.name for f in files] == ["hand of take_left.bvh", "hand of take_right.bvh"]
    for file in files:
        bpy.ops.import_anim.bvh(
            filepath=str(file), axis_forward="Y", axis_up="Z", frame_start=int(made.take.frame_numbers[0])
        )
    assert worst_joint_error(made) < 1e-3


def test_bvh_of_one_hand_has_no_side_in_its_name(make_take, tmp_path):
    made = make_take(sides=("left",))
    files = export_take(build_take(made.take), made.take, tmp_path, "x", "bvh")
    assert [f.name for f in files] == ["x.bvh"]


@pytest.mark.parametrize("fps", [12.5, 24.0, 30000 / 1001])
def test_gltf_keeps_the_time(make_take, tmp_path, fps):
    """Read from the file itself: Blender's importer would undo a mistake of its exporter."""
    made = make_take(sides=("right",), fps=fps)
    (path,) = export_take(build_take(made.take), made.take, tmp_path, "timed", "glb")
    data = path.read_bytes()
    content = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    inputs = {s["input"] for animation in content["animations"] for s in animation["samplers"]}
    spans = [content["accessors"][i]["max"][0] - content["accessors"][i]["min"][0] for i in inputs]
    frames = int(made.take.frame_numbers[-1] - made.take.frame_numbers[0])
    assert max(spans) == pytest.approx(frames / fps, rel=1e-4)


def test_three_hands_of_one_side_are_three_files(make_take, tmp_path):
    made = make_take(sides=("left", "left", "left"))
    files = export_take(build_take(made.take), made.take, tmp_path, "hands", "bvh")
    assert [f.name for f in files] == ["hands_left.bvh", "hands_left2.bvh", "hands_left3.bvh"]
    assert all(f.stat().st_size > 0 for f in files)


def test_usd_round_trip(exported):
    made, files = exported("usd")
    bpy.ops.wm.usd_import(filepath=str(files[0]))
    assert_nothing_foreign()
    unclamp_shape_keys()
    assert worst_vertex_error(made) < 1e-3


def test_alembic_round_trip(exported):
    made, files = exported("abc")
    bpy.ops.wm.alembic_import(filepath=str(files[0]), as_background_job=False)
    assert_nothing_foreign()
    assert worst_vertex_error(made) < 1e-3


def test_blend_round_trip(exported, picture):
    made, files = exported("blend")
    bpy.ops.wm.open_mainfile(filepath=str(files[0]))
    scene = bpy.context.scene
    assert_nothing_foreign()
    assert (scene.frame_start, scene.frame_end, scene.render.fps) == (3, 18, 30)
    assert scene.camera is not None
    image = scene.camera.data.background_images[0].image
    assert image.filepath.startswith("//")
    assert Path(bpy.path.abspath(image.filepath)).resolve() == picture.resolve()
    assert worst_joint_error(made) < 1e-4
    assert worst_vertex_error(made) < 1e-4


def test_unknown_format_lists_the_known_ones(make_take, tmp_path):
    made = make_take(sides=("left",))
    built = build_take(made.take)
    with pytest.raises(OptionError, match=r"'obj'.*blend, fbx, glb, usd, bvh, abc$"):
        export_take(built, made.take, tmp_path, "x", "obj")


def test_unwritable_folder_is_one_sentence(make_take, tmp_path):
    made = make_take(sides=("left",))
    built = build_take(made.take)
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(OutputError, match="cannot write here"):
        export_take(built, made.take, tmp_path / "file", "x", "glb")


@pytest.mark.parametrize("fmt", ["glb", "fbx"])
def test_metres_in_any_unit(make_take, tmp_path, fmt):
    """From a scene in centimetres, with the add-on's own settings on the objects."""
    blender_manient.register()
    try:
        bpy.context.scene.unit_settings.scale_length = 0.01
        made = make_take()
        built = build_take(made.take)
        assert built.hands[0].armature.scale.x == pytest.approx(100.0)
        (path,) = export_take(built, made.take, tmp_path, "x", fmt)
        assert built.hands[0].armature.scale.x == pytest.approx(100.0)
    finally:
        blender_manient.unregister()
    if fmt == "glb":
        data = path.read_bytes()
        content = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
        extras = [set(node["extras"]) for node in content["nodes"] if "extras" in node]
        own = {"side", "betas", "model", "solver", "source"}
        assert extras == [own, own]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = 30
    if fmt == "glb":
        bpy.ops.import_scene.gltf(filepath=str(path), bone_heuristic="BLENDER")
    else:
        bpy.ops.import_scene.fbx(filepath=str(path), anim_offset=0.0)
    assert worst_joint_error(made) < 1e-3
