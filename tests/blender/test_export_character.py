"""Characters as files of other programs: their deforming bones alone, which move as the viewport shows."""

from __future__ import annotations

import re
from itertools import pairwise

import bpy
import numpy as np
import pytest

from blender_manient.exporters.clean_rig import deforming_tree
from blender_manient.panels.export import MANIENT_PT_export
from blender_manient.scene.build import build_take
from handfit_core.common.skeleton import SIDES
from tests.drawn import drawn

from .characters import BoneSpec, build_armature, hand_specs, joint_name, mixamo_names, placed
from .conftest import evaluated_vertices, shown_bones
from .fbx_file import models_of
from .importing import read_back
from .looking import chosen

pytestmark = pytest.mark.usefixtures("registered")

FRAMES = (1, 6, 11)
WORN = {"Skin_of_a_hand", "Ring of a hand"}
FINGERS = ("thumb", "f_index", "f_middle", "f_ring", "f_pinky")


def rigify(generated) -> tuple[bpy.types.Object, list[str]]:
    bpy.ops.wm.open_mainfile(filepath=str(generated))
    bpy.data.objects.remove(bpy.data.objects["metarig"])
    rig = bpy.data.objects["rig"]
    rig.pose.bones["f_index.01_ik.L"]["FK_IK"] = 0.0
    for bone in rig.data.bones:
        bone.bbone_segments = 1  # files have no bent bones
    keyed = [f"{name}.{number:02d}.{side}" for name in FINGERS for number in (1, 2, 3) for side in "LR"]
    for side in "LR":
        rig.pose.bones[f"upper_arm_parent.{side}"]["IK_FK"] = 1.0
    moved(rig, [*keyed, *(f"upper_arm_fk.{side}" for side in "LR")])
    return rig, [f"DEF-{name}" for name in keyed]


def mixamo() -> tuple[bpy.types.Object, list[str]]:
    """As its FBX files come: a hundredth of the size, under an empty that moves."""
    specs, names = [BoneSpec("mixamorig:Hips", "", (0, 0, 0), (0, 0, 100))], []
    for side in SIDES:
        called = mixamo_names(side)
        place = np.array([70.0 if side == "left" else -70.0, 0.0, 140.0])
        specs += hand_specs(
            side, np.random.default_rng(3), names=called, parent="mixamorig:Hips", place=place, scale=100.0
        )
        names += [called[joint] for joint in range(1, 16)]
    rig = build_armature(specs)
    rig.scale = (0.01, 0.01, 0.01)
    carrier = bpy.data.objects.new("Carrier", None)
    bpy.context.collection.objects.link(carrier)
    rig.parent = carrier
    carrier.keyframe_insert("location", frame=1)
    carrier.location.x, carrier.rotation_euler.z = 2.0, 0.7
    carrier.keyframe_insert("location", frame=11)
    moved(rig, names)
    return rig, names


def plain() -> tuple[bpy.types.Object, list[str]]:
    """Anywhere; fingers move by constraints of one, by a driver of another, and by a strip."""
    rng = np.random.default_rng(5)
    specs = [BoneSpec("root", "", (0, 0, 0), (0, 0, 1)), BoneSpec("knob", "root", (0, 1, 0), (0, 1, 1))]
    specs += hand_specs("left", rng, bend=0.5, stretch=0.2, parent="root")
    rig = build_armature(specs)
    names = [joint_name(joint, "left") for joint in range(1, 16)]
    for bone in ("root", "knob"):
        rig.data.bones[bone].use_deform = False
    moved(rig, names[:13])
    animation = rig.animation_data
    track = animation.nla_tracks.new()
    track.strips.new("Moves", 1, animation.action)
    animation.action = None
    knob, bones = rig.pose.bones["knob"], rig.pose.bones
    knob.rotation_mode = bones[names[14]].rotation_mode = "XYZ"
    for frame, turn in ((1, 0.0), (11, 0.9)):
        knob.rotation_euler.x = turn
        knob.keyframe_insert("rotation_euler", frame=frame)
    held = bones[names[13]].constraints.new("COPY_ROTATION")
    held.target, held.subtarget = rig, "knob"
    driver = bones[names[14]].driver_add("rotation_euler", 0).driver
    variable = driver.variables.new()
    variable.targets[0].id = rig
    variable.targets[0].data_path = 'pose.bones["knob"].rotation_euler[0]'
    driver.expression = variable.name
    bones[joint_name(0, "left")].scale = (1.2, 1.2, 1.2)
    placed(rig, rng, 0.3)
    return rig, names


