"""Files read back show the same hands on the same frames, as the artist left them, and nothing else: formats,
presets, ranges, and what the files say about themselves."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from blender_manient.common.blender_versions import usd_stage, use_nodes
from blender_manient.exporters import EXPORTERS
from blender_manient.exporters.export_hands import export_take
from blender_manient.panels.export import MANIENT_PT_export
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import PoseKeys, pose_at, read_pose_keys, write_pose_keys
from handfit_core.common.skeleton import FINGER_JOINTS, SIDES
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.interchange.formats.bvh import WRITER
from handfit_core.interchange.opening import read_recording
from handfit_core.media.source import Source
from handfit_core.take import Take
from tests.drawn import drawn

from .conftest import UNSEEN, blocks, built_model, evaluated_vertices, joint_heads, world, write_png
from .fbx_file import models_of, read_fbx
from .importing import assert_same_take, imported, joint_error, read_back, vertex_error

pytestmark = pytest.mark.usefixtures("registered")

BETAS = np.array([1.0, -1.0, 0.5, 0.0, 1.5, -0.5, 0.3, 0.0, -1.0, 0.8])


@pytest.fixture
def hands(make_take):
    """A take of two open hands, and what was built of it; the right one is active."""
    return build(make_take())


def build(made):
    built = build_take(made.take)
    bpy.context.view_layer.objects.active = built.hands[-1].armature
    return made, built


def write(path: Path, **options) -> Path:
    assert bpy.ops.manient.export_hand(filepath=str(path), **options) == {"FINISHED"}
    return path


def snapshot() -> list:
    """Everything that an export must leave as it was."""
    return [
        blocks(),
        [(o.name, o.data and o.data.name, [list(row) for row in o.matrix_world]) for o in bpy.data.objects],
        (bpy.context.scene.frame_current, bpy.context.mode, bpy.context.view_layer.objects.active.name),
    ]


def assert_untransformed(objects: dict, *names: str) -> None:
    for _, properties in objects.values():
        for name in names:
            expected = 1.0 if name == "Lcl Scaling" else 0.0
            np.testing.assert_allclose(properties.get(name, (expected,) * 3), expected, atol=1e-3)


def test_unity_has_nothing_to_convert(hands, tmp_path):
    path = write(tmp_path / "a.fbx", file_format="fbx", preset="UNITY")
    said = read_fbx(path).first("GlobalSettings").properties()
    assert said["UnitScaleFactor"] == 100.0  # a unit is a metre
    assert (said["UpAxis"], said["UpAxisSign"]) == (1, 1)  # Y up
    assert (said["FrontAxis"], said["FrontAxisSign"]) == (2, 1)
    assert (said["CoordAxis"], said["CoordAxisSign"]) == (0, 1)
    objects = {k: v for k, v in models_of(path).items() if v[0] in ("Null", "Mesh")}
    assert len(objects) == 4
    assert_untransformed(objects, "Lcl Rotation", "Lcl Scaling", "Lcl Translation")
    assert not [name for name in models_of(path) if name.endswith("_end")]


def test_unreal_gets_centimetres_its_own_axes_and_a_root(hands, tmp_path):
    path = write(tmp_path / "a.fbx", file_format="fbx", preset="UNREAL", active_only=True)
    file, models = read_fbx(path), models_of(path)
    said = file.first("GlobalSettings").properties()
    assert said["UnitScaleFactor"] == pytest.approx(1.0, abs=1e-6)
    assert (said["UpAxis"], said["UpAxisSign"]) == (2, 1)  # Z up
    assert (said["FrontAxis"], said["FrontAxisSign"]) == (1, -1)  # -Y to the front
    assert (said["CoordAxis"], said["CoordAxisSign"]) == (0, 1)
    assert [k for k, v in models.items() if v[0] == "Null"] == ["root"]
    assert_untransformed({k: v for k, v in models.items() if v[0] in ("Null", "Mesh")}, "Lcl Rotation")
    assert_untransformed(models, "Lcl Scaling")
    geometry = next(g for g in file.first("Objects").all("Geometry") if g.values[2] == "Mesh")
    points = np.reshape(geometry.first("Vertices").values[0], (-1, 3))
    assert 10.0 < np.ptp(points, axis=0).max() < 30.0, "a hand in centimetres"
    # Smoothing groups, without which Unreal warns.
    smoothing = geometry.first("LayerElementSmoothing")
    assert smoothing.first("MappingInformationType").values[0] == "ByPolygon"
    # The skeleton hangs on the root, and the wrist is its first bone.
    names = {n.values[0]: n.values[1].split("\x00")[0] for n in file.first("Objects").all("Model")}
    links = [c.values[1:3] for c in file.first("Connections").children if c.values[0] == "OO"]
    above = {names[child]: names[parent] for child, parent in links if {child, parent} <= names.keys()}
    assert above[bone_names("right")[0]] == "root"
    assert bone_names("left")[0] not in above
    write(path, file_format="fbx", preset="UNREAL")
    assert {k for k, v in models_of(path).items() if v[0] == "Null"} == {"left_root", "right_root"}


def glb_content(path: Path) -> dict:
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def glb_times(path: Path) -> list[tuple[float, float]]:
    """The seconds of the first and the last key of each channel."""
    content = glb_content(path)
    inputs = {s["input"] for animation in content["animations"] for s in animation["samplers"]}
    return [tuple(content["accessors"][i][end][0] for end in ("min", "max")) for i in inputs]


def test_the_artists_own_keys_and_range_are_written(make_take, tmp_path, capfd):
    made, built = build(make_take(sides=("right",)))
    armature = built.hands[0].armature
    frame = made.seen[2][1]
    quats, locations = pose_at(rig_of(armature), np.array([float(frame)]))
    write_pose_keys(
        rig_of(armature), PoseKeys.everywhere(np.array([30.0]), quats, locations + [[0.0, 0.1, 0.0]])
    )
    bpy.context.scene.frame_set(30)
    expected = joint_heads(armature, "right")
    bpy.context.scene.frame_end = 5
    for name, last in (("KEYS", 30), ("SCENE", 5)):
        path = write(tmp_path / f"{name}.glb", file_format="glb", frame_range=name)
        assert max(end for _, end in glb_times(path)) == pytest.approx(last / 30.0, abs=1e-4)
        said = "; of keys on 3 to 30 it has the scene's frames, 3 to 5: choose Keys for all"
        assert (said in capfd.readouterr().out) == (name == "SCENE")
    path = write(tmp_path / "a.fbx", file_format="fbx", frame_range="KEYS", preset="UNREAL")
    read_back(path)
    bpy.context.scene.frame_set(30)
    np.testing.assert_allclose(joint_heads(imported("right"), "right"), expected, atol=1e-3)


@pytest.mark.parametrize("preset", ["PLAIN", "UNITY", "UNREAL"])
@pytest.mark.parametrize("fmt", ["fbx", "glb"])
def test_it_comes_back_in_metres_out_of_other_units(make_take, tmp_path, fmt, preset):
    """In a scene of centimetres, with the rig moved and the thumb held by a constraint."""
    bpy.context.scene.unit_settings.scale_length = 0.01
    made, built = build(make_take(sides=("right",)))
    armature = built.hands[0].armature
    armature.location, armature.rotation_euler = (30.0, -20.0, 10.0), (0.3, 0.2, -0.4)
    thumb = armature.pose.bones[bone_names("right")[13]].constraints.new("COPY_ROTATION")
    thumb.target, thumb.subtarget = armature, bone_names("right")[1]
    frame = made.seen[3][1]
    bpy.context.scene.frame_set(frame)
    expected = joint_heads(armature, "right") * 0.01
    corners = evaluated_vertices(built.hands[0].mesh) * 0.01
    before = snapshot()
    path = write(tmp_path / f"a.{fmt}", file_format=fmt, preset=preset)
    assert snapshot() == before
    if fmt == "glb":
        content = glb_content(path)
        attributes = {a for m in content["meshes"] for p in m["primitives"] for a in p["attributes"]}
        assert ("JOINTS_1" in attributes) <= (preset != "UNITY")  # four bones per vertex
        extras = [set(node["extras"]) for node in content["nodes"] if "extras" in node]
        assert extras == [{"side", "betas", "model", "solver", "source"}], "none of the add-on's settings"
    read_back(path)
    bpy.context.scene.frame_set(frame)
    np.testing.assert_allclose(joint_heads(imported("right"), "right"), expected, atol=1e-3)
    if fmt == "fbx":
        (mesh,) = (o for o in bpy.data.objects if o.type == "MESH")
        np.testing.assert_allclose(evaluated_vertices(mesh), corners, atol=1e-3)


@pytest.mark.parametrize(
    ("fmt", "preset"),
    [
        *((fmt, preset) for fmt in ("fbx", "glb") for preset in ("PLAIN", "UNITY", "UNREAL")),
        *((fmt, "PLAIN") for fmt in ("bvh", "usd")),
    ],
)
@pytest.mark.parametrize("by", ["parent", "constraint"])
def test_a_hand_that_something_carries_moves_in_the_world(make_take, tmp_path, fmt, preset, by):
    """As one that was captured for the scene's camera, which drives past it."""
    made, built = build(make_take(sides=("right",)))
    armature, carrier = built.hands[0].armature, bpy.data.objects.new("carrier", None)
    bpy.context.collection.objects.link(carrier)
    carrier.location, carrier.rotation_euler = (1.0, 2.0, 3.0), (0.3, 0.2, -0.4)
    carrier.keyframe_insert("location", frame=made.seen[0][1])
    carrier.location.x = 2.0
    carrier.keyframe_insert("location", frame=made.seen[-1][1])
    if by == "parent":
        armature.parent = carrier
    else:
        armature.constraints.new("CHILD_OF").target = carrier
    expected = {}
    for _, frame in made.seen[:: len(made.seen) - 1]:
        bpy.context.scene.frame_set(frame)
        expected[frame] = joint_heads(armature, "right"), evaluated_vertices(built.hands[0].mesh)
    before = snapshot()
    path = write(tmp_path / f"a{EXPORTERS[fmt].suffix}", file_format=fmt, preset=preset)
    assert snapshot() == before
    read_back(path, first=bpy.context.scene.frame_start)
    for frame, (heads, skin) in expected.items():
        bpy.context.scene.frame_set(frame)
        if fmt == "usd":  # whose bones have other names
            (mesh,) = (o for o in bpy.data.objects if o.type == "MESH")
            np.testing.assert_allclose(evaluated_vertices(mesh), skin, atol=5e-4)
        else:
            np.testing.assert_allclose(joint_heads(imported("right"), "right"), heads, atol=5e-4)


