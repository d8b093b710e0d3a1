"""Edit Keypoints without a window: what the view shows of a hand, and how large its points are drawn; where
Blender draws a camera's frame in a viewport."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from blender_manient.common.screen import enlarged, zoom_and_offset
from blender_manient.operators import edit_keypoints
from blender_manient.operators.modes import keypoints, view
from blender_manient.operators.modes.drawing import RADIUS, Picture, handle_sizes
from blender_manient.operators.modes.keypoints import REACH, KeypointMode, forget_views
from blender_manient.scene.build import build_take
from blender_manient.scene.camera import lens_of_camera
from blender_manient.session.refiner import Refiner
from handfit_core.common.errors import OptionError
from handfit_core.geometry.picture_map import mapped
from tests.takes import correctable

PICTURE = (1920.0, 1080.0)
ROOM = np.array([[100.0, 50.0], [1100.0, 850.0]])
"""What is free of a region"""


class FakeViewport:
    """A viewport whose camera view is enlarged as Blender's, without one."""

    def __init__(self) -> None:
        self.area, self.region = None, SimpleNamespace(x=0, y=0, width=1200, height=900)
        self.view = SimpleNamespace(update=lambda: None, view_camera_zoom=0.0, view_camera_offset=(0.0, 0.0))
        self.show_picture(None, None)

    def show_picture(self, _camera, _scene) -> None:
        scale = (np.ptp(ROOM, axis=0) / PICTURE).min()
        x, y = ROOM.mean(axis=0) - np.multiply(PICTURE, [0.5, -0.5]) * scale
        self.matrix = np.array([[scale, 0.0, x], [0.0, -scale, y], [0.0, 0.0, 1.0]])

    def enlarge(self, factor, here, there=None) -> None:
        x, y = np.subtract(here if there is None else there, np.multiply(here, factor))
        self.matrix = np.array([[factor, 0.0, x], [0.0, factor, y], [0.0, 0.0, 1.0]]) @ self.matrix

    def set_zoom(self, zoom, _offset) -> None:
        self.matrix = zoom

    def free(self) -> np.ndarray:
        return ROOM

    @property
    def scale(self) -> float:
        return float(self.matrix[0, 0])


@pytest.fixture
def viewport(monkeypatch) -> FakeViewport:
    made = FakeViewport()
    monkeypatch.setattr(view, "viewport_at", lambda *_: made)
    monkeypatch.setattr(view, "picture_matrix", lambda *_: made.matrix)
    monkeypatch.setattr(keypoints.screen, "ui_scale", lambda: 1.0)
    forget_views()
    return made


class Begun(KeypointMode):
    """The mode without the worker and without what it draws; its hand is where `places` says."""

    def __init__(self, armature, viewport, places) -> None:
        self.refiner, self.places, self.drag, self._warming = Refiner(armature), places, None, 0
        self.address, self.view = (
            0,
            SimpleNamespace(
                face=lambda _: None, shows=lambda _: True, looks=lambda _: 0, follow=lambda _: False
            ),
        )
        self._frame, self._places = bpy.context.scene.frame_current_final, places
        viewport.show_picture(None, None)
        self._restore_view(viewport)

    def picture_places(self, _view=None) -> np.ndarray:
        return self.places

    def leave(self, viewport) -> None:
        viewport.view.view_camera_zoom = viewport.matrix
        self._save_view()


@pytest.fixture
def hands(make_take, registered):
    """Two captured hands."""
    return [hand.armature for hand in build_take(correctable(make_take().take)).hands]


SMALL = np.array([900.0, 500.0]) + np.random.default_rng(5).uniform(0.0, 40.0, (21, 2))


def seen(viewport, places) -> np.ndarray:
    """(N,) whether places of the picture are free."""
    there = mapped(viewport.matrix, places)
    return ((there >= ROOM[0]) & (there <= ROOM[1])).all(axis=1)


