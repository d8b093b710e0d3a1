"""Characters as files of other programs: their deforming bones alone, which move as the viewport shows."""

from __future__ import annotations

import addon_utils
import bpy
import numpy as np
import pytest

from blender_manient.exporters.clean_rig import deforming_tree
from blender_manient.panels.export import MANIENT_PT_export
from blender_manient.scene.sampling import rotations_of
from handfit_core.skeleton import SIDES
from tests.drawn import drawn

from .characters import BoneSpec, build_armature, hand_specs, joint_name, mixamo_names, placed
from .fbx_file import read_fbx
from .importing import read_back

pytestmark = pytest.mark.usefixtures("registered")

FRAMES = (1, 6, 11)
MOST = 0.5
"""degrees that a finger may be off once its file is read back"""
WORN = {"Skin", "Ring of a hand"}
FINGERS = ("thumb", "f_index", "f_middle", "f_ring", "f_pinky")


def rigify() -> tuple[bpy.types.Object, list[str]]:
    addon_utils.enable("rigify", default_set=True, persistent=True)
    import rigify.generate

    bpy.ops.object.armature_human_metarig_add()
    metarig = bpy.context.active_object
    rigify.generate.generate_rig(bpy.context, metarig)
    bpy.data.objects.remove(metarig)
    addon_utils.disable("rigify", default_set=True)
    names = [f"{name}.{number:02d}" for name in FINGERS for number in (1, 2, 3)]
    rig = bpy.data.objects["rig"]
    for side in "LR":
        rig.pose.bones[f"upper_arm_parent.{side}"]["IK_FK"] = 1.0
    keyed = [f"{name}.{side}" for name in names for side in "LR"]
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
    rig.pose.bones["knob"].rotation_mode = "XYZ"
    rig.pose.bones["knob"].keyframe_insert("rotation_euler", frame=1)
    rig.pose.bones["knob"].rotation_euler.x = 0.9
    rig.pose.bones["knob"].keyframe_insert("rotation_euler", frame=11)
    held = rig.pose.bones[names[13]].constraints.new("COPY_ROTATION")
    held.target, held.subtarget = rig, "knob"
    rig.pose.bones[names[14]].rotation_mode = "XYZ"
    driver = rig.pose.bones[names[14]].driver_add("rotation_euler", 0).driver
    variable = driver.variables.new()
    variable.targets[0].id = rig
    variable.targets[0].data_path = 'pose.bones["knob"].rotation_euler[0]'
    driver.expression = variable.name
    placed(rig, rng, 0.3)
    return rig, names


RIGS = {"rigify": rigify, "mixamo": mixamo, "plain": plain}


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
    points = (heads[:, None] + 0.02 / rig.matrix_world.median_scale * np.eye(3)).reshape(-1, 3)
    data = bpy.data.meshes.new("Skin")
    data.from_pydata(points.tolist(), [], np.arange(len(points)).reshape(-1, 3).tolist())
    skin = bpy.data.objects.new("Skin", data)
    for row, name in enumerate(names):
        skin.vertex_groups.new(name=name).add([3 * row, 3 * row + 1, 3 * row + 2], 1.0, "REPLACE")
    skin.parent = rig
    skin.modifiers.new("Armature", "ARMATURE").object = rig
    ring = bpy.data.objects.new("Ring of a hand", data.copy())
    ring.parent, ring.parent_type, ring.parent_bone = rig, "BONE", names[-1]
    for obj in (skin, ring):
        bpy.context.collection.objects.link(obj)


def turns(rig: bpy.types.Object, names: list[str], frames=FRAMES) -> np.ndarray:
    """(N, B, 3, 3) how bones are turned from rest in the world, relative to the first of the frames."""
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        shown = rig.evaluated_get(bpy.context.evaluated_depsgraph_get())
        world = rotations_of(np.array(shown.matrix_world))
        posed = rotations_of(np.array([shown.pose.bones[name].matrix for name in names]))
        rest = rotations_of(np.array([rig.data.bones[name].matrix_local for name in names]))
        found.append(world @ posed @ np.swapaxes(rest, -1, -2))
    return np.array(found)


def off(one: np.ndarray, other: np.ndarray) -> float:
    """The largest angle between turns, in degrees."""
    cosine = (np.einsum("...ij,...ij->...", one, other) - 1.0) / 2.0
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max())


def heads(rig: bpy.types.Object, names: list[str], frame: int) -> np.ndarray:
    bpy.context.scene.frame_set(frame)
    shown = rig.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([shown.matrix_world @ shown.pose.bones[name].head for name in names])


def select(rig: bpy.types.Object) -> None:
    bpy.ops.object.select_all(action="DESELECT")
    rig.select_set(True)
    bpy.context.view_layer.objects.active = rig


def export(path, rig: bpy.types.Object, **options):
    select(rig)
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = FRAMES[0], FRAMES[-1]
    bpy.context.scene.render.fps = 30
    assert bpy.ops.manient.export_character(filepath=str(path), **options) == {"FINISHED"}
    return path


