"""Exporting hands as the artist left them: presets, ranges, and what the files say about themselves."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from blender_manient.common.blender_versions import use_nodes
from blender_manient.exporters import EXPORTERS
from blender_manient.panels.export import MANIENT_PT_export
from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import PoseKeys, pose_at, read_pose_keys, write_pose_keys
from handfit_core.media.source import Source
from handfit_core.take import Take
from tests.drawn import drawn

from .conftest import UNSEEN, built_model, evaluated_vertices, joint_heads, world, write_png
from .fbx_file import read_fbx
from .importing import imported, joint_error, read_back, vertex_error

pytestmark = pytest.mark.usefixtures("registered")

BETAS = np.array([1.0, -1.0, 0.5, 0.0, 1.5, -0.5, 0.3, 0.0, -1.0, 0.8])


def build(made):
    """Two hands, the right one active."""
    built = build_take(made.take)
    bpy.context.view_layer.objects.active = built.hands[1].armature
    return made, built


@pytest.fixture
def hands(make_take):
    """A built take of two open hands."""
    return build(make_take())


@pytest.fixture
def all_hands(make_take, model):
    """The same of every kind of model, also with shape keys."""
    return build(make_take(model=model))


def write(path: Path, **options) -> Path:
    assert bpy.ops.manient.export_hand(filepath=str(path), **options) == {"FINISHED"}
    return path


def snapshot() -> list:
    """Everything that an export must leave as it was."""
    return [
        sorted((o.name, o.data.name if o.data else "") for o in bpy.data.objects),
        sorted(a.name for a in bpy.data.actions),
        sorted(m.name for m in bpy.data.meshes),
        sorted(a.name for a in bpy.data.armatures),
        len(bpy.data.scenes),
        bpy.context.scene.frame_current,
        [[list(row) for row in o.matrix_world] for o in bpy.data.objects],
        bpy.context.mode,
        bpy.context.view_layer.objects.active.name,
    ]


@pytest.mark.parametrize("preset", ["PLAIN", "UNITY", "UNREAL"])
@pytest.mark.parametrize("fmt", ["fbx", "glb"])
def test_it_comes_back_where_it_was(all_hands, tmp_path, fmt, preset):
    made, _ = all_hands
    before = snapshot()
    path = write(tmp_path / f"a.{fmt}", file_format=fmt, preset=preset)
    assert snapshot() == before
    if fmt == "glb":
        content = glb_content(path)
        attributes = {a for m in content["meshes"] for p in m["primitives"] for a in p["attributes"]}
        assert ("JOINTS_1" in attributes) <= (preset != "UNITY")  # four bones per vertex
        extras = [set(node["extras"]) for node in content["nodes"] if "extras" in node]
        assert extras == [{"side", "betas", "model", "solver", "source"}] * 2, "none of the add-on's settings"
    read_back(path)
    assert joint_error(made) < 1e-3
    if fmt == "fbx":
        assert vertex_error(made) < 1e-3


def models_of(path: Path) -> dict:
    """Name -> (kind, properties) of the file's nodes."""
    nodes = read_fbx(path).first("Objects").all("Model")
    return {n.values[1].split("\x00")[0]: (n.values[2], n.properties()) for n in nodes}


def test_unity_has_nothing_to_convert(hands, tmp_path):
    path = write(tmp_path / "a.fbx", file_format="fbx", preset="UNITY")
    said = read_fbx(path).first("GlobalSettings").properties()
    assert said["UnitScaleFactor"] == 100.0  # a unit is a metre
    assert (said["UpAxis"], said["UpAxisSign"]) == (1, 1)  # Y up
    assert (said["FrontAxis"], said["FrontAxisSign"]) == (2, 1)
    assert (said["CoordAxis"], said["CoordAxisSign"]) == (0, 1)
    objects = {k: v for k, v in models_of(path).items() if v[0] in ("Null", "Mesh")}
    assert len(objects) == 4
    for _, properties in objects.values():
        np.testing.assert_allclose(properties.get("Lcl Rotation", (0, 0, 0)), 0.0, atol=1e-3)
        np.testing.assert_allclose(properties.get("Lcl Scaling", (1, 1, 1)), 1.0, atol=1e-5)
        np.testing.assert_allclose(properties.get("Lcl Translation", (0, 0, 0)), 0.0, atol=1e-6)
    assert not [name for name in models_of(path) if name.endswith("_end")]