def test_it_opens_on_the_hand_with_half_its_size_around(hands, viewport):
    mode = Begun(hands[0], viewport, SMALL)
    shown = mapped(viewport.matrix, SMALL)
    size = shown.max(axis=0) - shown.min(axis=0)
    assert (np.ptp(ROOM, axis=0) / size).min() == pytest.approx(2.0)
    np.testing.assert_allclose((shown.max(axis=0) + shown.min(axis=0)) / 2, ROOM.mean(axis=0))
    framed = viewport.matrix
    mode.show_picture(viewport)
    assert viewport.scale < 1.0
    whole = viewport.matrix
    mode.show_hand(viewport)
    np.testing.assert_allclose(viewport.matrix, framed)
    Begun(hands[1], viewport, np.full((21, 2), np.nan))
    np.testing.assert_allclose(viewport.matrix, whole, err_msg="it is not in this frame")


def test_the_view_follows_the_hand_and_keeps_its_zoom(hands, viewport):
    mode = Begun(hands[0], viewport, SMALL)
    before = viewport.matrix
    bpy.context.scene.frame_set(2)
    mode.places = SMALL + [3.0, 0.0]
    mode.tick(bpy.context)
    np.testing.assert_allclose(viewport.matrix, before, err_msg="it moves although all is in sight")
    bpy.context.scene.frame_set(3)
    mode.places = SMALL + [200.0, -90.0]
    mode.tick(bpy.context)
    assert viewport.scale == before[0, 0]
    assert seen(viewport, mode.places).all()


def test_each_hand_has_its_own_view_until_another_file_is_opened(hands, viewport):
    first, second = hands
    mode = Begun(first, viewport, SMALL)
    framed = viewport.matrix
    viewport.enlarge(3.0, mapped(viewport.matrix, SMALL[8]))
    closer = viewport.matrix
    mode.leave(viewport)
    Begun(second, viewport, SMALL)
    np.testing.assert_allclose(viewport.matrix, framed, err_msg="the other hand's")
    first.name = "Another name"
    Begun(first, viewport, SMALL)
    np.testing.assert_allclose(viewport.matrix, closer)
    # On another frame: the same zoom, where the hand is.
    Begun(first, viewport, SMALL + [300.0, 200.0])
    assert viewport.scale == closer[0, 0]
    assert seen(viewport, SMALL + [300.0, 200.0]).any()
    viewport.enlarge(1.0, np.zeros(2), np.full(2, 9e4))
    mode.leave(viewport)
    Begun(first, viewport, SMALL)
    np.testing.assert_allclose(viewport.matrix, framed, err_msg="none of its points was in the view")
    viewport.enlarge(3.0, mapped(viewport.matrix, SMALL[8]))
    mode.leave(viewport)
    edit_keypoints._on_load()
    Begun(first, viewport, SMALL)
    np.testing.assert_allclose(viewport.matrix, framed)


@pytest.mark.parametrize("zoom", [0.3, 1.0, 3.0, 20.0])
def test_no_handle_covers_another(zoom):
    apart = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)[:21] * 8.0
    picture = Picture(apart * zoom, frozenset({3, 12}), 7, None, "", False, (0.0, 0.0))
    outer = np.full(21, RADIUS + 1.5)
    outer[[3, 12]], outer[7] = RADIUS * 2.1, RADIUS * 1.35 + 1.5
    radius = outer * handle_sizes(picture, 1.0)
    distance = np.linalg.norm(picture.places[:, None] - picture.places, axis=-1) + 1e9 * np.eye(21)
    if zoom >= 1.0:
        assert (distance - radius[:, None] - radius).min() >= -1e-9
    assert radius.min() > 1.5, "each is seen"
    assert (radius == outer).all() == (zoom >= 3.0)


def test_the_mouse_takes_the_nearest_and_reaches_no_farther_than_there_is_room(hands, viewport):
    mode = Begun(hands[0], viewport, SMALL)
    mode.places = mapped(np.linalg.inv(viewport.matrix), 300.0 + np.arange(42.0).reshape(21, 2) * [15.0, 0.0])
    row = mapped(viewport.matrix, mode.places)
    for keypoint in (0, 10, 20):
        x, y = row[keypoint]
        assert mode.handle_at(viewport, round(x + 4), round(y)) == keypoint
        assert mode.handle_at(viewport, round(x), round(y + REACH - 1)) == keypoint
    mode.places = mapped(np.linalg.inv(viewport.matrix), (row - 300.0) * 0.2 + 300.0)
    row = mapped(viewport.matrix, mode.places)
    assert mode.handle_at(viewport, round(row[10, 0]), round(row[10, 1])) == 10
    assert mode.handle_at(viewport, round(row[10, 0]), round(row[10, 1] + REACH)) is None


