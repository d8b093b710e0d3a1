"""A Blender camera's lens as a capture takes it: independent of the picture's size in pixels."""

from __future__ import annotations

import bpy

from handfit_core.errors import OptionError


def lens_of_camera(camera: bpy.types.Object, scene: bpy.types.Scene) -> tuple[float, float, float]:
    """(focal length in picture widths, principal point x and y as parts of width and height) of a
    perspective camera as the scene renders it. y counts downwards. Raises OptionError."""
    data = camera.data
    if data.type != "PERSP":
        raise OptionError(
            f"the camera {camera.name} has no perspective lens: make it one, or choose another camera setting"
        )
    render = scene.render
    width = render.resolution_x * render.pixel_aspect_x
    height = render.resolution_y * render.pixel_aspect_y
    vertical = data.sensor_fit == "VERTICAL" or (data.sensor_fit == "AUTO" and height > width)
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    # Lens and shifts are in units of the side that the sensor is fitted to.
    fitted = height if vertical else width
    focal = data.lens / sensor * fitted / width
    return focal, 0.5 - data.shift_x * fitted / width, 0.5 + data.shift_y * fitted / height
