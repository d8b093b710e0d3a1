"""The picture over the hand while keypoints are edited, and nothing of it afterwards."""

from __future__ import annotations

import bpy
import pytest

import blender_manient
from blender_manient.scene import see_through
from blender_manient.scene.build import build_take

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def camera(make_take) -> bpy.types.Camera:
    """A capture's camera with its picture, and a picture of the artist's own in front."""
    data = build_take(make_take().take).camera.data
    own = data.background_images.new()
    own.image, own.display_depth, own.alpha = data.background_images[0].image, "FRONT", 0.125
    data.background_images[0].scale = 1.5
    return data


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


def named(name: str) -> bpy.types.Camera:
    """The camera after an undo, which replaces it."""
    return bpy.data.cameras[name]


def test_a_copy_of_the_picture_lies_over_the_hand_until_the_end(camera):
    before = described(camera)
    see_through.begin(camera, lambda: 0.4)
    copy = camera.background_images[-1]
    behind = camera.background_images[0]
    assert len(camera.background_images) == len(before) + 1
    assert (copy.display_depth, copy.image, copy.scale) == ("FRONT", behind.image, 1.5)
    assert copy.alpha == pytest.approx(0.6)
    assert (copy.image_user.frame_start, copy.frame_method) == (
        behind.image_user.frame_start,
        behind.frame_method,
    )
    see_through.end()
    assert described(camera) == before
    see_through.end()
    assert described(camera) == before


def test_the_opacity_is_followed_and_a_solid_hand_needs_no_copy(camera):
    before = described(camera)
    opacities = [0.3]
    see_through.begin(camera, lambda: opacities[-1])
    for opacity, alphas in ((0.3, [0.7]), (0.0, [1.0]), (1.0, []), (0.8, [0.2])):
        opacities.append(opacity)
        see_through.follow()
        copies = camera.background_images[len(before) :]
        assert [c.alpha for c in copies] == pytest.approx(alphas)
    see_through.end()
    assert described(camera) == before


def test_what_the_artist_adds_meanwhile_stays(camera):
    see_through.begin(camera, lambda: 0.5)
    added = camera.background_images.new()
    added.image, added.alpha = bpy.data.images.new("reference", 4, 4), 0.25
    see_through.end()
    shown = [(b.display_depth, b.alpha) for b in camera.background_images]
    assert shown == [("BACK", 1.0), ("FRONT", 0.125), ("BACK", 0.25)]


@pytest.mark.parametrize("hidden", ["camera", "picture"])
def test_a_picture_that_is_hidden_stays_hidden(camera, hidden):
    if hidden == "camera":
        camera.show_background_images = False
    else:
        camera.background_images[0].show_background_image = False
    before = described(camera)
    see_through.begin(camera, lambda: 0.5)
    assert described(camera) == before


@pytest.mark.parametrize("how", ["hidden", "removed", "another picture"])
def test_a_picture_that_is_taken_away_meanwhile_leaves_no_copy(camera, how):
    see_through.begin(camera, lambda: 0.4)
    original = camera.background_images[0]
    if how == "hidden":
        original.show_background_image = False
    elif how == "removed":
        camera.background_images.remove(original)
    else:
        original.image = bpy.data.images.new("another", 4, 4)
    left = described(camera)[:-1]
    see_through.end()
    assert described(camera) == left


def test_an_undo_afterwards_brings_no_copy_back(camera):
    before, name = described(camera), camera.name
    bpy.ops.ed.undo_push(message="Before")
    see_through.begin(camera, lambda: 0.5)
    bpy.ops.ed.undo_push(message="Edit Keypoints")
    see_through.end()
    bpy.data.objects.new("something", None)
    bpy.ops.ed.undo_push(message="Later")
    bpy.ops.ed.undo()
    assert described(named(name)) == before
    bpy.ops.ed.undo()
    assert described(named(name)) == before
    bpy.ops.ed.redo()
    assert described(named(name)) == before


def test_an_undo_meanwhile_keeps_the_hand_see_through(camera):
    before, name = described(camera), camera.name
    bpy.ops.ed.undo_push(message="Before")
    see_through.begin(camera, lambda: 0.5)
    bpy.ops.ed.undo_push(message="Edit Keypoints")
    bpy.ops.ed.undo_push(message="Move Keypoint")
    for step in (bpy.ops.ed.undo, bpy.ops.ed.undo, bpy.ops.ed.redo):
        step()
        assert len(named(name).background_images) == len(before) + 1
    see_through.end()
    assert described(named(name)) == before


def test_a_file_saved_meanwhile_has_none(camera, tmp_path):
    before, name = described(camera), camera.name
    see_through.begin(camera, lambda: 0.5)
    path = str(tmp_path / "meanwhile.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True, check_existing=False)
    assert len(camera.background_images) == len(before) + 1
    with bpy.data.libraries.load(path) as (_, wanted):
        wanted.cameras = [name]
    saved = wanted.cameras[0]
    assert len(saved.background_images) == len(before)
    assert len(saved.manient_see_through) == 0
    see_through.end()


def test_a_file_that_blender_saved_by_itself_is_put_right(camera, tmp_path):
    before, name = described(camera), camera.name
    see_through.begin(camera, lambda: 0.5)
    path = str(tmp_path / "quit.blend")
    bpy.data.libraries.write(path, {bpy.context.scene, *bpy.context.scene.objects})  # without handlers
    see_through.end()
    bpy.ops.wm.open_mainfile(filepath=path)
    assert len(named(name).background_images) == len(before)


def test_disabling_the_add_on_ends_it(camera):
    before = described(camera)
    see_through.begin(camera, lambda: 0.5)
    blender_manient.unregister()
    try:
        assert described(camera) == before
    finally:
        blender_manient.register()