def state() -> list:
    return [
        sorted((o.name, o.data.name if o.data else "", o.parent_type) for o in bpy.data.objects),
        sorted(block.name for blocks in (bpy.data.actions, bpy.data.meshes) for block in blocks),
        sorted((a.name, len(a.bones)) for a in bpy.data.armatures),
        len(bpy.data.scenes),
        bpy.context.scene.frame_current,
        bpy.context.view_layer.objects.active.name,
    ]


@pytest.mark.parametrize("kind", RIGS)
@pytest.mark.parametrize("fmt", ["fbx", "glb", "usdc"])
def test_its_fingers_come_back(tmp_path, fmt, kind):
    rig, names = RIGS[kind]()
    skinned(rig, names)
    expected, places = turns(rig, names), heads(rig, names, 11)
    deforming = {bone.name for bone in rig.data.bones if bone.use_deform}
    select(rig)
    before = state()
    path = export(tmp_path / f"x.{fmt}", rig, file_format=fmt.removesuffix("c"))
    assert state()[:4] == before[:4]
    read_back(path)
    (read,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    own = {name: name.replace(":", "_").replace(".", "_").replace("-", "_") for name in deforming}
    called = {name: name if name in read.data.bones else own[name] for name in deforming}
    assert {bone.name for bone in read.data.bones} == {*called.values()}
    there = [called[name] for name in names]
    found = turns(read, there)
    assert off(found, expected) < MOST
    np.testing.assert_allclose(heads(read, there, 11), places, atol=1e-3)


def test_rigify_leaves_its_controls_behind(tmp_path):
    """Only DEF- bones, in one tree: fingers on the palm, arms on the shoulders, these on the spine."""
    rig, names = rigify()
    skinned(rig, names)
    tree, standing = deforming_tree(rig)
    assert set(tree) == {bone.name for bone in rig.data.bones if bone.name.startswith("DEF-")}
    assert [name for name, parent in tree.items() if not parent] == ["DEF-spine"]
    assert tree["DEF-f_index.01.L"] == "DEF-palm.01.L"
    assert tree["DEF-f_index.02.L"] == "DEF-f_index.01.L"
    assert tree["DEF-palm.01.L"] == "DEF-hand.L"
    assert tree["DEF-upper_arm.L"] == "DEF-shoulder.L"
    assert tree["DEF-shoulder.L"].startswith("DEF-spine.00")
    assert standing["hand_fk.L"] == "DEF-hand.L"
    path = export(tmp_path / "x.fbx", rig, file_format="fbx", preset="UNREAL")
    objects = read_fbx(path).first("Objects").all("Model")
    bones = {n.values[1].split("\x00")[0] for n in objects if n.values[2] == "LimbNode"}
    assert bones == set(tree)
    assert [n.values[1].split("\x00")[0] for n in objects if n.values[2] == "Null"] == ["root"]


def test_a_stretched_arm_turns_no_finger(tmp_path):
    """Stretch that a file cannot hold is left out, and what hangs on it stays where it is shown."""
    specs = [BoneSpec("arm", "", (0, 0, 0), (0, 0.5, 0)), BoneSpec("hand", "arm", (0, 0.5, 0), (0, 0.6, 0.1))]
    specs.append(BoneSpec("finger", "hand", (0, 0.6, 0.1), (0, 0.7, 0)))
    rig = build_armature(specs)
    rig.pose.bones["arm"].scale = (0.7, 2.0, 0.7)
    moved(rig, ["arm", "hand", "finger"])
    expected, places = turns(rig, ["hand", "finger"]), heads(rig, ["hand", "finger"], 6)
    path = export(tmp_path / "x.glb", rig, file_format="glb")
    read_back(path)
    (read,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    assert off(turns(read, ["hand", "finger"]), expected) < MOST
    np.testing.assert_allclose(heads(read, ["hand", "finger"], 6), places, atol=1e-4)


@pytest.mark.parametrize("preset", ["PLAIN", "UNITY", "UNREAL"])
def test_presets_units_and_meshes(tmp_path, preset):
    """In a scene of centimetres; with the skin and what a bone carries, and without."""
    rig, names = mixamo()
    skinned(rig, names)
    bpy.context.scene.unit_settings.scale_length = 0.01
    places = heads(rig, names, 11) * 0.01
    for meshes in (True, False):
        path = export(tmp_path / "x.fbx", rig, file_format="fbx", preset=preset, meshes=meshes)
        read_back_names = [n.values[1].split("\x00")[0] for n in read_fbx(path).first("Objects").all("Model")]
        assert WORN & set(read_back_names) == (WORN if meshes else set())
        assert "Carrier" not in read_back_names
    read_back(path)
    (read,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    np.testing.assert_allclose(heads(read, names, 11), places, atol=1e-4)


def test_what_a_bone_carries_goes_with_it(tmp_path):
    rig, names = plain()
    skinned(rig, names)
    ring = bpy.data.objects["Ring of a hand"]
    bpy.context.scene.frame_set(11)
    shown = ring.evaluated_get(bpy.context.evaluated_depsgraph_get())
    expected = np.array([shown.matrix_world @ v.co for v in ring.data.vertices])
    read_back(export(tmp_path / "x.glb", rig, file_format="glb"))
    bpy.context.scene.frame_set(11)
    shown = bpy.data.objects["Ring of a hand"].evaluated_get(bpy.context.evaluated_depsgraph_get())
    found = np.array([shown.matrix_world @ v.co for v in shown.data.vertices])
    assert np.abs(expected[:, None] - found[None]).max(-1).min(1).max() < 1e-4


def places(names: list[str], frame: int) -> list[np.ndarray]:
    """The corners of meshes in the world."""
    bpy.context.scene.frame_set(frame)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    shown = [bpy.data.objects[name].evaluated_get(depsgraph) for name in names]
    return [np.array([o.matrix_world @ v.co for v in o.data.vertices]) for o in shown]


@pytest.mark.parametrize("moves", [True, False])
@pytest.mark.parametrize("preset", ["PLAIN", "UNITY", "UNREAL"])
@pytest.mark.parametrize("fmt", ["fbx", "glb"])
def test_meshes_without_a_modifier(tmp_path, fmt, preset, moves):
    """A parent deforms one; of the others the object carries one, and a bone that is left out one."""
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
    names = ["Legacy of a hand", "Hat of a hand", "Held of a hand"]
    for name, kind in zip(names, ("ARMATURE", "OBJECT", "BONE"), strict=True):
        data = bpy.data.meshes.new(name)
        data.from_pydata([(0.1, 0.2, 0.3), (0.5, 0.2, 0.3), (0.1, 0.9, 0.3)], [], [(0, 1, 2)])
        mesh = bpy.data.objects.new(name, data)
        bpy.context.collection.objects.link(mesh)
        mesh.vertex_groups.new(name="root").add(range(3), 1.0, "REPLACE")
        mesh.parent, mesh.parent_type, mesh.parent_bone = rig, kind, "control" if kind == "BONE" else ""
        mesh.location, mesh.rotation_euler.x, mesh.delta_location.z = (0.1, 0.0, 0.4), 0.3, 0.2
    expected = [places(names, frame) for frame in FRAMES]
    read_back(export(tmp_path / f"x.{fmt}", rig, file_format=fmt, preset=preset))
    np.testing.assert_allclose([places(names, frame) for frame in FRAMES], expected, atol=1e-3)


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
    names = [name for side in SIDES for joint, name in mixamo_names(side).items() if joint]
    expected = turns(rig, names)
    select(rig)
    before = state()
    path = export(tmp_path / f"x.{fmt}", rig, file_format=fmt.removesuffix("c"))
    assert state()[:4] == before[:4]
    if fmt in ("fbx", "glb"):
        read_back(path)
        (read,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
        assert off(turns(read, names), expected) < MOST


def test_what_cannot_be_written_is_said_before(tmp_path):
    shown = linked(tmp_path / "library.blend", "instance")
    shown.select_set(True)
    bpy.context.view_layer.objects.active = shown
    for said in ("make a library override", "negative scale"):
        assert said in drawn(MANIENT_PT_export).loud
        assert "Export" in drawn(MANIENT_PT_export).grey
        with pytest.raises(RuntimeError, match=said):
            bpy.ops.manient.export_character(filepath=str(tmp_path / "x"), file_format="fbx")
        rig, _ = plain()
        rig.scale.x *= -1.0
        bpy.context.view_layer.update()
        select(rig)
    rig.scale.x *= -1.0
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="holds captured hands"):
        bpy.ops.manient.export_character(filepath=str(tmp_path / "x"), file_format="npz")
    with pytest.raises(RuntimeError, match="a mesh to hold"):
        bpy.ops.manient.export_character(filepath=str(tmp_path / "x"), file_format="abc")
    assert not list(tmp_path.glob("x*"))


def test_the_range_of_its_keys(tmp_path):
    rig, _ = plain()
    export(tmp_path / "x.bvh", rig, file_format="bvh", frame_range="KEYS")
    assert "Frames: 11\n" in (tmp_path / "x.bvh").read_text()
    rig.animation_data_clear()
    with pytest.raises(RuntimeError, match="has no keys"):
        export(tmp_path / "y.bvh", rig, file_format="bvh", frame_range="KEYS")


def test_the_panel_offers_what_is_chosen(make_take):
    from blender_manient.scene.build import build_take

    hand = build_take(make_take(sides=("left",)).take).hands[0].armature
    rig, _ = plain()
    settings = bpy.context.scene.manient
    for chosen in (rig, hand):
        select(chosen)
        panel = drawn(MANIENT_PT_export)
        assert ("export_meshes" in panel.said) == (chosen == rig)
        settings.export_format = "npz"
        assert ("npz" in drawn(MANIENT_PT_export).grey) == (chosen == rig)
        settings.export_format = "fbx"
