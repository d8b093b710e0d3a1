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
from blender_manient.session.refiner import Refiner
from handfit_core.common.errors import HandModelError, TakeError
from handfit_core.common.slices import run_to_completion
from handfit_core.edit.messages import from_message
from handfit_core.media.source import Source
from handfit_core.take import Take
from tests.takes import seen_as

from .conftest import FRAMES, UNSEEN
from .importing import assert_same_take
from .looking import chosen

pytestmark = pytest.mark.usefixtures("registered")


def saved_and_opened(folder) -> None:
    """As in another run of Blender."""
    path = str(folder / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    store._cache.clear()
    bpy.ops.wm.open_mainfile(filepath=path)


def test_the_take_survives_saving(make_take, tmp_path):
    """A mesh leads to its hand, and other objects to none."""
    take = make_take().take
    build_take(take)
    bpy.ops.mesh.primitive_cube_add()
    saved_and_opened(tmp_path)
    armatures = store.captured_hands(bpy.context.scene)
    assert len(armatures) == 2
    for index, armature in enumerate(armatures):
        hand = store.hand_of(armature)
        assert_same_take(hand.take, take)
        assert (hand.index, hand.side) == (index, take.hands[index].side)
        assert hand.track is hand.take.hands[index]
        assert hand.camera == bpy.context.scene.camera
        assert hand.mesh.parent == armature
        assert store.hand_of(hand.mesh).armature == armature
        np.testing.assert_allclose(armature.manient.betas, hand.track.betas, atol=1e-5)
    assert store.hand_of(bpy.context.scene.camera) is None
    assert store.hand_of(bpy.data.objects["Cube"]) is None


def test_another_take_replaces_the_first_which_undo_brings_back(built, make_take):
    first, other = store.kept_take(built.collection), make_take(seed=5).take
    name = built.collection.name
    bpy.ops.ed.undo_push(message="built")
    store.keep_take(built.collection, other)
    bpy.ops.ed.undo_push(message="another take")
    store._cache.clear()
    assert_same_take(store.kept_take(built.collection), other)
    bpy.ops.ed.undo()
    assert_same_take(store.kept_take(bpy.data.collections[name]), first)


def test_what_both_networks_saw_comes_back_from_a_file_to_takes_and_to_who_fits_anew(make_take, tmp_path):
    made = make_take(sides=("right",)).take
    track = made.hands[0]
    second = np.concatenate([track.keypoints_2d + 1.5, track.keypoints_2d[..., :1]], axis=-1)
    second[2] = np.nan  # where the second network was not asked
    seen = {"keypoints_depth": 0.0 * second[..., 2], "world_landmarks": track.joints_3d}
    seen["keypoints_depth"][2] = 0.0
    (hand,) = build_take(replace(made, hands=(seen_as(track, **seen, keypoints_2020=second),))).hands
    name = hand.armature.name
    saved_and_opened(tmp_path)
    armature = bpy.data.objects[name]
    found = store.hand_of(armature)
    for take in (found.take, retaken([found]), Take.from_bytes(retaken([found]).to_bytes())):
        np.testing.assert_allclose(take.hands[0].rows.keypoints_2020, second, atol=1e-3)
    refiner = Refiner(armature)
    rows = [0, 2, UNSEEN]
    asked = from_message(refiner.request(rows, [{}] * 3, refiner.start_poses(rows))()["hand"])
    assert asked.detections.frame.tolist() == [0, 1]
    assert asked.detections.asked_2020.tolist() == [True, False]
    np.testing.assert_allclose(asked.detections.keypoints_2020[0], second[0], atol=1e-3)


def setting(**fields):
    """Set the collection's properties."""
    return lambda collection: [setattr(collection.manient, *field) for field in fields.items()]


def damaged(change):
    """Change the text in which the collection keeps its take."""
    return lambda collection: setattr(collection.manient, "take", change(collection.manient.take))


def holding(name: str, value):
    """Keep a take with another array; its fingerprint is right, as whoever sends a .blend can have it."""

    def keep(collection) -> None:
        stream = io.BytesIO()
        with np.load(io.BytesIO(store.kept_take(collection).to_bytes())) as archive:
            np.savez_compressed(stream, **dict(archive) | {name: value})
        run_to_completion(store.keeping_take(collection, None, stream.getvalue()))

    return keep


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (setting(take="", digest=""), r"keeps no take.*import the take file"),
        (damaged(lambda text: text[: len(text) // 2]), "damaged; import the take file"),
        (damaged(lambda _: "no base64 *"), "damaged; import the take file"),
        (damaged(lambda text: text[:100] + "AAAA" + text[104:]), "damaged; import the take file"),
        (holding("hand0_betas", np.full(10, np.nan)), "the take in the collection"),
        (holding("header", np.array("[" * 100_000)), "the take in the collection"),
        (holding("hand0_hand_pose", np.zeros((1_000_000, 45))), "the take in the collection"),
    ],
)
def test_a_take_that_cannot_be_read_is_a_sentence_and_no_hand(built, armature, spoil, said):
    spoil(built.collection)
    store._cache.clear()
    assert store.hand_of(armature) is None
    with pytest.raises(TakeError, match=said):
        store.kept_take(built.collection)


def test_what_was_deleted_or_cannot_be_is_none(built, armature):
    built.collection.manient.camera = armature
    assert store.hand_of(armature).camera is None
    bpy.data.objects.remove(built.hands[0].mesh)
    bpy.data.objects.remove(built.camera)
    hand = store.hand_of(armature)
    assert (hand.mesh, hand.camera) == (None, None)
    armature.manient.betas[3] = float("nan")
    assert store.hand_of(armature) is None
    armature.manient.betas[3] = 0.0
    assert store.hand_of(armature) is not None
    bpy.data.collections.remove(built.collection)
    assert store.hand_of(armature) is None


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"model": "pipe"}, HandModelError, "hand model"),
        ({"model": "/nowhere"}, HandModelError, "hand model"),
        ({"model": "~nobody-of-that-name/x.npz"}, HandModelError, "hand model"),
        ({"frame_numbers": FRAMES + 20_240_101_123_456_789}, TakeError, "timeline ends at 1048574"),
        ({"frame_numbers": np.append(FRAMES[:-1], 2**61)}, TakeError, "timeline ends at 1048574"),
    ],
)
def test_what_no_blend_can_hold_is_not_built(make_take, tmp_path, monkeypatch, change, error, said):
    """Blender reads the model that somebody else's take names: a pipe is never waited for."""
    monkeypatch.chdir(tmp_path)
    if hasattr(os, "mkfifo"):
        os.mkfifo("pipe")
    with pytest.raises(error, match=said):
        build_take(replace(make_take().take, **change))
    assert not bpy.data.collections


