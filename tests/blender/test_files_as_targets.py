"""Characters in other programs' files: in, hands on, and out again, in batches and in the window."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient import command
from blender_manient.common.blender_versions import usd_stage
from blender_manient.exporters import exporter, imports
from blender_manient.operators.drop_character import MANIENT_FH_character
from blender_manient.scene.build import build_take
from blender_manient.scene.timing import frame_rate
from handfit_core.media.source import Source

from .characters import BoneSpec, build_armature, hand_specs, mixamo_names
from .conftest import blocks, shown_bones
from .looking import keyed_bones
from .test_command import report
from .test_export_character import skinned

pytestmark = pytest.mark.usefixtures("registered")

BODY = ("Hips", "LeftForeArm", "RightForeArm")
FINGER = tuple(mixamo_names("left", "").values())[1:]


def hero(name: str = "Hero") -> bpy.types.Object:
    """As Mixamo writes them: in centimetres, with a textured skin."""
    specs = [BoneSpec("Hips", "", (0, 0, 90), (0, 0, 130))]
    for side, x in (("left", 1.0), ("right", -1.0)):
        arm, place = f"{side.capitalize()}ForeArm", np.array([x * 70.0, 0.0, 140.0])
        specs.append(BoneSpec(arm, "Hips", (x * 42, 2, 140), place))
        rng, names = np.random.default_rng(3), mixamo_names(side, "")
        specs += hand_specs(side, rng, names=names, parent=arm, place=place, scale=100.0)
    rig = build_armature(specs, name)
    rig.scale = (0.01, 0.01, 0.01)
    skinned(rig, [spec.name for spec in specs])
    cloth, image = bpy.data.materials.new("Cloth"), bpy.data.images.new("cloth.png", 4, 4)
    image.pixels = 16 * (0.2, 0.4, 0.6, 1.0)
    image.pack()
    cloth.use_nodes = True
    nodes = cloth.node_tree.nodes
    nodes.new("ShaderNodeTexImage").image = image
    cloth.node_tree.links.new(nodes[-1].outputs[0], nodes["Principled BSDF"].inputs["Base Color"])
    skin = next(child for child in rig.children if child.name.startswith("Skin"))
    skin.data.uv_layers.new()
    skin.data.materials.append(cloth)
    return rig


def animated(rig: bpy.types.Object) -> None:
    """The body moves, one bone also away from the end of the one above, and so does a prop."""
    rng = np.random.default_rng(7)
    prop = bpy.data.objects.new("Prop", bpy.data.meshes.new("Prop"))
    prop.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    bpy.context.collection.objects.link(prop)
    for frame in (0, 12, 24):
        for name in BODY:
            bone = rig.pose.bones[name]
            bone.rotation_mode = "QUATERNION"
            bone.rotation_quaternion = (1.0, *rng.uniform(-0.4, 0.4, 3))
            bone.rotation_quaternion.normalize()  # type: ignore
            bone.keyframe_insert("rotation_quaternion", frame=frame)
        rig.pose.bones["LeftHand"].location.y = 0.3 * frame
        rig.pose.bones["LeftHand"].keyframe_insert("location", frame=frame)
        prop.location.x = frame / 12
        prop.keyframe_insert("location", frame=frame)


def written(path: Path) -> Path:
    """The open file as other programs' files are, at 24 frames per second."""
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = 24, 0, 24
    match path.suffix:
        case ".fbx":
            bpy.ops.export_scene.fbx(
                filepath=str(path), add_leaf_bones=False, bake_anim_simplify_factor=0.0, path_mode="COPY",
                embed_textures=True, bake_anim_use_all_actions=False, bake_anim_use_nla_strips=False,
            )  # fmt: skip
        case ".gltf":
            bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLTF_SEPARATE")
        case ".glb" | ".vrm":
            bpy.ops.export_scene.gltf(filepath=str(path.with_suffix(".glb")))
            path.with_suffix(".glb").rename(path)
        case _:
            bpy.ops.wm.usd_export(filepath=str(path), export_animation=True)
    return path


def apply(tmp_path: Path, *arguments: object) -> int:
    return command.main(["apply", *map(str, arguments), "-o", str(tmp_path / "out"), "--no-sheet"])


@pytest.fixture
def clip(make_take, tmp_path) -> Path:
    take = make_take(source=Source("video", ("hands.mp4",))).take
    return take.save(tmp_path / "clip.take.npz")


def poses(rig: bpy.types.Object, *seconds: float) -> list[Mapping[str, np.ndarray]]:
    """Each bone in the world, by its name as USD has it too."""
    found = []
    for second in seconds:
        bones = shown_bones(rig, round(second * frame_rate(bpy.context.scene)))
        found.append({bone.name: np.array(rig.matrix_world @ bone.matrix) for bone in bones})
    return found