def test_a_hand_whose_parent_was_deleted_is_written_where_it_is(make_take, tmp_path):
    made, built = build(make_take(sides=("right",)))
    armature, carrier = built.hands[0].armature, bpy.data.objects.new("carrier", None)
    armature.parent, carrier.location = carrier, (1.0, 2.0, 3.0)
    bpy.data.objects.remove(carrier)
    frame = made.seen[-1][1]
    bpy.context.scene.frame_set(frame)
    expected = joint_heads(armature, "right")
    read_back(write(tmp_path / "a.glb", file_format="glb"), first=bpy.context.scene.frame_start)
    bpy.context.scene.frame_set(frame)
    np.testing.assert_allclose(joint_heads(imported("right"), "right"), expected, atol=5e-4)


NO_BONES = "the bone 'wrist.R' and 15 others"


@pytest.mark.parametrize(
    ("fmt", "arguments", "words"),
    [
        ("fbx", {"bake_anim": False}, "any motion"),
        ("fbx", {"object_types": {"MESH"}}, NO_BONES),
        ("glb", {"export_animations": False}, "any motion"),
        ("glb", {"export_skins": False}, NO_BONES),
        ("usd", {"export_animation": False}, "any motion"),
        ("usd", {"export_armatures": False}, NO_BONES),
    ],
)
def test_what_blender_left_out_is_not_called_written(make_take, tmp_path, monkeypatch, fmt, arguments, words):
    build(make_take(sides=("right",)))
    exporter, there = EXPORTERS[fmt], tmp_path / f"a{EXPORTERS[fmt].suffix}"
    if fmt == "usd" and usd_stage(str(write(there, file_format=fmt))) is None:
        pytest.skip("this Blender has nothing that opens USD files")
    there.write_bytes(b"what was there")
    monkeypatch.setattr(exporter, "arguments", {**type(exporter).arguments, **arguments})
    with pytest.raises(RuntimeError, match=f"without {words}, so what was there is kept"):
        write(there, file_format=fmt)
    assert there.read_bytes() == b"what was there"


