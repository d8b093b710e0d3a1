"""The take in the .blend: kept, found again, and missed with a sentence that says what to do."""

from __future__ import annotations

import io
import os
from dataclasses import replace

import bpy
import numpy as np
import pytest

import blender_manient
from blender_manient.exporters.take import retaken
from blender_manient.scene import store
from blender_manient.scene.build import build_take
from blender_manient.scene.timing import Timing
from blender_manient.session.refiner import Refiner
from handfit_core.edit.messages import from_message
from handfit_core.errors import HandModelError, TakeError
from handfit_core.hand_model.files import kept_model
from handfit_core.take import Take

from .conftest import FRAMES, UNSEEN

pytestmark = pytest.mark.usefixtures("registered")


def no_memory() -> None:
    """As in another run of Blender."""
    store._cache.clear()


def assert_same_take(found, take) -> None:
    np.testing.assert_array_equal(found.frame_numbers, take.frame_numbers)
    assert found.source == take.source
    assert found.intrinsics == take.intrinsics
    for a, b in zip(found.hands, take.hands, strict=True):
        assert a.side == b.side
        np.testing.assert_allclose(a.hand_pose, b.hand_pose, atol=1e-6)
        np.testing.assert_allclose(a.keypoints_2d, b.keypoints_2d, atol=1e-3)
        np.testing.assert_array_equal(a.detected, b.detected)


def test_the_take_survives_saving(make_take, tmp_path):
    made = make_take()
    build_take(made.take)
    path = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    no_memory()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    armatures = store.captured_hands(bpy.context.scene)
    assert len(armatures) == 2
    for index, armature in enumerate(armatures):
        hand = store.hand_of(armature)
        assert hand is not None
        assert_same_take(hand.take, made.take)
        assert (hand.index, hand.side) == (index, made.take.hands[index].side)
        assert hand.track is hand.take.hands[index]
        assert hand.camera == bpy.context.scene.camera
        assert hand.mesh is not None
        assert hand.mesh.parent == armature
        np.testing.assert_allclose(armature.manient.betas, hand.track.betas, atol=1e-5)


def test_what_both_networks_saw_comes_back_from_a_file_to_takes_and_to_who_fits_anew(make_take, tmp_path):
    made = make_take(sides=("right",)).take
    track = made.hands[0]
    second = np.concatenate([track.keypoints_2d + 1.5, track.keypoints_2d[..., :1]], axis=-1)
    second[2] = np.nan  # where the second network was not asked
    seen = {"keypoints_depth": 0.0 * second[..., 2], "world_landmarks": track.joints_3d}
    seen["keypoints_depth"][2] = 0.0
    (hand,) = build_take(replace(made, hands=(replace(track, **seen, keypoints_2020=second),))).hands
    name, path = hand.armature.name, tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    no_memory()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    armature = bpy.data.objects[name]
    found = store.hand_of(armature)
    for take in (found.take, retaken([found]), Take.from_bytes(retaken([found]).to_bytes())):
        np.testing.assert_allclose(take.hands[0].keypoints_2020, second, atol=1e-3)
    refiner = Refiner(armature)
    rows = [0, 2, UNSEEN]
    asked = from_message(refiner.request(rows, [{}] * 3, refiner.start_poses(rows))()["hand"])
    assert asked.detections.frame.tolist() == [0, 1]
    assert asked.detections.asked_2020.tolist() == [True, False]
    np.testing.assert_allclose(asked.detections.keypoints_2020[0], second[0], atol=1e-3)


def test_a_mesh_leads_to_its_hand_and_other_objects_to_none(make_take):
    built = build_take(make_take().take)
    for hand in built.hands:
        found = store.hand_of(hand.mesh)
        assert found is not None
        assert found.armature == hand.armature
    assert store.hand_of(built.camera) is None
    bpy.ops.object.armature_add()
    assert store.hand_of(bpy.context.object) is None
    bpy.ops.mesh.primitive_cube_add()
    assert store.hand_of(bpy.context.object) is None


def test_keeping_another_take_replaces_the_first(make_take):
    built = build_take(make_take().take)
    other = make_take(seed=5).take
    before = built.collection.manient.digest
    store.keep_take(built.collection, other)
    assert built.collection.manient.digest != before
    no_memory()
    assert_same_take(store.kept_take(built.collection), other)


def test_undo_brings_the_former_take_back(make_take):
    made = make_take()
    built = build_take(made.take)
    name = built.collection.name
    bpy.ops.ed.undo_push(message="built")
    store.keep_take(built.collection, make_take(seed=5).take)
    bpy.ops.ed.undo_push(message="another take")
    bpy.ops.ed.undo()
    assert_same_take(store.kept_take(bpy.data.collections[name]), made.take)