def apart(found: list, expected: list, names: tuple[str, ...]) -> tuple[float, float]:
    """Degrees and metres by which bones differ at the most."""
    angles, ways = [0.0], [0.0]
    for one, other in zip(found, expected, strict=True):
        for name in names:
            a, b = one[name], other[name]
            turns = [m[:3, :3] / np.linalg.norm(m[:3, :3], axis=0) for m in (a, b)]
            cosine = (np.trace(turns[0].T @ turns[1]) - 1.0) / 2.0
            angles.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
            ways.append(float(np.linalg.norm(a[:3, 3] - b[:3, 3])))
    return max(angles), max(ways)


def plainly_imported(path: Path, fps: int = 24) -> bpy.types.Object:
    """As anybody does it: by Blender's own importer, and nothing of ours."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = fps
    match path.suffix:
        case ".fbx":
            bpy.ops.import_scene.fbx(filepath=str(path), anim_offset=0.0)
        case ".glb":
            bpy.ops.import_scene.gltf(filepath=str(path), bone_heuristic="BLENDER", disable_bone_shape=True)
        case ".usdc":
            bpy.ops.wm.usd_import(filepath=str(path))
        case ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(path))
    (rig,) = (o for o in bpy.data.objects if o.type == "ARMATURE")
    return rig


AT = (0.0, 1 / 3, 0.5, 1.0)
"""seconds, whole frames at 24, 30 and 60 a second"""


def moving(path: Path) -> tuple[list[Mapping[str, np.ndarray]], Path]:
    """Such a character's file, and its poses AT."""
    rig = hero()
    animated(rig)
    found = poses(rig, *AT), written(path)
    if ".usd" in path.suffix and usd_stage(str(path)) is None:
        pytest.skip("this Blender has nothing that opens USD files")
    return found


@pytest.mark.parametrize("ending", ["fbx", "glb", "gltf", "vrm", "usda", "usdz"])
def test_it_comes_back_with_the_fingers_that_the_viewport_shows(clip, tmp_path, ending):
    """At its own rate, with its body's motion, its prop, its skin and its texture."""
    body, path = moving(tmp_path / f"hero.{ending}")
    assert apply(tmp_path, clip, "--to", path) == 0
    (entry,) = report(tmp_path)
    (made,) = (tmp_path / "out" / "clip" / name for name in ("clip.fbx", "clip.glb", "clip.usdc")
               if f"clip/{name}" in entry["files"])  # fmt: skip
    assert entry["warnings"] == []
    assert apply(tmp_path, clip, "--to", path, "--format", "blend") == 0
    shown = poses(plainly_imported(made.with_suffix(".blend")), *AT)
    rate = round(frame_rate(bpy.context.scene))
    assert rate == (24 if ending[0] in "fu" else 30)  # glTF has no rate
    rig = plainly_imported(made, rate)
    found = poses(rig, *AT)
    angle, way = apart(found, shown, FINGER)
    assert angle < 0.5
    assert way < 1e-3
    angle, way = apart(found, body, (*BODY, "LeftHand", "RightHand"))
    assert angle < 0.1
    assert way < 1e-3
    assert apart(found, body, FINGER)[0] > 10.0
    worn = {o.name: [slot.material.name for slot in o.material_slots] for o in bpy.data.objects}
    assert worn["Skin_of_a_hand"] == ["Cloth"]
    assert [tuple(image.size) for image in bpy.data.images if image.type == "IMAGE"] == [(4, 4)]
    bpy.context.scene.frame_set(rate)
    bpy.context.view_layer.update()
    assert bpy.data.objects["Prop"].matrix_world.translation.x == pytest.approx(2.0, abs=1e-3)


def test_a_pose_that_is_not_the_rest(clip, tmp_path):
    rig = hero()
    for name in (*BODY, *FINGER):
        rig.pose.bones[name].rotation_mode = "XYZ"
        rig.pose.bones[name].rotation_euler = (0.3, 0.2, -0.1)
    bpy.context.view_layer.update()
    body = poses(rig, 0.0)
    assert apply(tmp_path, clip, "--to", written(tmp_path / "hero.fbx"), "--format", "fbx,blend") == 0
    made = tmp_path / "out" / "clip" / "clip.fbx"
    at = (0.1, 0.4)
    shown = poses(plainly_imported(made.with_suffix(".blend")), *at)
    assert apart(shown, 2 * body, BODY)[0] < 0.1
    found = poses(plainly_imported(made, 30), *at)
    assert apart(found, shown, (*FINGER, *BODY))[0] < 0.5