@pytest.mark.parametrize("fmt", ["fbx", "glb", "usd"])
def test_a_photos_hand_is_written(make_take, tmp_path, fmt):
    """A scene of one frame has no motion, which is no reason to refuse it."""
    _, built = build(make_take(sides=("right",), frame_numbers=np.array([7])))
    scene = bpy.context.scene
    scene.frame_start = scene.frame_end = scene.frame_current
    skin = evaluated_vertices(built.hands[0].mesh)
    read_back(write(tmp_path / f"a{EXPORTERS[fmt].suffix}", file_format=fmt), first=scene.frame_current)
    (mesh,) = (o for o in bpy.data.objects if o.type == "MESH" and len(o.data.vertices) > 500)
    found = evaluated_vertices(mesh)
    for edge in (np.min, np.max):
        np.testing.assert_allclose(edge(found, axis=0), edge(skin, axis=0), atol=1e-3)


@pytest.mark.parametrize("units", [None, 1.0, 0.01])
def test_the_take_is_what_was_captured(make_take, tmp_path, units):
    """Also where rig and camera moved together, in a scene of any unit."""
    bpy.context.scene.unit_settings.scale_length = units or 1.0
    made, built = build(make_take())
    if units:
        move = Matrix.Translation((0.4 / units, 0.2 / units, -0.1 / units))
        move @= Matrix.Rotation(0.7, 4, (1, 2, 3))
        for obj in (built.camera, *(h.armature for h in built.hands)):
            obj.matrix_world = move @ obj.matrix_world
        bpy.context.view_layer.update()
    before = snapshot()
    take = Take.load(write(tmp_path / "a.take.npz", file_format="npz"))
    assert snapshot() == before
    assert_same_take(take, made.take)