RIGS = {"rigify": rigify, "mixamo": lambda _: mixamo(), "plain": lambda _: plain()}


def moved(rig: bpy.types.Object, names: list[str]) -> None:
    """Turn bones about all axes, from frame 1 to 11."""
    rng = np.random.default_rng(7)
    for name in names:
        bone = rig.pose.bones[name]
        bone.rotation_mode = "QUATERNION"
        bone.keyframe_insert("rotation_quaternion", frame=1)
        bone.rotation_quaternion = (1.0, *rng.uniform(-0.4, 0.4, 3))
        bone.rotation_quaternion.normalize()  # type: ignore
        bone.keyframe_insert("rotation_quaternion", frame=11)


def skinned(rig: bpy.types.Object, names: list[str]) -> None:
    """A mesh with a triangle for each bone, deformed by it, and a ring that the last one carries."""
    bpy.context.view_layer.update()
    heads = np.array([rig.data.bones[name].head_local for name in names])
    points = (heads[:, None] + 0.1 / rig.matrix_world.median_scale * np.eye(3)).reshape(-1, 3)
    data = bpy.data.meshes.new("Skin_of_a_hand")
    data.from_pydata(points.tolist(), [], np.arange(len(points)).reshape(-1, 3).tolist())
    skin = bpy.data.objects.new("Skin_of_a_hand", data)
    for row, name in enumerate(names):
        skin.vertex_groups.new(name=name).add([3 * row, 3 * row + 1, 3 * row + 2], 1.0, "REPLACE")
    skin.parent = rig
    skin.modifiers.new("Armature", "ARMATURE").object = rig
    ring = bpy.data.objects.new("Ring of a hand", data.copy())
    ring.parent, ring.parent_type, ring.parent_bone = rig, "BONE", names[-1]
    for obj in (skin, ring):
        bpy.context.collection.objects.link(obj)


def corners(*names: str) -> list[np.ndarray]:
    """The corners of meshes in the world, on each frame; files may put numbers after names."""
    found = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        meshes = [o for o in bpy.data.objects if o.type == "MESH"]
        there = [o for name in names for o in meshes if o.name.startswith(name)]
        found.append(np.concatenate([evaluated_vertices(mesh) for mesh in there]))
    return found


def assert_corners(expected: list[np.ndarray], name: str, within: float = 1e-3) -> None:
    """Files may order corners otherwise."""
    for found, wanted in zip(corners(name), expected, strict=True):
        assert np.linalg.norm(found[:, None] - wanted, axis=-1).min(axis=0).max() < within


def rig_read_from(path) -> bpy.types.Object:
    read_back(path)
    (found,) = (o for o in bpy.data.objects if o.type == "ARMATURE")
    return found


def nodes(path, kind: str | None = None) -> set[str]:
    """Names in an FBX file."""
    return {name for name, (its_kind, _) in models_of(path).items() if kind in (None, its_kind)}


def export(path, rig: bpy.types.Object, **options):
    """Written, with nothing of the scene changed."""
    chosen(rig)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = FRAMES[0], FRAMES[-1], 30
    before = state()
    fmt = path.suffix[1:].removesuffix("c")
    assert bpy.ops.manient.export_character(filepath=str(path), file_format=fmt, **options) == {"FINISHED"}
    assert state() == before
    return path


def state() -> list:
    return [
        sorted((o.name, o.data.name if o.data else "", o.parent_type) for o in bpy.data.objects),
        sorted(block.name for blocks in (bpy.data.actions, bpy.data.meshes) for block in blocks),
        sorted((a.name, len(a.bones)) for a in bpy.data.armatures),
        len(bpy.data.scenes),
    ]


