"""The picture over the hand while keypoints are edited, and nothing of it afterwards."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

import blender_manient
from blender_manient.scene import see_through
from blender_manient.scene.build import BuiltTake, build_take
from blender_manient.scene.camera import captured_place
from blender_manient.scene.store import hand_of

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def built(make_take) -> BuiltTake:
    return build_take(make_take().take)


@pytest.fixture
def camera(built) -> bpy.types.Camera:
    """A capture's camera with its picture, and a picture of the artist's own in front."""
    data = built.camera.data
    own = data.background_images.new()
    own.image, own.display_depth, own.alpha = data.background_images[0].image, "FRONT", 0.125
    data.background_images[0].scale = 1.5
    return data


def begin(built: BuiltTake, opacity: Callable[[], float]) -> None:
    armature = built.hands[0].armature
    see_through.begin(built.camera, armature, captured_place(hand_of(armature).take, 0, 1.0), opacity)


def described(camera: bpy.types.Camera) -> list[tuple]:
    """All that is set of each background image, with what says which frame it shows."""
    return [
        tuple(
            str(getattr(struct, setting.identifier))
            for struct in (background, background.image_user)
            for setting in struct.bl_rna.properties
            if not setting.is_readonly
        )
        for background in camera.background_images
    ]


def test_a_copy_of_the_picture_lies_over_the_hand_until_the_end(camera, built):
    """The opacity is followed, and a solid hand needs no copy."""
    before, behind = described(camera), camera.background_images[0]
    opacities = [0.4]
    begin(built, lambda: opacities[-1])
    copy = camera.background_images[-1]
    assert (copy.display_depth, copy.image, copy.scale) == ("FRONT", behind.image, 1.5)
    assert (copy.image_user.frame_start, copy.frame_method) == (
        behind.image_user.frame_start,
        behind.frame_method,
    )
    for opacity, alphas in ((0.4, [0.6]), (0.0, [1.0]), (1.0, []), (0.8, [0.2])):
        opacities.append(opacity)
        see_through.follow()
        assert [c.alpha for c in camera.background_images[len(before) :]] == pytest.approx(alphas)
    added = camera.background_images.new()
    added.image, added.alpha = bpy.data.images.new("reference", 4, 4), 0.25
    for _ in range(2):
        see_through.end()
        assert described(camera)[:-1] == before
        assert camera.background_images[-1].alpha == 0.25, "what the artist adds meanwhile stays"


@pytest.mark.parametrize("when", ["before", "meanwhile"])
@pytest.mark.parametrize("how", ["camera", "hidden", "removed", "another picture"])
def test_a_picture_that_is_taken_away_leaves_no_copy(camera, built, how, when):
    if when == "meanwhile":
        begin(built, lambda: 0.4)
    original = camera.background_images[0]
    if how == "camera":
        camera.show_background_images = False
    elif how == "hidden":
        original.show_background_image = False
    elif how == "removed":
        camera.background_images.remove(original)
    else:
        original.image = bpy.data.images.new("another", 4, 4)
    left = described(camera)[: None if when == "before" else -1]
    if when == "before":
        begin(built, lambda: 0.4)
        assert how == "another picture" or described(camera) == left
    see_through.end()
    assert described(camera) == left


def test_undo_meanwhile_keeps_the_copy_and_afterwards_brings_none_back(camera, built):
    before, name = described(camera), camera.name
    bpy.ops.ed.undo_push(message="Before")
    begin(built, lambda: 0.5)
    for message in ("Edit Keypoints", "Move Keypoint"):
        bpy.ops.ed.undo_push(message=message)
    for step in (bpy.ops.ed.undo, bpy.ops.ed.undo, bpy.ops.ed.redo):
        step()  # which replaces the camera
        assert len(bpy.data.cameras[name].background_images) == len(before) + 1
    see_through.end()
    bpy.data.objects.new("something", None)
    bpy.ops.ed.undo_push(message="Later")
    for step in (bpy.ops.ed.undo, bpy.ops.ed.undo, bpy.ops.ed.redo):
        step()
        assert described(bpy.data.cameras[name]) == before


@pytest.mark.parametrize("by", ["the artist", "Blender"])
def test_a_file_saved_meanwhile_has_none(camera, built, tmp_path, by):
    """Where Blender saves by itself, without handlers, it is put right as the file is opened."""
    before, name, path = described(camera), camera.name, str(tmp_path / "meanwhile.blend")
    begin(built, lambda: 0.5)
    if by == "Blender":
        bpy.data.libraries.write(path, {bpy.context.scene, *bpy.context.scene.objects})
    else:
        bpy.ops.wm.save_as_mainfile(filepath=path, copy=True, check_existing=False)
        assert len(camera.background_images) == len(before) + 1
    see_through.end()
    if by == "Blender":
        bpy.ops.wm.open_mainfile(filepath=path)
        saved = bpy.data.cameras[name]
    else:
        with bpy.data.libraries.load(path) as (_, wanted):
            wanted.cameras = [name]
        saved = wanted.cameras[0]
        assert len(saved.manient_see_through) == 0
    assert len(saved.background_images) == len(before)


def test_disabling_the_add_on_ends_it(camera, built):
    before = described(camera)
    begin(built, lambda: 0.5)
    blender_manient.unregister()
    try:
        assert described(camera) == before
    finally:
        blender_manient.register()


def _elsewhere(armature: bpy.types.Object, how: str) -> None:
    """Move, turn and scale a hand, or what carries it."""
    obj = armature
    if how != "itself":
        armature.parent = obj = bpy.data.objects.new("carrier", None)
        bpy.context.scene.collection.objects.link(obj)
    for frame in (3, 18):
        obj.location, obj.rotation_euler = (0.1 * frame, -2.0, 3.0), (0.4, -0.1 * frame, 2.0)
        obj.scale = (0.5, 2.0, 3.0) if how == "squeezed" else (-2.0, 2.0, 2.0)
        for path in ("location", "rotation_euler", "scale"):
            obj.keyframe_insert(path, frame=frame)
    if how == "constrained":
        armature.constraints.new("COPY_LOCATION").target = obj


@pytest.mark.parametrize("how", ["itself", "carried", "squeezed", "constrained"])
def test_a_hand_that_was_put_elsewhere_is_shown_where_it_was_captured(built, how):
    """In each frame, before its camera wherever that stands; then it is back exactly, undone or not."""
    names = built.hands[0].armature.name, built.camera.name

    def places() -> np.ndarray:
        found = []
        for frame in (3, 7, 18):
            bpy.context.scene.frame_set(frame)
            armature, camera = (bpy.data.objects[name] for name in names)
            found.append(
                [armature.matrix_world, camera.matrix_world.normalized().inverted() @ armature.matrix_world]
            )
        return np.array(found)

    captured = places()[:, 1]
    _elsewhere(built.hands[0].armature, how)
    built.camera.matrix_world = Matrix.LocRotScale((1, 2, 3), Euler((1, 2, 3)), (2, 2, 2))
    artists = places()
    assert np.abs(artists[:, 1] - captured).max() > 1.0
    bpy.ops.ed.undo_push(message="Elsewhere")
    begin(built, lambda: 0.5)
    np.testing.assert_allclose(places()[:, 1], captured, atol=1e-5)
    bpy.ops.ed.undo_push(message="Move Keypoint")
    bpy.ops.ed.undo()
    np.testing.assert_allclose(places()[:, 1], captured, atol=1e-5)
    see_through.end()
    np.testing.assert_array_equal(places(), artists)
    bpy.ops.ed.redo()
    np.testing.assert_array_equal(places(), artists)