def test_the_take_has_the_artists_shape_and_keys(make_take, tmp_path):
    made, built = build(make_take(sides=("right",)))
    armature, mesh = built.hands[0].armature, built.hands[0].mesh
    armature.manient.betas = BETAS
    keys = read_pose_keys(rig_of(armature))
    turned = keys.quats.copy()
    turned[:, 4] = np.array([0.9, 0.3, 0.2, 0.1]) / np.sqrt(0.95)
    moved = PoseKeys.everywhere(keys.frames, turned, keys.locations + [0.0, 0.02, 0.01])
    write_pose_keys(rig_of(armature), moved)
    unseen = float(made.take.frame_numbers[UNSEEN])
    own = PoseKeys.everywhere(np.array([unseen, 10.0]), turned[[0, 0]], keys.locations[[0, 0]])
    write_pose_keys(rig_of(armature), own)
    take = Take.load(write(tmp_path / "mine.npz", file_format="npz"))
    (track,) = take.hands
    np.testing.assert_allclose(track.betas, BETAS, atol=1e-6)
    assert np.flatnonzero(track.filled).tolist() == [UNSEEN]  # frame 10 is none of the take's
    assert not track.detected[UNSEEN]
    assert np.isnan(track.reprojection_error[UNSEEN])
    model = built_model("open-hand", "right")
    for row, frame in (made.seen[4], (UNSEEN, int(unseen))):
        bpy.context.scene.frame_set(frame)
        posed = model.posed(track.betas, track.global_orient[row], track.hand_pose[row], track.transl[row])
        np.testing.assert_allclose(evaluated_vertices(mesh), world(posed.vertices), atol=1e-4)
        np.testing.assert_allclose(track.joints_3d[row], posed.keypoints, atol=1e-6)
    row, frame = made.seen[4]
    pixels = take.intrinsics.project(track.joints_3d[row])
    expected = np.linalg.norm(pixels - track.keypoints_2d[row], axis=-1).mean()
    assert track.reprojection_error[row] == pytest.approx(expected, abs=1e-6)
    assert expected > made.take.hands[0].reprojection_error[row] + 1.0
    again = build_take(take)
    bpy.context.scene.frame_set(frame)
    found = evaluated_vertices(again.hands[0].mesh)
    np.testing.assert_allclose(found, evaluated_vertices(mesh), atol=1e-4)


