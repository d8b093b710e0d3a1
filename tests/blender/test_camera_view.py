"""The zoom and the place of a camera's frame in a viewport, against Blender's projection written out."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from blender_manient.common.screen import enlarged, zoom_and_offset
from blender_manient.scene.camera import lens_of_camera
from handfit_core.errors import OptionError

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
    left, bottom, right, top = frame_box(
        region, frame, sensor_fit, *zoom_and_offset(region, free, frame, sensor_fit)
    )
    assert left >= free[0] - 1e-6
    assert bottom >= free[1] - 1e-6
    assert right <= free[2] + 1e-6
    assert top <= free[3] + 1e-6
    assert (right - left) / (top - bottom) == pytest.approx(frame[0] / frame[1])
    assert (left + right) / 2 == pytest.approx((free[0] + free[2]) / 2)
    assert (bottom + top) / 2 == pytest.approx((free[1] + free[3]) / 2)
    touched = min(free[2] - free[0] - (right - left), free[3] - free[1] - (top - bottom))
    assert touched == pytest.approx(0.0, abs=1e-6)


def test_blenders_limits_of_zoom():
    zoom, _ = zoom_and_offset((2000, 200), (0, 0, 2000, 200), PORTRAIT, "HORIZONTAL")
    assert zoom == -30.0
    zoom, _ = zoom_and_offset((2000, 200), (0, 0, 2000, 200), (1.0, 500.0), "VERTICAL")
    assert -30.0 < zoom < 600.0


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


def test_a_camera_without_perspective_is_refused():
    data = bpy.data.cameras.new("camera")
    data.type = "ORTHO"
    with pytest.raises(OptionError, match="perspective"):
        lens_of_camera(bpy.data.objects.new("camera", data), bpy.context.scene)