def test_unreal_gets_centimetres_its_own_axes_and_a_root(hands, tmp_path):
    path = write(tmp_path / "a.fbx", file_format="fbx", preset="UNREAL", active_only=True)
    file = read_fbx(path)
    said = file.first("GlobalSettings").properties()
    assert said["UnitScaleFactor"] == pytest.approx(1.0, abs=1e-6)
    assert (said["UpAxis"], said["UpAxisSign"]) == (2, 1)  # Z up
    assert (said["FrontAxis"], said["FrontAxisSign"]) == (1, -1)  # -Y to the front
    assert (said["CoordAxis"], said["CoordAxisSign"]) == (0, 1)
    models = models_of(path)
    objects = {k: v for k, v in models.items() if v[0] in ("Null", "Mesh")}
    assert [k for k, v in objects.items() if v[0] == "Null"] == ["root"]
    assert "Armature" not in models
    for _, properties in objects.values():
        np.testing.assert_allclose(properties.get("Lcl Rotation", (0, 0, 0)), 0.0, atol=1e-3)
        np.testing.assert_allclose(properties.get("Lcl Scaling", (1, 1, 1)), 1.0, atol=1e-5)
    # Every bone's scale is 1 too, and lengths are a hand's in centimetres.
    for kind, properties in models.values():
        if kind == "LimbNode":
            np.testing.assert_allclose(properties.get("Lcl Scaling", (1, 1, 1)), 1.0, atol=1e-4)
    geometry = next(g for g in file.first("Objects").all("Geometry") if g.values[2] == "Mesh")
    points = geometry.first("Vertices").values[0].reshape(-1, 3)
    assert 10.0 < np.ptp(points, axis=0).max() < 30.0
    # Smoothing groups, without which Unreal warns.
    smoothing = geometry.first("LayerElementSmoothing")
    assert smoothing.first("MappingInformationType").values[0] == "ByPolygon"
    # The skeleton hangs on the root, and the wrist is its first bone.
    names = {n.values[0]: n.values[1].split("\x00")[0] for n in file.first("Objects").all("Model")}
    above = {
        names[c.values[1]]: names.get(c.values[2])
        for c in file.first("Connections").children
        if c.values[0] == "OO" and c.values[1] in names and c.values[2] in (0, *names)
    }
    assert above[bone_names("right")[0]] == "root"
    assert not [name for name in above if bone_names("left")[0] == name]


def test_two_roots_have_two_names(hands, tmp_path):
    path = write(tmp_path / "a.fbx", file_format="fbx", preset="UNREAL")
    assert {k for k, v in models_of(path).items() if v[0] == "Null"} == {"left_root", "right_root"}


def glb_content(path: Path) -> dict:
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def test_the_artists_own_keys_and_range_are_written(make_take, tmp_path):
    made = make_take(sides=("right",))
    built = build_take(made.take)
    armature = built.hands[0].armature
    bpy.context.view_layer.objects.active = armature
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
        content = glb_content(path)
        inputs = {s["input"] for animation in content["animations"] for s in animation["samplers"]}
        ends = {content["accessors"][i]["max"][0] for i in inputs}
        assert max(ends) == pytest.approx(last / 30.0, abs=1e-4)
    path = write(tmp_path / "a.fbx", file_format="fbx", frame_range="KEYS", preset="UNREAL")
    read_back(path)
    bpy.context.scene.frame_set(30)
    np.testing.assert_allclose(joint_heads(imported("right"), "right"), expected, atol=1e-3)


@pytest.mark.parametrize("preset", ["PLAIN", "UNITY", "UNREAL"])
@pytest.mark.parametrize("fmt", ["fbx", "glb"])
def test_other_units_a_moved_rig_and_constraints(make_take, tmp_path, fmt, preset):
    """In a scene of centimetres, with the rig moved and the thumb held by a constraint."""
    made = make_take(sides=("right",))
    bpy.context.scene.unit_settings.scale_length = 0.01
    built = build_take(made.take)
    armature = built.hands[0].armature
    bpy.context.view_layer.objects.active = armature
    armature.location = (30.0, -20.0, 10.0)
    armature.rotation_euler = (0.3, 0.2, -0.4)
    thumb = armature.pose.bones[bone_names("right")[13]].constraints.new("COPY_ROTATION")
    thumb.target, thumb.subtarget = armature, bone_names("right")[1]
    frame = made.seen[3][1]
    bpy.context.scene.frame_set(frame)
    expected = joint_heads(armature, "right") * 0.01
    assert 0.1 < np.ptp(expected, axis=0).max() < 0.3
    path = write(tmp_path / f"a.{fmt}", file_format=fmt, preset=preset)
    assert armature.name == built.hands[0].armature.name
    read_back(path)
    bpy.context.scene.frame_set(frame)
    np.testing.assert_allclose(joint_heads(imported("right"), "right"), expected, atol=1e-3)


