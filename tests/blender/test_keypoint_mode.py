"""Edit Keypoints without a window: how large points are drawn, and where Blender draws a camera's frame in a
viewport."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from blender_manient.common.screen import zoom_and_offset
from blender_manient.operators import base
from blender_manient.operators.modes.drawing import RADIUS, Picture, handle_sizes
from blender_manient.scene.camera import lens_of_camera
from handfit_core.common.errors import OptionError


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


def test_disabling_meanwhile_ends_the_timer_and_the_line_in_the_status_bar(monkeypatch):
    said, ended = [], []
    manager = SimpleNamespace(event_timer_remove=ended.append)
    workspace = SimpleNamespace(status_text_set=said.append)
    monkeypatch.setattr(
        base, "bpy", SimpleNamespace(context=SimpleNamespace(window_manager=manager, workspace=workspace))
    )
    monkeypatch.setitem(base.ModalOperator.running, "MANIENT_OT_edit_keypoints", base.ModalState("its timer"))
    base.unregister()
    assert (said, ended, base.ModalOperator.running) == ([None], ["its timer"], {})
