"""Edit Keypoints without a window: what the view shows of a hand, and how large its points are drawn."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from blender_manient.operators import edit_keypoints
from blender_manient.operators.modes import keypoints, view
from blender_manient.operators.modes.drawing import RADIUS, Picture, handle_sizes
from blender_manient.operators.modes.keypoints import REACH, KeypointMode, forget_views
from blender_manient.scene.build import build_take
from blender_manient.session.refiner import Refiner
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
        self.address, self.view = 0, SimpleNamespace(face=lambda _: None, shows=lambda _: True)
        self._frame, self._places = bpy.context.scene.frame_current_final, places
        viewport.show_picture(None, None)
        self._restore_view(viewport)

    def picture_places(self) -> np.ndarray:
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
    mode.show_hand(viewport)
    np.testing.assert_allclose(viewport.matrix, framed)


def test_on_a_frame_without_the_hand_it_shows_the_picture(hands, viewport):
    whole = viewport.matrix
    Begun(hands[0], viewport, np.full((21, 2), np.nan))
    np.testing.assert_allclose(viewport.matrix, whole)


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


def test_of_a_hand_that_is_larger_than_the_view_the_points_in_sight_stay_in_sight(hands, viewport):
    mode = Begun(hands[0], viewport, SMALL)
    viewport.enlarge(20.0, mapped(viewport.matrix, SMALL[8]), ROOM.mean(axis=0))
    shown, scale = seen(viewport, SMALL), viewport.scale
    assert shown[8]
    assert not shown.all()
    bpy.context.scene.frame_set(2)
    mode.places = SMALL + [60.0, 10.0]
    mode.tick(bpy.context)
    assert (seen(viewport, mode.places) >= shown).all()
    assert viewport.scale == scale


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
    edit_keypoints._on_load()
    Begun(first, viewport, SMALL)
    np.testing.assert_allclose(viewport.matrix, framed)


def test_a_view_that_has_no_point_of_the_hand_is_not_begun_with(hands, viewport):
    mode = Begun(hands[0], viewport, SMALL)
    framed = viewport.matrix
    viewport.enlarge(1.0, np.zeros(2), np.full(2, 9e4))
    mode.leave(viewport)
    Begun(hands[0], viewport, SMALL)
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