def test_a_format_that_this_blender_lacks_is_grey(hands, tmp_path, monkeypatch):
    monkeypatch.setattr(EXPORTERS["usd"], "operator", "wm.no_such_operator", raising=False)
    with pytest.raises(RuntimeError, match="this Blender cannot write usd"):
        bpy.ops.manient.export_hand(filepath=str(tmp_path / "x"), file_format="usd")
    bpy.context.scene.manient.export_format = "usd"
    panel = drawn(MANIENT_PT_export)
    assert {"usd", "Export"} <= set(panel.grey)
    assert "missing in this build of Blender" in panel.said
    bpy.context.scene.manient.export_format = "glb"  # the operator's default from here on
    assert "Export" not in drawn(MANIENT_PT_export).grey
    bpy.ops.manient.export_hand(filepath=str(tmp_path / "x.fbx"))
    assert [p.name for p in tmp_path.iterdir()] == ["x.glb"]


def test_what_cannot_be_written_is_one_sentence(hands, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    for fmt in ("fbx", "npz"):
        with pytest.raises(RuntimeError, match="cannot write here") as caught:
            bpy.ops.manient.export_hand(filepath=str(tmp_path / "file" / "x"), file_format=fmt)
        assert "Traceback" not in str(caught.value)
    with pytest.raises(RuntimeError, match="choose a file"):
        bpy.ops.manient.export_hand(file_format="fbx")
    for hand in hands[1].hands:
        hand.armature.animation_data_clear()
    with pytest.raises(RuntimeError, match="have no keys"):
        bpy.ops.manient.export_hand(filepath=str(tmp_path / "x"), file_format="fbx", frame_range="KEYS")


def test_what_hangs_on_a_hand_stays_behind(hands, tmp_path, capfd):
    armature = hands[1].hands[1].armature
    data = bpy.data.meshes.new("A_ring")
    data.from_pydata([(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0)], [], [(0, 1, 2)])
    ring = bpy.data.objects.new("A_ring", data)
    bpy.context.scene.collection.objects.link(ring)
    ring.parent = armature
    ring.modifiers.new("Armature", "ARMATURE").object = armature
    for preset in ("PLAIN", "UNITY", "UNREAL"):
        path = write(tmp_path / f"{preset}.fbx", file_format="fbx", preset=preset, active_only=True)
        meshes = [name for name, (kind, _) in models_of(path).items() if kind == "Mesh"]
        assert meshes == [f"mesh of {armature.name}"]
        assert "without A_ring" in capfd.readouterr().out
    for fmt in ("glb", "usd", "abc"):
        if not EXPORTERS[fmt].why_not():
            path = write(tmp_path / "a", file_format=fmt).with_name("a" + EXPORTERS[fmt].suffix)
            assert b"A_ring" not in path.read_bytes()


@pytest.mark.parametrize(
    ("fmt", "preset"),
    [("fbx", "PLAIN"), ("glb", "PLAIN"), ("usd", "PLAIN"), ("abc", "PLAIN"), ("fbx", "UNREAL")],
)
@pytest.mark.parametrize("by", ["constraint", "bone"])
def test_what_a_hand_holds_comes_back_in_it(hands, tmp_path, fmt, preset, by):
    made, built = hands
    armature = built.hands[-1].armature
    frames = [frame for _, frame in made.seen]
    bpy.ops.mesh.primitive_cone_add(vertices=5, radius1=0.03, depth=0.2, location=(0.3, 0.2, 0.1))
    held = bpy.context.object
    held.name = held.data.name = "stick in hand"
    held.scale = (1.0, 1.5, 2.0)
    held.modifiers.new("Thick", "SOLIDIFY").thickness = 0.01
    bone = bone_names("right")[0]
    if by == "bone":
        held.parent, held.parent_type, held.parent_bone = armature, "BONE", bone
    else:
        child = held.constraints.new("CHILD_OF")
        child.target, child.subtarget = armature, bone
        for frame, influence in ((frames[2] - 1, 0.0), (frames[2], 1.0)):
            child.influence = influence
            child.keyframe_insert("influence", frame=frame)
    # Either hand holds it, and a file has it once.
    held.constraints.new("CHILD_OF").target = built.hands[0].armature
    held.constraints[-1].influence = 0.0
    bpy.context.view_layer.objects.active = armature
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = frames[0], frames[-1]

    def shown():
        places = {}
        for frame in frames:
            bpy.context.scene.frame_set(frame)
            (found,) = [o for o in bpy.data.objects if o.type == "MESH" and o.name.startswith("stick")]
            places[frame] = evaluated_vertices(found)
        return places

    before, now = shown(), snapshot()
    assert np.ptp([p.mean(0) for p in before.values()], axis=0).max() > 0.01, "it moves"
    ending, options = EXPORTERS[fmt].suffix, {"file_format": fmt, "preset": preset}
    path = write(tmp_path / f"a{ending}", **options)
    assert snapshot() == now
    assert b"stick" not in write(tmp_path / f"b{ending}", **options, held=False).read_bytes()
    read_back(path)
    after = shown()
    for frame, expected in before.items():
        away = np.linalg.norm(expected[:, None] - after[frame], axis=-1)
        assert max(away.min(0).max(), away.min(1).max()) < 1e-4
    if fmt in ("fbx", "glb"):
        assert joint_error(made) < 1e-4


@pytest.mark.parametrize(
    ("fmt", "preset"),
    [(fmt, "PLAIN") for fmt in ("npz", "fbx", "glb", "abc")] + [("fbx", "UNREAL"), ("glb", "UNITY")],
)
def test_hidden_hands_at_rest_are_written_as_they_move(hands, tmp_path, fmt, preset):
    made, built = hands
    for hand in built.hands:
        hand.armature.data.pose_position = "REST"
    hidden = (built.camera, *(o for hand in built.hands for o in (hand.armature, hand.mesh)))
    for obj in hidden:
        obj.hide_viewport = obj.hide_render = True
    built.collection.hide_viewport = True
    bpy.context.scene.frame_set(3)
    path = write(tmp_path / f"a.{fmt}", file_format=fmt, preset=preset)
    assert all(obj.hide_viewport and obj.hide_render for obj in hidden)
    assert {hand.armature.data.pose_position for hand in built.hands} == {"REST"}
    if fmt == "npz":
        assert_same_take(Take.load(path), made.take)
    else:
        read_back(path)
        assert (vertex_error if fmt == "abc" else joint_error)(made) < 1e-3


SECRET = "folder_of_a_secret_project"


@pytest.mark.parametrize(
    ("fmt", "preset"), [*((fmt, "PLAIN") for fmt in ("glb", "fbx", "usd", "bvh", "abc")), ("fbx", "UNREAL")]
)
def test_no_folder_leaves_in_an_export(make_take, tmp_path, monkeypatch, fmt, preset):
    """Of the picture, the model, a texture, the open file and the file itself only names are told."""
    if EXPORTERS[fmt].why_not():
        pytest.skip(f"this Blender cannot write {fmt}")
    secret = tmp_path / SECRET
    secret.mkdir()
    source = Source("photo", (str(secret / "hand.png"),))
    _, built = build(make_take(sides=("right",), source=source))
    armature, mesh = built.hands[0].armature, built.hands[0].mesh
    armature["model"] = str(secret / "MANO_RIGHT.pkl")
    before = [armature[key] for key in ("source", "model", "side")]
    material = bpy.data.materials.new("Skin")
    nodes = use_nodes(material).nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.load(str(write_png(secret / "skin.png", np.ones((4, 4, 4)))))
    color = nodes["Principled BSDF"].inputs["Base Color"]
    material.node_tree.links.new(texture.outputs["Color"], color)
    mesh.data.materials.clear()
    mesh.data.materials.append(material)
    bpy.ops.wm.save_as_mainfile(filepath=str(secret / "scene of a hand.blend"))
    if fmt == "usd":  # the same as text, whose writer compresses nothing
        monkeypatch.setattr(EXPORTERS["usd"], "suffix", ".usda")
        monkeypatch.setattr(EXPORTERS["usd"], "is_whole", lambda _stream, _size: True)
    path = write(secret / f"out{EXPORTERS[fmt].suffix}", file_format=fmt, preset=preset)
    content = path.read_bytes()
    assert SECRET.encode() not in content
    assert str(tmp_path).encode() not in content
    kept = {"fbx": ("hand.png", "MANO_RIGHT.pkl", "skin.png"), "glb": ("hand.png", "MANO_RIGHT.pkl")}
    for name in kept.get(fmt, ("scene of a hand.blend",) if fmt == "abc" else ()):
        assert name.encode() in content
    if fmt == "abc":
        bpy.ops.wm.alembic_import(filepath=str(path), as_background_job=False)  # it can still be read
    assert [armature[key] for key in ("source", "model", "side")] == before


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


@pytest.mark.parametrize(("count", "names"), [(1, ["x"]), (3, ["x_left", "x_left2", "x_left3"])])
def test_each_hand_has_a_name_of_its_own(make_take, tmp_path, count, names):
    take = make_take(sides=("left",) * count).take
    files = export_take(build_take(take), take, tmp_path, "x", "bvh")
    assert [f.name for f in files] == [f"{name}.bvh" for name in names]


@pytest.mark.parametrize("fps", [12.5, 30000 / 1001])
def test_gltf_keeps_the_time(make_take, tmp_path, fps):
    """Read from the file itself: Blender's importer would undo a mistake of its exporter."""
    made = make_take(sides=("right",), fps=fps)
    (path,) = export_take(build_take(made.take), made.take, tmp_path, "timed", "glb")
    spans = [last - first for first, last in glb_times(path)]
    frames = int(made.take.frame_numbers[-1] - made.take.frame_numbers[0])
    assert max(spans) == pytest.approx(frames / fps, rel=1e-4)


@pytest.mark.parametrize("side", SIDES)
def test_the_core_reads_the_bvh_that_blender_exports(make_take, tmp_path, side):
    """It finds the captured angles, places and shape of the hand, in the frames where it was seen."""
    made = make_take(sides=(side,))
    (path,) = export_take(build_take(made.take), made.take, tmp_path, "x", "bvh")
    (hand,), track = read_recording(path).posed, made.take.hands[0]
    model = load_model(made.take.model, side)
    for row, frame in made.seen:
        at = frame - int(made.take.frame_numbers[0])
        for name in ("global_orient", "hand_pose"):
            ours, theirs = (
                rotvec_to_rotmat(getattr(t, name)[i].reshape(-1, 3)) for t, i in ((hand, at), (track, row))
            )
            np.testing.assert_allclose(ours, theirs, atol=2e-3)
        joints = model.posed(hand.betas, hand.global_orient[at], hand.hand_pose[at], hand.transl[at]).joints
        np.testing.assert_allclose(joints, made.joints[side][row], atol=3e-4)


def test_blender_reads_the_bvh_that_the_core_writes(make_take, tmp_path):
    made = make_take(frame_numbers=np.arange(1, 5))
    WRITER.write(made.take, tmp_path / "hands.bvh")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_anim.bvh(filepath=str(tmp_path / "hands.bvh"), global_scale=0.01, update_scene_fps=True)
    (armature,) = bpy.data.objects
    assert bpy.context.scene.render.fps == 30
    for row, frame in made.seen:
        bpy.context.scene.frame_set(frame)
        for track in made.take.hands:
            side = track.side.title()
            bones = [f"{side}Hand"]
            for finger in FINGER_JOINTS:
                bones += [
                    f"{side}Hand{'Pinky' if finger == 'little' else finger.title()}{n}" for n in (1, 2, 3)
                ]
            heads = np.array([armature.matrix_world @ armature.pose.bones[bone].head for bone in bones])
            order = [0, *(joint for chain in FINGER_JOINTS.values() for joint in chain)]
            np.testing.assert_allclose(heads, world(made.joints[track.side][row][order]), atol=5e-5)
