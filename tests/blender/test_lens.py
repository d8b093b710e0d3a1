"""A Blender camera's lens against Blender's own projection."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from bpy_extras.object_utils import world_to_camera_view  # noqa: E402
from mathutils import Vector  # noqa: E402

from blender_manient.scene.camera import lens_of_camera  # noqa: E402
from handfit_core.errors import OptionError  # noqa: E402


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