@pytest.mark.parametrize("kind", RIGS)
@pytest.mark.parametrize("fmt", ["fbx", "glb", "usdc"])
def test_its_fingers_come_back(generated, tmp_path, fmt, kind):
    rig, names = RIGS[kind](generated)
    skinned(rig, names)
    unit = 0.01 if kind == "mixamo" else 1.0
    bpy.context.scene.unit_settings.scale_length = unit
    expected = [unit * points for points in corners("Skin_of_a_hand")]
    deforming = [bone.name for bone in rig.data.bones if bone.use_deform]
    if fmt == "fbx":
        for meshes in (False, True):
            path = export(tmp_path / "x.fbx", rig, meshes=meshes)
            assert WORN & nodes(path) == (WORN if meshes else set())
            assert "Carrier" not in nodes(path)
    read = rig_read_from(export(tmp_path / f"x.{fmt}", rig))
    called = {n: n if n in read.data.bones else re.sub("[:.-]", "_", n) for n in deforming}
    assert {bone.name for bone in read.data.bones} == {*called.values()}
    assert_corners(expected, "Skin_of_a_hand", 1e-3 * unit)


def test_rigify_leaves_its_controls_behind(generated, tmp_path):
    """Only DEF- bones, in one tree: fingers on the palm, arms on the shoulders, these on the spine."""
    rig, names = rigify(generated)
    skinned(rig, names)
    tree, standing = deforming_tree(rig)
    assert set(tree) == {bone.name for bone in rig.data.bones if bone.name.startswith("DEF-")}
    assert [name for name, parent in tree.items() if not parent] == ["DEF-spine"]
    chain = ["f_index.02.L", "f_index.01.L", "palm.01.L", "hand.L"]
    for child, parent in (*pairwise(chain), ("upper_arm.L", "shoulder.L")):
        assert tree[f"DEF-{child}"] == f"DEF-{parent}"
    assert tree["DEF-shoulder.L"].startswith("DEF-spine.00")
    assert standing["hand_fk.L"] == "DEF-hand.L"
    path = export(tmp_path / "x.fbx", rig, preset="UNREAL")
    assert nodes(path, "LimbNode") == set(tree)
    assert nodes(path, "Null") == {"root"}


@pytest.mark.parametrize("fmt", ["fbx", "glb", "usdc"])
def test_what_hangs_on_a_squeezed_bone_stays_at_its_end(tmp_path, fmt):
    """As an IK arm is; Blender's importers connect bones that touch at rest, which then keep no places."""
    ends = [(0, 0, 0), (0, 0, 1), (0.3, 0, 1), (0.6, 0, 1), (0.7, 0, 1)]
    names = ["trunk", "upper", "lower", "palm"]
    specs = [BoneSpec(*each) for each in zip(names, ["", *names], ends, ends[1:], strict=False)]
    rig = build_armature(specs)
    for name in names[2:]:
        rig.data.bones[name].inherit_scale = "NONE"
    moved(rig, names[2:])
    upper = rig.pose.bones["upper"]
    for frame, size in ((1, 1.0), (11, 0.97)):
        upper.scale = (size**-0.5, size, size**-0.5)
        upper.keyframe_insert("scale", frame=frame)
    expected = [shown_bones(rig, frame)["palm"].head.copy() for frame in FRAMES]
    read = rig_read_from(export(tmp_path / f"x.{fmt}", rig))
    found = [read.matrix_world @ shown_bones(read, frame)["palm"].head for frame in FRAMES]
    np.testing.assert_allclose(found, expected, atol=3e-4)


@pytest.mark.parametrize(("preset", "moves"), [("PLAIN", True), ("UNITY", True), ("UNREAL", False)])
@pytest.mark.parametrize("fmt", ["fbx", "glb"])
def test_meshes_without_a_modifier(tmp_path, fmt, preset, moves):
    """A parent deforms one; the object carries one, a bone one, and a bone that is left out one."""
    specs = [BoneSpec("control", "", (0, 0, 0), (1, 0, 0)), BoneSpec("root", "", (0, 0, 0), (0, 0, 1))]
    rig = build_armature(specs)
    rig.data.bones["control"].use_deform = False
    rig.location, rig.scale = (3.0, 0.0, 0.0), (2.0, 2.0, 2.0)
    if moves:
        for frame, x, turn in ((1, 3.0, 0.0), (11, 5.0, 0.7)):
            rig.location.x, rig.rotation_euler.z = x, turn
            rig.keyframe_insert("location", frame=frame)
            rig.keyframe_insert("rotation_euler", frame=frame)
    moved(rig, ["control", "root"])
    parents = {"Legacy": "ARMATURE", "Hat": "OBJECT", "Ring": "root", "Held": "control"}
    names = [f"{name} of a hand" for name in parents]
    for name, parent in zip(names, parents.values(), strict=True):
        data = bpy.data.meshes.new(name)
        data.from_pydata([(0.1, 0.2, 0.3), (0.5, 0.2, 0.3), (0.1, 0.9, 0.3)], [], [(0, 1, 2)])
        mesh = bpy.data.objects.new(name, data)
        bpy.context.collection.objects.link(mesh)
        mesh.vertex_groups.new(name="root").add(range(3), 1.0, "REPLACE")
        mesh.parent, mesh.parent_type = rig, parent if parent.isupper() else "BONE"
        mesh.parent_bone = "" if parent.isupper() else parent
        mesh.location, mesh.rotation_euler.x, mesh.delta_location.z = (0.1, 0.0, 0.4), 0.3, 0.2
    expected = corners(*names)
    read_back(export(tmp_path / f"x.{fmt}", rig, preset=preset))
    np.testing.assert_allclose(corners(*names), expected, atol=1e-3)