def test_the_take_is_what_was_captured_while_nothing_is_changed(hands, tmp_path):
    made, _ = hands
    before = snapshot()
    take = Take.load(write(tmp_path / "a.take.npz", file_format="npz"))
    assert snapshot() == before
    assert_same_take(take, made.take)


def assert_same_take(found: Take, expected: Take) -> None:
    np.testing.assert_array_equal(found.frame_numbers, expected.frame_numbers)
    for one, other in zip(found.hands, expected.hands, strict=True):
        assert one.side == other.side
        np.testing.assert_array_equal(one.detected, other.detected)
        np.testing.assert_allclose(one.betas, other.betas, atol=1e-5)
        np.testing.assert_allclose(one.transl, other.transl, atol=1e-5)
        np.testing.assert_allclose(one.joints_3d, other.joints_3d, atol=2e-5)
        np.testing.assert_allclose(one.hand_pose, other.hand_pose, atol=1e-4)
        np.testing.assert_allclose(one.keypoints_2d, other.keypoints_2d, atol=1e-3)
        np.testing.assert_allclose(one.reprojection_error, other.reprojection_error, atol=2e-2)
        assert np.isnan(one.transl[UNSEEN]).all()


@pytest.mark.parametrize("units", [1.0, 0.01])
def test_the_take_does_not_see_that_rig_and_camera_moved_together(make_take, tmp_path, units):
    made = make_take()
    bpy.context.scene.unit_settings.scale_length = units
    built = build_take(made.take)
    bpy.context.view_layer.objects.active = built.hands[0].armature
    move = Matrix.Translation((0.4 / units, 0.2 / units, -0.1 / units)) @ Matrix.Rotation(0.7, 4, (1, 2, 3))
    for obj in (built.camera, *(h.armature for h in built.hands)):
        obj.matrix_world = move @ obj.matrix_world
    bpy.context.view_layer.update()
    assert_same_take(Take.load(write(tmp_path / "a.take.npz", file_format="npz")), made.take)


def test_the_take_has_the_artists_shape_and_keys(make_take, tmp_path):
    made = make_take(sides=("right",))
    built = build_take(made.take)
    armature = built.hands[0].armature
    bpy.context.view_layer.objects.active = armature
    armature.manient.betas = BETAS
    keys = read_pose_keys(rig_of(armature))
    turned = keys.quats.copy()
    turned[:, 4] = (0.9, 0.3, 0.2, 0.1)
    turned[:, 4] /= np.linalg.norm(turned[:, 4], axis=-1, keepdims=True)
    moved = PoseKeys.everywhere(keys.frames, turned, keys.locations + [0.0, 0.02, 0.01])
    write_pose_keys(rig_of(armature), moved)
    take = Take.load(write(tmp_path / "mine.npz", file_format="npz"))
    (track,) = take.hands
    np.testing.assert_allclose(track.betas, BETAS, atol=1e-6)
    model = built_model("open-hand", "right")
    row, frame = made.seen[4]
    bpy.context.scene.frame_set(frame)
    posed = model.posed(track.betas, track.global_orient[row], track.hand_pose[row], track.transl[row])
    mesh = built.hands[0].mesh
    np.testing.assert_allclose(evaluated_vertices(mesh), world(posed.vertices), atol=1e-4)
    np.testing.assert_allclose(track.joints_3d[row], posed.keypoints, atol=1e-6)
    pixels = take.intrinsics.project(track.joints_3d[row])
    expected = np.linalg.norm(pixels - track.keypoints_2d[row], axis=-1).mean()
    assert track.reprojection_error[row] == pytest.approx(expected, abs=1e-6)
    assert expected > made.take.hands[0].reprojection_error[row] + 1.0
    # And it builds the same hand again.
    again = build_take(take)
    bpy.context.scene.frame_set(frame)
    found = evaluated_vertices(again.hands[0].mesh)
    np.testing.assert_allclose(found, evaluated_vertices(mesh), atol=1e-4)


