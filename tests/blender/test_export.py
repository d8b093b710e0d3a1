"""Files read back into an empty Blender show the same hands on the same frames, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient.exporters import EXPORTERS
from blender_manient.exporters.export_hands import export_take
from blender_manient.scene.build import build_take
from handfit_core.errors import OptionError

from .importing import joint_error, read_back, vertex_error

BONES, SKIN = (joint_error,), (vertex_error,)
ERRORS = {
    "glb": BONES + SKIN,
    "fbx": BONES + SKIN,
    "bvh": BONES,
    "usd": SKIN,
    "abc": SKIN,
    "blend": BONES + SKIN,
}
"""What can be compared of each format"""


@pytest.mark.parametrize("fmt", ERRORS)
def test_it_comes_back(make_take, model, picture, tmp_path, fmt):
    """Out of a file with another take and a cube to get in the way."""
    if EXPORTERS[fmt].why_not():
        pytest.skip(f"this Blender cannot write {fmt}")
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.name = "Foreign"
    build_take(make_take(sides=("left",), seed=7, frame_numbers=np.arange(1, 40), fps=25.0).take)
    made = make_take(model=model)
    built = build_take(made.take)
    bpy.context.scene.frame_end = 900  # the user's range and rate are not the take's
    bpy.context.scene.render.fps = 12
    bpy.context.scene.frame_set(77)
    before = sorted(o.name for o in bpy.data.objects), len(bpy.data.scenes)
    opened = set()
    bpy.app.handlers.frame_change_post.append(
        lambda *_: opened.add(bpy.data.window_managers[0].windows[0].scene)
    )
    files = export_take(built, made.take, tmp_path, "hand of take", fmt)
    bpy.app.handlers.frame_change_post.pop()
    assert opened == {bpy.context.scene}, "exports happen where no window shows them"
    assert (sorted(o.name for o in bpy.data.objects), len(bpy.data.scenes)) == before
    assert bpy.context.scene.frame_current == 77
    assert sorted(tmp_path.iterdir()) == sorted(files), "nothing half-written is left"
    if fmt == "bvh":
        assert [f.name for f in files] == ["hand of take_left.bvh", "hand of take_right.bvh"]
    read_back(*files, first=int(made.take.frame_numbers[0]))
    assert not [o.name for o in bpy.data.objects if "Foreign" in o.name or "Cube" in o.name]
    rigs = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    assert len(rigs) <= 2
    assert not [bone.name for rig in rigs for bone in rig.data.bones if "_end" in bone.name]
    if fmt == "blend":
        scene = bpy.context.scene
        assert (scene.frame_start, scene.frame_end, scene.render.fps) == (3, 18, 30)
        image = scene.camera.data.background_images[0].image
        assert image.filepath.startswith("//")
        assert Path(bpy.path.abspath(image.filepath)).resolve() == picture.resolve()
    for error in ERRORS[fmt]:
        assert error(made) < (1e-4 if fmt == "blend" else 1e-3)


@pytest.mark.parametrize(
    ("sides", "names"), [(("left",), ["x"]), (("left", "left", "left"), ["x_left", "x_left2", "x_left3"])]
)
def test_each_hand_has_a_name_of_its_own(make_take, tmp_path, sides, names):
    made = make_take(sides=sides)
    files = export_take(build_take(made.take), made.take, tmp_path, "x", "bvh")
    assert [f.name for f in files] == [f"{name}.bvh" for name in names]
    assert all(f.stat().st_size > 0 for f in files)


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


def test_unknown_format_lists_the_known_ones(make_take, tmp_path):
    made = make_take(sides=("left",))
    with pytest.raises(OptionError, match=r"'obj'.*blend, fbx, glb, usd, bvh, abc, vrma$"):
        export_take(build_take(made.take), made.take, tmp_path, "x", "obj")