def test_names_that_are_no_utf8(make_take):
    """Linux has such files, and Blender's texts do not."""
    take = make_take(source=Source("photo", ("/nowhere/H\udce4nde.jpg",))).take
    built = build_take(Take.from_bytes(take.to_bytes()))
    assert built.collection.name == "H?nde"
    assert built.hands[0].armature["source"] == "/nowhere/H?nde.jpg"


def test_other_meshes_on_the_hand_are_not_its_mesh(built, armature):
    mesh = built.hands[0].mesh
    assert armature.manient.mesh == mesh
    ring, glove = (bpy.data.objects.new(name, bpy.data.meshes.new(name)) for name in ("A ring", "A glove"))
    for child in (ring, glove):
        bpy.context.scene.collection.objects.link(child)
        child.parent = armature
    ring.parent_type, ring.parent_bone = "BONE", "index_distal.R"
    glove.modifiers.new("Armature", "ARMATURE").object = armature
    hand = store.hand_of(armature)
    assert hand.mesh == mesh
    assert store.attached_objects(hand) == [glove, ring]
    # What was deleted in the viewport lives on as long as the armature names it.
    chosen(mesh)
    bpy.ops.object.delete()
    assert armature.manient.mesh is not None
    assert store.hand_of(armature).mesh is None


def test_a_changed_mesh_is_still_the_hands(built, armature):
    built.hands[0].mesh.data.clear_geometry()
    assert store.hand_of(armature).mesh == built.hands[0].mesh


@pytest.mark.parametrize("linked", [True, False])
def test_a_copy_of_a_hand_has_the_copied_mesh(built, armature, linked):
    mesh = built.hands[0].mesh
    for copied in ((mesh, armature), (armature,)):
        for obj in bpy.context.view_layer.objects:
            obj.select_set(obj in copied)
        bpy.context.view_layer.objects.active = armature
        bpy.ops.object.duplicate(linked=linked)
        copy = bpy.context.view_layer.objects.active
        own = store.hand_of(copy).mesh
        assert own is None if mesh not in copied else own != mesh and own.parent == copy
    assert store.hand_of(armature).mesh == mesh


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