def test_deleted_hands_and_meshes_are_left_out(hands, tmp_path):
    built = hands[1]
    bpy.data.objects.remove(built.hands[0].armature)
    bpy.data.objects.remove(built.hands[0].mesh)
    assert [t.side for t in Take.load(write(tmp_path / "a.npz", file_format="npz")).hands] == ["right"]
    bpy.data.objects.remove(built.hands[1].mesh)
    for preset in ("PLAIN", "UNITY"):
        path = write(tmp_path / f"{preset}.fbx", file_format="fbx", preset=preset)
        assert not [k for k, v in models_of(path).items() if v[0] == "Mesh"]
    write(tmp_path / "a.bvh", file_format="bvh")


def test_the_panels_settings_are_the_default(hands, tmp_path):
    bpy.context.scene.manient.export_format = "glb"
    bpy.ops.manient.export_hand(filepath=str(tmp_path / "x.fbx"))
    assert [p.name for p in tmp_path.iterdir()] == ["x.glb"]


def test_a_format_that_this_blender_lacks_is_one_sentence(hands, tmp_path, monkeypatch):
    monkeypatch.setattr(EXPORTERS["usd"], "operator", "wm.no_such_operator", raising=False)
    with pytest.raises(RuntimeError, match="this Blender cannot write usd"):
        bpy.ops.manient.export_hand(filepath=str(tmp_path / "x"), file_format="usd")
    assert not list(tmp_path.iterdir())
    others = [fmt for fmt, kind in EXPORTERS.items() if fmt != "usd" and kind.why_not()]
    for chosen, grey in (("usd", ["usd", "Export"]), ("glb", ["usd"])):
        bpy.context.scene.manient.export_format = chosen
        panel = drawn(MANIENT_PT_export)
        assert sorted(panel.grey) == sorted([*grey, *others])
        assert "USD" in panel.said
        assert "missing in this build of Blender" in panel.said


