"""The capture camera: Blender's lens, shift and pixel aspect from pinhole intrinsics."""

from __future__ import annotations

import math

import bpy

from handfit_core.take import Take

from .plate import Plate

_SENSOR_WIDTH = 36.0
"""mm. Only the ratio of lens and sensor matters; full frame gives lenses that photographers know"""
_LOOK_ALONG_Y = (math.pi / 2.0, 0.0, 0.0)
"""Blender's cameras look along their own -Z; this turns that to +Y, with Z up"""


def build_camera(name: str, take: Take, plate: Plate | None) -> bpy.types.Object:
    """A camera at the world's origin that projects as `take.intrinsics` does, with the plate behind.

    It is not linked to any collection. `frame_scene` sets the scene's half of the projection.
    """
    k, width, height = take.intrinsics, take.width, take.height
    camera = bpy.data.cameras.new(name)
    camera.type = "PERSP"
    camera.sensor_fit = "HORIZONTAL"
    camera.sensor_width = _SENSOR_WIDTH
    camera.lens = k.fx * _SENSOR_WIDTH / width
    # Shifts are in units of the picture's width, measured in square pixels.
    camera.shift_x = (width / 2.0 - k.cx) / width
    camera.shift_y = (k.cy - height / 2.0) / width * (k.fx / k.fy)
    camera.clip_start = 0.01
    camera.clip_end = 100.0
    camera.passepartout_alpha = 0.8
    if plate is not None:
        _show_behind(camera, plate)
    obj = bpy.data.objects.new(name, camera)
    obj.rotation_euler = _LOOK_ALONG_Y
    return obj


def frame_scene(scene: bpy.types.Scene, take: Take, scale: float = 1.0) -> None:
    """Give the scene the picture's size (times `scale`) and the pixel aspect for fx != fy."""
    render = scene.render
    render.resolution_x = max(4, round(take.width * scale))
    render.resolution_y = max(4, round(take.height * scale))
    render.resolution_percentage = 100
    ratio = take.intrinsics.fx / take.intrinsics.fy  # pixel height over pixel width; Blender wants both >= 1
    render.pixel_aspect_x = max(1.0, 1.0 / ratio)
    render.pixel_aspect_y = max(1.0, ratio)


def _show_behind(camera: bpy.types.Camera, plate: Plate) -> None:
    camera.show_background_images = True
    background = camera.background_images.new()
    background.source = "IMAGE"
    background.image = plate.image
    background.alpha = 1.0
    background.display_depth = "BACK"
    background.frame_method = "STRETCH"
    plate.apply_timing(background.image_user)