def test_a_hand_without_its_take(make_take):
    """As an older version built it: no hand of ours, and a sentence for whoever asks for the take."""
    built = build_take(make_take().take)
    built.collection.manient.take = ""
    built.collection.manient.digest = ""
    assert store.hand_of(built.hands[0].armature) is None
    with pytest.raises(TakeError, match=r"keeps no take.*import the take file"):
        store.kept_take(built.collection)


def test_a_hand_whose_collection_was_deleted(make_take):
    built = build_take(make_take().take)
    armature = built.hands[0].armature
    bpy.data.collections.remove(built.collection)
    assert store.hand_of(armature) is None


def test_a_damaged_take(make_take):
    built = build_take(make_take().take)
    text = built.collection.manient.take
    for damaged in (text[: len(text) // 2], "no base64 *", text[:100] + "AAAA" + text[104:]):
        no_memory()
        built.collection.manient.take = damaged
        assert store.hand_of(built.hands[0].armature) is None
        with pytest.raises(TakeError, match="damaged; import the take file"):
            store.kept_take(built.collection)


def keep_bytes(collection, data: bytes) -> None:
    """Keep bytes as a take whose fingerprint is right, as whoever sends a .blend can."""
    for _ in store.keeping_take(collection, None, data):  # type: ignore[arg-type]
        pass


def test_a_take_in_a_blend_is_checked_like_a_file(make_take):
    """Its fingerprint says only that it is whole."""
    made = make_take(sides=("right",))
    built = build_take(made.take)
    with np.load(io.BytesIO(made.take.to_bytes())) as archive:
        arrays = dict(archive)
    zeros = np.zeros((1_000_000, 45))
    for name, array in (
        ("hand0_betas", np.full(10, np.nan)),
        ("hand0_transl", np.full_like(arrays["hand0_transl"], 1e30)),
        ("hand0_detected", arrays["hand0_detected"].astype(float)),
        ("frame_numbers", arrays["frame_numbers"].astype(float)),
        ("hand0_hand_pose", zeros),
        ("header", np.array("[" * 100_000)),
    ):
        stream = io.BytesIO()
        np.savez_compressed(stream, **(arrays | {name: array}))
        keep_bytes(built.collection, stream.getvalue())
        no_memory()
        assert store.hand_of(built.hands[0].armature) is None
        with pytest.raises(TakeError, match="the take in the collection"):
            store.kept_take(built.collection)


@pytest.mark.parametrize("where", ["pipe", "/dev/zero", "a" * 5000, "~nobody-of-that-name/x.npz", "/nowhere"])
def test_the_model_that_a_take_names_is_read_like_any_other(make_take, tmp_path, where):
    """Blender reads what a .blend or take of somebody else's names: it is never waited for."""
    path = tmp_path / "pipe"
    if where == "pipe":
        if not hasattr(os, "mkfifo"):
            pytest.skip("this system has no named pipes")
        os.mkfifo(path)
    take = replace(make_take().take, model=str(path) if where == "pipe" else where)
    with pytest.raises(HandModelError, match="hand model"):
        build_take(take)
    with pytest.raises(HandModelError, match="hand model"):
        kept_model(take.model, "right")
    assert not bpy.data.collections


@pytest.mark.parametrize("numbers", [FRAMES + 20_240_101_123_456_789, np.append(FRAMES[:-1], 2**61)])
def test_frames_beyond_blenders_timeline_are_a_sentence(make_take, numbers):
    """Pictures that are numbered by the time at which they were taken."""
    take = replace(make_take().take, frame_numbers=numbers)
    with pytest.raises(TakeError, match="Blender's timeline ends at 1048574"):
        build_take(take)
    assert not bpy.data.collections


def test_names_that_are_no_utf8(make_take):
    """Linux has such files, and Blender's texts do not."""
    made = make_take().take
    take = replace(made, source=replace(made.source, kind="photo", files=("/nowhere/H\udce4nde.jpg",)))
    built = build_take(Take.from_bytes(take.to_bytes()))
    assert built.collection.name == "H?nde"
    assert built.hands[0].armature["source"] == "/nowhere/H?nde.jpg"


def test_deleted_mesh_and_camera_are_none(make_take):
    built = build_take(make_take().take)
    bpy.data.objects.remove(built.hands[0].mesh)
    bpy.data.objects.remove(built.camera)
    hand = store.hand_of(built.hands[0].armature)
    assert hand is not None
    assert hand.mesh is None
    assert hand.camera is None


def add_child(armature, name: str, like=None, deformed: bool = False):
    """A mesh parented to the hand, with a triangle or a copy of another's data."""
    if like is None:
        data = bpy.data.meshes.new(name)
        data.from_pydata([(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0)], [], [(0, 1, 2)])
    else:
        data = like.data.copy()
    child = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(child)
    child.parent = armature
    if deformed:
        child.modifiers.new("Armature", "ARMATURE").object = armature
    return child


def mesh_of(armature):
    hand = store.hand_of(armature)
    assert hand is not None
    return hand.mesh


@pytest.mark.parametrize("marked", [True, False])
def test_other_meshes_on_the_hand_are_not_its_mesh(make_take, marked):
    """Also of hands that were built before meshes were marked."""
    built = build_take(make_take(sides=("right",)).take)
    armature, mesh = built.hands[0].armature, built.hands[0].mesh
    assert armature.manient.mesh == mesh
    if not marked:
        armature.manient.mesh = None
    ring = add_child(armature, "A ring")
    ring.parent_type, ring.parent_bone = "BONE", "index_distal.R"
    assert mesh_of(armature) == mesh
    glove = add_child(armature, "A glove", deformed=True)
    assert mesh_of(armature) == mesh
    hand = store.hand_of(armature)
    assert hand is not None
    assert store.hung_on(hand) == [glove, ring]
    # What was deleted in the viewport lives on as long as the armature names it.
    bpy.context.view_layer.objects.active = mesh
    mesh.select_set(True)
    bpy.ops.object.delete()
    if marked:
        assert armature.manient.mesh is not None
        assert mesh_of(armature) is None


def test_a_changed_mesh_is_still_the_hands(make_take):
    built = build_take(make_take(sides=("right",)).take)
    armature, mesh = built.hands[0].armature, built.hands[0].mesh
    mesh.data.clear_geometry()
    assert mesh_of(armature) == mesh
    armature.manient.mesh = None
    assert mesh_of(armature) == mesh


@pytest.mark.parametrize("linked", [True, False])
def test_a_copy_of_a_hand_has_the_copied_mesh(make_take, linked):
    built = build_take(make_take(sides=("right",)).take)
    armature, mesh = built.hands[0].armature, built.hands[0].mesh
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in (armature, mesh))
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.duplicate(linked=linked)
    copy = bpy.context.view_layer.objects.active
    assert mesh_of(copy) not in (None, mesh)
    assert mesh_of(copy).parent == copy
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj == armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.duplicate(linked=linked)
    assert mesh_of(bpy.context.view_layer.objects.active) is None
    assert mesh_of(armature) == mesh


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1.0), (100.5, 0.8), (7.0, 2.0)])
def test_rows_of_scene_frames(make_take, offset, scale):
    take = make_take(sides=("right",)).take
    collection = bpy.data.collections.new("capture")
    store.describe_capture(collection, None, Timing(offset, scale))
    places = store.scene_frames(collection, take)
    np.testing.assert_allclose(Timing(offset, scale).source_frames(places), FRAMES, atol=1e-6)
    np.testing.assert_array_equal(store.rows_at(collection, take, places), np.arange(len(FRAMES)))
    np.testing.assert_array_equal(store.rows_at(collection, take, places + 0.2 * scale), range(len(FRAMES)))
    between = offset + scale * np.array([-5.0, 10.0, 900.0])  # source frames 9, 10 and 11 are no rows
    np.testing.assert_array_equal(store.rows_at(collection, take, between), -1)