PORTRAIT, LANDSCAPE, SQUARE = (620.0, 1080.0), (1920.0, 1080.0), (500.0, 500.0)


def frame_box(region, frame, sensor_fit, zoom, offset) -> np.ndarray:
    """(4,) left, bottom, right, top in pixels of the region where Blender draws the camera's frame, as its
    sources have it (BKE_camera_params_compute_viewplane), with a sensor of 1 over a lens of 1."""

    def fitted(size) -> float:
        horizontal = size[0] >= size[1] if sensor_fit == "AUTO" else sensor_fit == "HORIZONTAL"
        return size[0] if horizontal else size[1]

    factor = (np.sqrt(2.0) + zoom / 50.0) ** 2 / 4.0
    pixel = 1.0 / fitted(region) / factor
    moved = 2.0 * factor * np.array(offset) * region
    lower = (-0.5 * np.array(region) + moved) * pixel
    half = 0.5 * np.array(frame) / fitted(frame)
    return np.concatenate([(-half - lower) / pixel, (half - lower) / pixel])


@pytest.mark.parametrize("sensor_fit", ["HORIZONTAL", "VERTICAL", "AUTO"])
@pytest.mark.parametrize("frame", [PORTRAIT, LANDSCAPE, SQUARE])
@pytest.mark.parametrize(
    ("region", "free"),
    [
        ((1200, 900), (0, 0, 1200, 900)),
        ((1200, 900), (60, 10, 920, 850)),
        ((500, 900), (60, 0, 500, 870)),
        ((900, 300), (0, 0, 900, 280)),
        ((600, 450), (0, 0, 320, 420)),
    ],
)
def test_the_frame_fills_what_is_free(sensor_fit, frame, region, free):
    lower, upper = frame_box(
        region, frame, sensor_fit, *zoom_and_offset(region, free, frame, sensor_fit)
    ).reshape(2, 2)
    low, high = np.reshape(free, (2, 2))
    np.testing.assert_allclose(lower + upper, low + high, err_msg="in the middle")
    assert np.divide(*(upper - lower)) == pytest.approx(frame[0] / frame[1])
    assert (high - low - (upper - lower)).min() == pytest.approx(0.0, abs=1e-6), "it touches two edges"


@pytest.mark.parametrize("factor", [0.5, 1.0, 1.7, 1e6, 1e-6])
def test_a_place_stays_or_goes_where_it_is_to_be(factor):
    region, zoom, offset = (1200, 900), 25.0, (0.11, -0.04)
    here, there = np.array([310.0, 640.0]), np.array([700.0, 200.0])
    before = frame_box(region, LANDSCAPE, "AUTO", zoom, offset).reshape(2, 2)
    after = frame_box(region, LANDSCAPE, "AUTO", *enlarged(zoom, offset, region, factor, here, there))
    after = after.reshape(2, 2)
    grown = np.ptp(after, axis=0) / np.ptp(before, axis=0)
    if 0.1 < factor < 10.0:
        np.testing.assert_allclose(grown, factor)
    share = (here - before[0]) / np.ptp(before, axis=0)
    np.testing.assert_allclose(after[0] + share * np.ptp(after, axis=0), there)


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("size", [(640, 360), (360, 640)])
def test_projects_as_blender_does(fit, size):
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = size
    data = bpy.data.cameras.new("camera")
    data.sensor_fit, data.lens, data.shift_x, data.shift_y = fit, 41.0, 0.07, -0.04
    data.sensor_height = 20.0
    camera = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(camera)

    focal, cx, cy = lens_of_camera(camera, scene)
    point = np.array([0.11, -0.07, 0.6])  # x right, y down, z forward
    width, height = size
    mine = [focal * point[0] / point[2] + cx, (focal * width * point[1] / point[2]) / height + cy]
    seen = world_to_camera_view(scene, camera, Vector((point[0], -point[1], -point[2])))
    assert mine == pytest.approx([seen.x, 1.0 - seen.y], abs=1e-5)
    data.type = "ORTHO"
    with pytest.raises(OptionError, match="perspective"):
        lens_of_camera(camera, scene)