def linked(path, kind: str) -> bpy.types.Object:
    """A character out of another file: linked as it is, overridden, or shown as an instance."""
    rig, names = mixamo()
    skinned(rig, names)
    collection = bpy.data.collections.new("Hero")
    for obj in (rig, rig.parent, *rig.children):
        bpy.context.scene.collection.objects.unlink(obj)
        collection.objects.link(obj)
    bpy.context.scene.collection.children.link(collection)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.collections = ["Hero"]
    collection = bpy.data.collections["Hero"]
    if kind == "instance":
        shown = bpy.data.objects.new("Shown", None)
        shown.instance_type, shown.instance_collection = "COLLECTION", collection
        bpy.context.scene.collection.objects.link(shown)
        return shown
    bpy.context.scene.collection.children.link(collection)
    if kind == "override":
        collection.override_hierarchy_create(
            bpy.context.scene, bpy.context.view_layer, do_fully_editable=True
        )
    bpy.context.view_layer.update()
    return next(o for o in bpy.context.scene.objects if o.type == "ARMATURE")


@pytest.mark.parametrize("kind", ["linked", "override"])
@pytest.mark.parametrize("fmt", ["fbx", "glb", "usdc", "vrma"])
def test_out_of_another_file(tmp_path, kind, fmt):
    rig = linked(tmp_path / "library.blend", kind)
    expected = corners("Skin_of_a_hand")
    path = export(tmp_path / f"x.{fmt}", rig)
    if fmt in ("fbx", "glb"):
        read_back(path)
        assert_corners(expected, "Skin_of_a_hand")


def test_what_cannot_be_written_is_said_before(make_take, tmp_path):
    shown = linked(tmp_path / "library.blend", "instance")
    chosen(shown)
    for said in ("make a library override", "negative scale"):
        assert said in drawn(MANIENT_PT_export).loud
        assert "Export" in drawn(MANIENT_PT_export).grey
        with pytest.raises(RuntimeError, match=said):
            bpy.ops.manient.export_character(filepath=str(tmp_path / "x"), file_format="fbx")
        rig, _ = plain()
        rig.scale.x *= -1.0
        bpy.context.view_layer.update()
        chosen(rig)
    rig.scale.x *= -1.0
    bpy.context.view_layer.update()
    for fmt, said in (("npz", "holds captured hands"), ("abc", "a mesh to hold")):
        with pytest.raises(RuntimeError, match=said):
            bpy.ops.manient.export_character(filepath=str(tmp_path / "x"), file_format=fmt)
    hand = build_take(make_take(sides=("left",)).take).hands[0].armature
    for each in (rig, hand):
        chosen(each)
        assert ("export_meshes" in drawn(MANIENT_PT_export).said) == (each == rig)
        assert ("npz" in drawn(MANIENT_PT_export).grey) == (each == rig)
    export(tmp_path / "keys.bvh", rig, frame_range="KEYS")
    assert "Frames: 11\n" in (tmp_path / "keys.bvh").read_text()
    rig.animation_data_clear()
    with pytest.raises(RuntimeError, match="has no keys"):
        export(tmp_path / "x.bvh", rig, frame_range="KEYS")
    assert not list(tmp_path.glob("x*"))