def test_nothing_is_kept_without_the_add_on(make_take):
    blender_manient.unregister()
    try:
        built = build_take(make_take().take)
        assert store.captured_hands(bpy.context.scene) == []
        assert store.hand_of(built.hands[0].armature) is None
        with pytest.raises(TakeError):
            store.kept_take(built.collection)
    finally:
        blender_manient.register()


@pytest.mark.parametrize(
    ("offset", "scale"), [(1e30, 1.0), (0.0, 1e9), (float("nan"), 1.0), (0.0, float("nan"))]
)
def test_a_time_that_no_timeline_reaches_is_none(make_take, offset, scale):
    """As only a hostile file has it: Blender raises for such frames."""
    made = make_take()
    collection = build_take(made.take).collection
    collection.manient.frame_offset, collection.manient.frame_scale = offset, scale
    np.testing.assert_array_equal(store.scene_frames(collection, made.take), made.take.frame_numbers)


def test_a_shape_that_is_not_finite_is_no_hand(make_take):
    armature = build_take(make_take().take).hands[0].armature
    assert store.hand_of(armature) is not None
    armature.manient.betas[3] = float("nan")
    assert store.hand_of(armature) is None


def test_what_is_no_camera_saw_no_hand(make_take):
    built = build_take(make_take().take)
    armature = built.hands[0].armature
    built.collection.manient.camera = armature
    hand = store.hand_of(armature)
    assert hand is not None
    assert hand.camera is None
