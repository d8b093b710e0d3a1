"""Scenes, exports and saved files are what they were when tests/golden was written, by version of Blender."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient.exporters import EXPORTERS
from blender_manient.exporters.export_hands import export_take
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.store import captured_hands, kept_take
from handfit_core.take import Take
from tests.golden import FOLDER, TAKE, Golden, numbers

from .conftest import action_curves
from .importing import imported, read_back

VERSION = "{}.{}".format(*bpy.app.version)
FRAMES = (80, 95, 119)
FORMATS = ("glb", "fbx", "bvh", "blend")
"""Whose bones come back"""

ROUNDING = 2
"""Steps of the last digit by which sums of floats differ"""


def scene_lines() -> Iterator[str]:
    """All that a built take consists of."""
    scene = bpy.context.scene
    yield f"scene {scene.frame_start} to {scene.frame_end}, {scene.render.fps} per second"
    for collection in sorted(bpy.data.collections, key=lambda each: each.name):
        yield f"collection {collection.name}: {sorted(each.name for each in collection.objects)}"
    for obj in sorted(bpy.data.objects, key=lambda each: each.name):
        yield f"{obj.type} {obj.name}, parent {obj.parent.name if obj.parent else None}"
        yield f"  at {numbers(1000.0 * np.array(obj.matrix_world.translation), 2)} mm"
        yield from properties(obj)
        yield from (f"  modifier {each.type} {each.name}" for each in obj.modifiers)
        yield from constraints(obj.constraints)
        match obj.type:
            case "ARMATURE":
                yield from rig_lines(obj)
            case "MESH":
                yield from mesh_lines(obj)
            case "CAMERA":
                yield f"  lens {numbers(np.array([obj.data.lens, obj.data.sensor_width]), 3)}"
                yield from properties(obj.data)


def rig_lines(obj: bpy.types.Object) -> Iterator[str]:
    """An armature's bones and keys."""
    yield from properties(obj.data)
    for bone in obj.data.bones:
        parent = bone.parent.name if bone.parent else None
        place = np.array([*bone.head_local, *bone.tail_local])
        yield f"  bone {bone.name}, parent {parent}, deform {bone.use_deform}"
        yield f"    from, to {numbers(1000.0 * place, 2)} mm"
        pose = obj.pose.bones[bone.name]
        yield f"    rotation {pose.rotation_mode}"
        yield from properties(pose)
        yield from constraints(pose.constraints)
    if obj.animation_data and obj.animation_data.action:
        for curve in action_curves(obj.animation_data.action):
            keys = np.array([point.co for point in curve.keyframe_points])
            some = numbers(keys[:: max(1, len(keys) // 4), 1], 3)
            yield f"  curve {curve.data_path}[{curve.array_index}] {len(keys)} keys: {some}"


def mesh_lines(obj: bpy.types.Object) -> Iterator[str]:
    """A mesh's counts and names."""
    mesh = obj.data
    yield f"  {len(mesh.vertices)} vertices, {len(mesh.polygons)} faces"
    yield f"  uv {[each.name for each in mesh.uv_layers]}"
    yield f"  groups {[each.name for each in obj.vertex_groups]}"
    yield f"  materials {[each.name for each in mesh.materials if each]}"
    if mesh.shape_keys:
        yield f"  shape keys {[each.name for each in mesh.shape_keys.key_blocks]}"


def properties(owner: bpy.types.ID | bpy.types.PoseBone) -> Iterator[str]:
    """Names and kinds of custom properties."""
    for name in sorted(owner.keys()):
        yield f"  property {name}: {type(owner[name]).__name__}"


def constraints(found: bpy.types.bpy_prop_collection) -> Iterator[str]:
    """Kinds, names and targets of constraints."""
    for each in found:
        target = getattr(each, "target", None)
        yield f"    constraint {each.type} {each.name} to {target.name if target else None}"


def joint_lines() -> Iterator[str]:
    """Where the bones of both hands begin, in three frames."""
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        for side in ("left", "right"):
            armature = imported(side)
            heads = [armature.matrix_world @ armature.pose.bones[name].head for name in bone_names(side)]
            yield f"{side} in {frame}: {numbers(1000.0 * np.array(heads), 1)} mm"


@pytest.mark.usefixtures("registered")
def test_scene(golden: Golden) -> None:
    build_take(Take.load(TAKE))
    golden.check(f"scene-{VERSION}.txt", "\n".join(scene_lines()) + "\n", ROUNDING)


@pytest.mark.parametrize("fmt", FORMATS)
def test_exports(golden: Golden, tmp_path: Path, fmt: str) -> None:
    if why := EXPORTERS[fmt].why_not():
        pytest.skip(why)
    take = Take.load(TAKE)
    files = export_take(build_take(take), take, tmp_path, "hands", fmt)
    read_back(*files, first=FRAMES[0], fps=round(take.fps))
    golden.check("exports.txt", "\n".join(joint_lines()) + "\n", ROUNDING)


def saved_before() -> list[Path]:
    """The files that this Blender and older ones have saved."""
    versions = {path.stem.removeprefix("hands-"): path for path in sorted(FOLDER.glob("hands-*.blend"))}
    return [path for made, path in versions.items() if tuple(map(int, made.split("."))) <= bpy.app.version]


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize("path", saved_before(), ids=lambda path: path.stem)
def test_todays_files_open(golden: Golden, path: Path) -> None:
    bpy.ops.wm.open_mainfile(filepath=str(path))
    golden.check("exports.txt", "\n".join(joint_lines()) + "\n", ROUNDING)
    (hand,) = (each for each in captured_hands(bpy.context.scene) if each.name.startswith("left"))
    taken = kept_take(hand.users_collection[0])
    assert np.array_equal(taken.hands[0].hand_pose, Take.load(TAKE).hands[0].hand_pose)