def test_what_cannot_be_written_is_one_sentence(hands, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    for fmt in ("fbx", "npz"):
        with pytest.raises(RuntimeError, match="cannot write here") as caught:
            bpy.ops.manient.export_hand(filepath=str(tmp_path / "file" / "x"), file_format=fmt)
        assert "Traceback" not in str(caught.value)
    with pytest.raises(RuntimeError, match="choose a file"):
        bpy.ops.manient.export_hand(file_format="fbx")


def test_no_keys_is_one_sentence(hands, tmp_path):
    for hand in hands[1].hands:
        hand.armature.animation_data_clear()
    with pytest.raises(RuntimeError, match="have no keys"):
        bpy.ops.manient.export_hand(filepath=str(tmp_path / "x"), file_format="fbx", frame_range="KEYS")


def test_what_hangs_on_a_hand_stays_behind(hands, tmp_path, capfd):
    armature = hands[1].hands[1].armature
    data = bpy.data.meshes.new("A ring")
    data.from_pydata([(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0)], [], [(0, 1, 2)])
    for name, deformed in (("A ring", False), ("A glove", True)):
        child = bpy.data.objects.new(name, data.copy())
        bpy.context.scene.collection.objects.link(child)
        child.parent = armature
        if deformed:
            child.modifiers.new("Armature", "ARMATURE").object = armature
    for preset in ("PLAIN", "UNITY", "UNREAL"):
        path = write(tmp_path / f"{preset}.fbx", file_format="fbx", preset=preset, active_only=True)
        meshes = [name for name, (kind, _) in models_of(path).items() if kind == "Mesh"]
        assert meshes == [f"mesh of {armature.name}"]
        assert "without A glove, A ring" in capfd.readouterr().out
    for preset in ("PLAIN", "UNITY", "UNREAL"):
        content = glb_content(write(tmp_path / f"{preset}.glb", file_format="glb", preset=preset))
        names = {node["name"] for node in content["nodes"]}
        assert len(content["meshes"]) == 2
        assert not names & {"A ring", "A glove"}
    for fmt in ("usd", "abc"):
        if not EXPORTERS[fmt].why_not():
            path = write(tmp_path / "a", file_format=fmt).with_name("a" + EXPORTERS[fmt].suffix)
            assert b"A ring" not in path.read_bytes()
            assert b"A_ring" not in path.read_bytes()
    write(tmp_path / "a.npz", file_format="npz")


def hide(built) -> None:
    """All that an artist may have done to the view of hands and camera."""
    for hand in built.hands:
        hand.armature.data.pose_position = "REST"
    for obj in (built.camera, *(o for hand in built.hands for o in (hand.armature, hand.mesh))):
        obj.hide_viewport = obj.hide_render = True
    built.collection.hide_viewport = True
    bpy.context.scene.frame_set(3)


def test_hidden_hands_at_rest_are_written_as_they_move(make_take, tmp_path):
    made = make_take()
    built = build_take(made.take)
    bpy.context.view_layer.objects.active = built.hands[1].armature
    built.camera.location.x = 0.3
    built.camera.keyframe_insert("location", frame=3)
    for hand in built.hands:  # they follow the camera, so the take stays the same
        hand.armature.constraints.new("COPY_LOCATION").target = built.camera
    built.camera.location.x = 0.6
    built.camera.keyframe_insert("location", frame=18)
    hide(built)
    take = Take.load(write(tmp_path / "a.take.npz", file_format="npz"))
    assert_same_take(take, made.take)
    for hand in built.hands:
        assert hand.armature.data.pose_position == "REST"
        assert hand.armature.hide_viewport
        assert hand.mesh.hide_render
    assert built.camera.hide_viewport


@pytest.mark.parametrize(
    ("fmt", "preset"),
    [("fbx", "PLAIN"), ("fbx", "UNREAL"), ("glb", "PLAIN"), ("glb", "UNITY"), ("abc", "PLAIN")],
)
def test_hidden_hands_at_rest_in_other_formats(hands, tmp_path, fmt, preset):
    made, built = hands
    hide(built)
    path = write(tmp_path / f"a.{fmt}", file_format=fmt, preset=preset)
    assert built.hands[0].armature.data.pose_position == "REST"
    read_back(path)
    assert (vertex_error if fmt == "abc" else joint_error)(made) < 1e-3


def test_frames_that_the_artist_posed_count_as_filled(make_take, tmp_path):
    made = make_take(sides=("right",))
    built = build_take(made.take)
    armature = built.hands[0].armature
    bpy.context.view_layer.objects.active = armature
    frame = float(made.take.frame_numbers[UNSEEN])
    quats, locations = pose_at(rig_of(armature), np.array([frame]))
    quats[:, 4] = (0.8, 0.6, 0.0, 0.0)
    write_pose_keys(
        rig_of(armature), PoseKeys.everywhere(np.array([frame, 10.0]), quats[[0, 0]], locations[[0, 0]])
    )
    take = Take.load(write(tmp_path / "a.take.npz", file_format="npz"))
    (track,) = take.hands
    assert np.flatnonzero(track.filled).tolist() == [UNSEEN]  # frame 10 is none of the take's
    assert not track.detected[UNSEEN]
    assert np.isnan(track.reprojection_error[UNSEEN])
    bpy.context.scene.frame_set(int(frame))
    shown = evaluated_vertices(built.hands[0].mesh)
    model = built_model("open-hand", "right")
    posed = model.posed(
        track.betas, track.global_orient[UNSEEN], track.hand_pose[UNSEEN], track.transl[UNSEEN]
    )
    np.testing.assert_allclose(shown, world(posed.vertices), atol=1e-4)
    np.testing.assert_allclose(track.joints_3d[UNSEEN], posed.keypoints, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "mode"), [("mesh", "EDIT"), ("mesh", "WEIGHT_PAINT"), ("armature", "EDIT"), ("armature", "POSE")]
)
def test_other_modes_are_left_and_entered_again(hands, tmp_path, kind, mode):
    made, built = hands
    obj = getattr(built.hands[1], kind)
    bpy.ops.object.select_all(action="DESELECT")
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode=mode)
    for fmt, preset in (
        ("glb", "PLAIN"),
        ("glb", "UNITY"),
        ("fbx", "PLAIN"),
        ("fbx", "UNREAL"),
        ("npz", "PLAIN"),
    ):
        write(tmp_path / f"{preset}.{fmt}", file_format=fmt, preset=preset)
        assert (obj.mode, bpy.context.view_layer.objects.active) == (mode, obj)
    assert_same_take(Take.load(tmp_path / "PLAIN.npz"), made.take)


