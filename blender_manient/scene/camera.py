"""The capture camera: Blender's lens, shift and pixel aspect from pinhole intrinsics."""

from __future__ import annotations

import math

import bpy
from mathutils import Matrix

from handfit_core.common.errors import OptionError
from handfit_core.hand_model import axes
from handfit_core.take import Take

from .background import Plate, picture_aspect

_SENSOR_WIDTH = 36.0
"""Width of the camera's sensor in millimetres. Only the ratio of lens and sensor matters; full frame gives
lenses that photographers know"""
_SAME_PLACE = 1e-6
CAMERA_AT_REST = Matrix.Rotation(math.pi / 2.0, 4, "X")
"""The matrix_world of a capture camera that nobody moved: Blender's cameras look along their own -Z, which
this turns to +Y, with Z up"""


def build_camera(
    name: str,
    take: Take,
    plate: Plate | None,
    *,
    scene: bpy.types.Scene | None = None,
    units_per_metre: float = 1.0,
) -> bpy.types.Object:
    """Build a camera at the world's origin that projects as `take.intrinsics` does, with the plate behind.

    It is not linked to any collection. `frame_scene` sets the scene's half of the projection; where the
    scene keeps its own size, give it as `scene`: the picture's full width is then the frame's.
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
    camera.clip_start = 0.01 * units_per_metre
    camera.clip_end = 100.0 * units_per_metre
    camera.display_size *= units_per_metre
    camera.passepartout_alpha = 0.8
    if plate is not None:
        show_behind(camera, plate, take, scene)
    obj = bpy.data.objects.new(name, camera)
    obj.rotation_euler = CAMERA_AT_REST.to_euler()
    return obj


def lens_of_camera(camera: bpy.types.Object, scene: bpy.types.Scene) -> tuple[float, float, float]:
    """Return a perspective camera's focal length in picture widths, and its principal point, x and y as parts
    of width and height, as the scene renders it; y counts downwards. Raises OptionError."""
    data = camera.data
    if data.type != "PERSP":
        raise OptionError(
            f"the camera {camera.name} has no perspective lens: make it one, or choose another camera setting"
        )
    aspect = frame_aspect(scene)
    vertical = data.sensor_fit == "VERTICAL" or (data.sensor_fit == "AUTO" and aspect < 1.0)
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    # Lens and shifts are in units of the side that the sensor is fitted to.
    width, height = (1.0 / aspect, 1.0) if vertical else (1.0, aspect)
    return data.lens / sensor * width, 0.5 - data.shift_x * width, 0.5 + data.shift_y * height


def put_before(armature: bpy.types.Object, camera: bpy.types.Object) -> None:
    """Hang an armature on a camera that is there already, so that its hand lies where that camera sees it.

    Cameras ignore their scale; children would not, so it is taken back.
    """
    armature.parent = camera
    scale = camera.matrix_world.to_scale()
    undone = Matrix.Diagonal((*(1.0 / s if s else 1.0 for s in scale), 1.0))
    armature.matrix_parent_inverse = undone @ CAMERA_AT_REST.inverted()


def captured_place(take: Take, view: int, units_per_metre: float) -> Matrix:
    """Return the matrix of a hand's armature in the frame of the camera of a view, both as they were
    captured."""
    camera = CAMERA_AT_REST
    if (cameras := take.cameras) is not None:
        camera = Matrix(axes.camera_in_world(cameras.rotation[view], cameras.translation[view]).tolist())
        camera.translation *= units_per_metre
    return camera.inverted() @ Matrix.Scale(units_per_metre, 4)


def is_moved(camera: bpy.types.Object) -> bool:
    """True if a capture camera stands elsewhere than where it was built, or moves."""
    away = (camera.matrix_world - CAMERA_AT_REST) if camera.animation_data is None else None
    return away is None or max(abs(value) for row in away for value in row) > _SAME_PLACE


def frame_scene(scene: bpy.types.Scene, take: Take, scale: float = 1.0) -> None:
    """Give the scene the picture's size (times `scale`) and the pixel aspect for fx != fy."""
    render = scene.render
    render.resolution_x = max(4, round(take.width * scale))
    render.resolution_y = max(4, round(take.height * scale))
    render.resolution_percentage = 100
    ratio = take.intrinsics.fx / take.intrinsics.fy  # how high a pixel is if it is one wide
    render.pixel_aspect_x = max(1.0, 1.0 / ratio)  # Blender wants both >= 1
    render.pixel_aspect_y = max(1.0, ratio)


def frame_aspect(scene: bpy.types.Scene) -> float:
    """Return the width of a scene's frame over its height, as it is seen, with the pixel aspect."""
    render = scene.render
    return render.resolution_x * render.pixel_aspect_x / (render.resolution_y * render.pixel_aspect_y)


def show_behind(
    camera: bpy.types.Camera, plate: Plate, take: Take, scene: bpy.types.Scene | None
) -> bpy.types.CameraBackgroundImage:
    """Add the plate as a background image: over the whole frame, or with the frame's width in a scene that
    keeps its own size."""
    camera.show_background_images = True
    background = camera.background_images.new()
    background.source = "IMAGE"
    background.image = plate.image
    background.alpha = 1.0
    background.display_depth = "BACK"
    background.use_flip_x, background.use_flip_y, turns = plate.placing
    background.rotation = math.radians(90.0 * turns)
    picture = frame = picture_aspect(take)
    if scene is not None:
        frame = frame_aspect(scene)
    if scene is None and not turns:
        background.frame_method = "STRETCH"
    elif turns:  # Before it is turned the image gets the frame's height, of which the scale makes its width.
        background.frame_method = "CROP" if 1.0 / picture > frame else "FIT"
        background.scale = frame
    else:  # Either touches two sides of the frame; these are left and right.
        background.frame_method = "FIT" if picture > frame else "CROP"
    plate.apply_timing(background.image_user)
    return background