def test_of_several_animations_the_liveliest_is_kept_and_others_are_named(clip, tmp_path):
    """Blender's exporter writes each for every object, and its importer takes the first."""
    rig = hero()
    animated(rig)
    body, walk = poses(rig, *AT), rig.animation_data.action
    hips = rig.pose.bones["Hips"]
    for name, turn in (("A-pose", 0.0), ("Idle", 1.0)):
        rig.animation_data.action = action = bpy.data.actions.new(name)
        action.use_fake_user = True
        for frame in (1, 20):
            hips.rotation_quaternion = (1.0, turn * frame / 20, 0.0, 0.0)
            hips.keyframe_insert("rotation_quaternion", frame=frame)
    rig.animation_data.action = walk
    path = tmp_path / "hero.fbx"
    bpy.context.scene.render.fps = 24
    bpy.ops.export_scene.fbx(filepath=str(path), bake_anim_simplify_factor=0.0)
    assert apply(tmp_path, clip, "--to", path) == 0
    (warning,) = report(tmp_path)[0]["warnings"]
    assert ".blend files alone keep Hero|Hero|Idle" in warning
    assert "pose" not in warning
    found = poses(plainly_imported(tmp_path / "out" / "clip" / "clip.fbx"), *AT)
    assert apart(found, body, BODY)[0] < 0.1


DAMAGED = "it may be damaged or cut off, as Blender could not import it: export it again"


def wrong(path: Path) -> str:
    """Make a file that cannot get hands. Returns what is said of it."""
    match path.stem:
        case "empty":
            bpy.ops.mesh.primitive_cube_add()
            written(path)
            return "there is no armature in it"
        case "ten":
            for number in range(10):
                build_armature([BoneSpec("root", "", (0, 0, 0), (0, 0, 1))], f"Extra{number}")
            written(path)
            return "there are several armatures (Extra0, Extra1, "
        case "mirrored":
            hero().scale.x *= -1.0
            written(path)
            return "has a negative scale"
        case "half":
            hero()
            content = written(path).read_bytes()
            path.write_bytes(content[: len(content) // 2])
            return DAMAGED
        case "words":
            path.write_text("; FBX 7.3.0 project file\nthese are words")
            return DAMAGED
    raise ValueError(path)


@pytest.mark.parametrize("ending", ["fbx", "glb", "usdc"])
def test_what_cannot_work_is_one_sentence(clip, tmp_path, capfd, ending):
    for name in ("empty", "ten", "mirrored", "half", "words"):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        path = tmp_path / f"{name}.{ending}"
        expected = wrong(path)
        capfd.readouterr()
        assert apply(tmp_path, clip, "--to", path) == 2, name
        said = capfd.readouterr().err
        (error,) = (line for line in said.splitlines() if line.startswith("error: "))
        assert expected in error
        assert "Traceback" not in said
    assert not (tmp_path / "out").exists()


def test_importers_that_are_missing_and_other_endings(clip, tmp_path, capfd, monkeypatch):
    hero()
    path = written(tmp_path / "hero.fbx")
    for module in (imports, exporter):
        monkeypatch.setattr(module, "has_operator", lambda name: "fbx" not in name)
    (tmp_path / "hero.obj").write_text("v 0 0 0")
    said = "what imports .fbx files is switched off with its add-on; enable that in Blender's preferences"
    for file, expected in ((path, said), (tmp_path / "hero.obj", "is one of .blend, .fbx, ")):
        assert apply(tmp_path, clip, "--to", file, "--format", "glb") == 2
        assert expected in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("ending", ["fbx", "glb", "usdc"])
def test_dropped_in_the_window(make_take, tmp_path, ending):
    """The scene keeps its time, and the file's motion its seconds."""
    body, path = moving(tmp_path / f"hero.{ending}")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert ending in MANIENT_FH_character.bl_file_extensions
    build_take(make_take().take)
    scene = bpy.context.scene
    time = [scene.render.fps, scene.frame_start, scene.frame_end] = [60, 5, 90]
    assert bpy.ops.manient.put_on_file(filepath=str(path)) == {"FINISHED"}
    assert [scene.render.fps, scene.frame_start, scene.frame_end] == time
    rig = bpy.context.active_object
    assert {*FINGER} <= keyed_bones(rig)
    names = tuple(name for name in BODY if name in rig.data.bones)
    assert apart(poses(rig, *AT), body, names)[0] < 1.0


def test_dropped_files_that_cannot_work(make_take, tmp_path):
    wrong(tmp_path / "half.fbx")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build_take(make_take().take)
    before = blocks()
    with pytest.raises(RuntimeError, match=r"half\.fbx"):
        bpy.ops.manient.put_on_file(filepath=str(tmp_path / "half.fbx"))
    assert blocks() == before
    bpy.ops.wm.read_factory_settings(use_empty=True)
    wrong(tmp_path / "ten.fbx")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build_take(make_take().take)
    assert bpy.ops.manient.put_on_file(filepath=str(tmp_path / "ten.fbx")) == {"FINISHED"}
    assert not any("hands" in action.name for action in bpy.data.actions if "Extra" in action.name)