def test_an_edit_that_is_not_finished_is_written(hands, tmp_path):
    """The mesh has in Edit mode what the object gets when it is left."""
    mesh = hands[1].hands[1].mesh
    bpy.ops.object.select_all(action="DESELECT")
    mesh.select_set(True)
    bpy.context.view_layer.objects.active = mesh
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.delete(type="ONLY_FACE")
    content = glb_content(write(tmp_path / "a.glb", file_format="glb", active_only=True))
    assert "meshes" not in content  # nothing is left to draw


def test_copies_of_a_hand_are_left_out(hands, tmp_path):
    made, built = hands
    left, right = built.hands
    bpy.ops.object.select_all(action="DESELECT")
    for obj in (right.armature, right.mesh):
        obj.select_set(True)
    bpy.context.view_layer.objects.active = right.armature
    bpy.ops.object.duplicate()
    copy = bpy.context.view_layer.objects.active
    copy.manient.betas = BETAS
    for active, betas in ((copy, BETAS), (right.armature, made.take.hands[1].betas)):
        bpy.context.view_layer.objects.active = active
        take = Take.load(write(tmp_path / "a.npz", file_format="npz"))
        assert [t.side for t in take.hands] == ["left", "right"]
        np.testing.assert_allclose(take.hands[1].betas, betas, atol=1e-5)
    bpy.context.view_layer.objects.active = left.armature
    take = Take.load(write(tmp_path / "a.npz", file_format="npz"))
    np.testing.assert_allclose(take.hands[1].betas, made.take.hands[1].betas, atol=1e-5)


def test_linked_hands_are_written_and_stay_as_they_are(make_take, tmp_path):
    built = build_take(make_take(sides=("right",)).take)
    name = built.collection.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.collections = [name]
    bpy.context.scene.collection.children.link(bpy.data.collections[name])
    armature = next(obj for obj in bpy.data.objects if obj.type == "ARMATURE")
    bpy.context.view_layer.objects.active = armature
    bpy.context.view_layer.update()
    before = snapshot()
    for preset in ("PLAIN", "UNITY", "UNREAL"):
        for fmt in ("fbx", "glb"):
            path = write(tmp_path / f"{preset}.{fmt}", file_format=fmt, preset=preset)
            assert str(tmp_path).encode() not in path.read_bytes()
    assert snapshot() == before


SECRET = "folder_of_a_secret_project"


@pytest.mark.parametrize("fmt", ["glb", "fbx", "usd", "bvh", "abc"])
@pytest.mark.parametrize("preset", ["PLAIN", "UNREAL"])
def test_no_folder_leaves_in_an_export(make_take, tmp_path, monkeypatch, fmt, preset):
    """Of the picture, the model, a texture, the open file and the file itself only names are told."""
    if EXPORTERS[fmt].why_not():
        pytest.skip(f"this Blender cannot write {fmt}")
    secret = tmp_path / SECRET
    secret.mkdir()
    made = make_take(sides=("right",), source=Source("photo", (str(secret / "hand.png"),)))
    built = build_take(made.take)
    armature, mesh = built.hands[0].armature, built.hands[0].mesh
    armature["model"] = str(secret / "MANO_RIGHT.pkl")
    before = [armature[key] for key in ("source", "model", "side")]
    material = bpy.data.materials.new("Skin")
    texture = use_nodes(material).nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.load(str(write_png(secret / "skin.png", np.ones((4, 4, 4)))))
    material.node_tree.links.new(
        texture.outputs["Color"], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"]
    )
    mesh.data.materials.clear()
    mesh.data.materials.append(material)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.wm.save_as_mainfile(filepath=str(secret / "scene of a hand.blend"))
    if fmt == "usd":  # the same as text, whose writer compresses nothing
        monkeypatch.setattr(EXPORTERS["usd"], "suffix", ".usda")
        monkeypatch.setattr(EXPORTERS["usd"], "is_whole", lambda _stream, _size: True)
    path = write(secret / f"out{EXPORTERS[fmt].suffix}", file_format=fmt, preset=preset)
    content = path.read_bytes()
    assert SECRET.encode() not in content
    assert str(tmp_path).encode() not in content
    if fmt in {"glb", "fbx"}:
        assert b"hand.png" in content
        assert b"MANO_RIGHT.pkl" in content
    if fmt == "fbx":
        assert b"skin.png" in content
    if fmt == "abc":
        assert b"scene of a hand.blend" in content
        bpy.ops.wm.alembic_import(filepath=str(path), as_background_job=False)  # it can still be read
    assert [armature[key] for key in ("source", "model", "side")] == before
