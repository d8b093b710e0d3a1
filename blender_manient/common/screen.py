"""Everything about Blender's screen: redrawing it, and a camera view with the whole picture beside what lies
over it.

Blender's own *Frame Camera Bounds* needs the viewport's context and takes the region's whole size, of which
the sidebar and the headers cover a part.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from .section import CAPTURE, EDIT

_MARGIN = 6
"""Pixels between the picture and what is around it, at a user interface scale of 1"""
_LEAST = 80
"""Pixels at a user interface scale of 1; where less is left free, the picture may lie below what covers it"""
_LEAST_HAND = 40
"""The least size in pixels at which a hand is seen well, at a user interface scale of 1"""
_LOWEST_ZOOM, _HIGHEST_ZOOM = -30.0, 600.0
"""The bounds of RegionView3D.view_camera_zoom"""
_OVER_THE_VIEW = {"HEADER", "TOOL_HEADER", "TOOLS", "UI", "ASSET_SHELF", "ASSET_SHELF_HEADER"}

Box = tuple[float, float, float, float]
"""The left, bottom, right and top of a rectangle in pixels of a region"""


def ui_scale() -> float:
    """Return the factor by which Blender enlarges its interface."""
    preferences = bpy.context.preferences
    return preferences.system.ui_scale if preferences is not None else 1.0


def areas(*kinds: str) -> Iterator[bpy.types.Area]:
    """Yield the editors of these kinds in all windows."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager else ():
        yield from (area for area in window.screen.areas if area.type in kinds)


def redraw(*kinds: str) -> None:
    """Draw all editors of these kinds again."""
    for area in areas(*kinds):
        area.tag_redraw()


def redraw_sidebars() -> None:
    """Draw the sidebars of all 3D viewports again."""
    for area in areas("VIEW_3D"):
        for region in area.regions:
            if region.type == "UI":
                region.tag_redraw()


def open_edit_tab() -> None:
    """Show the tab Hand Edit in sidebars that show Hand Capture."""
    for area in areas("VIEW_3D"):
        for region in area.regions:
            with contextlib.suppress(AttributeError, TypeError):  # Blender does not let scripts do it
                if region.type == "UI" and region.active_panel_category == CAPTURE:
                    region.active_panel_category = EDIT


def draw_shape(kind: str, points: np.ndarray, colors: np.ndarray, line_width: float = 0.0) -> None:
    """Draw (N, 2) pixels of the current region with (N, 4) colours: triangles, or lines of a width."""
    shader = gpu.shader.from_builtin("POLYLINE_SMOOTH_COLOR" if line_width else "FLAT_COLOR")
    shader.bind()
    if line_width:
        shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
        shader.uniform_float("lineWidth", line_width)
    flat = np.pad(np.asarray(points, np.float32), ((0, 0), (0, 1)))
    batch_for_shader(shader, kind, {"pos": flat, "color": np.ascontiguousarray(colors, np.float32)}).draw(
        shader
    )


def texture_of(path: str) -> gpu.types.GPUTexture:
    """Load a picture file as a texture, for `draw_texture`. Raises RuntimeError where Blender cannot read
    it."""
    image = bpy.data.images.load(path)
    try:
        return gpu.texture.from_image(image)
    finally:
        bpy.data.images.remove(image)


def draw_texture(texture: gpu.types.GPUTexture, box: Box) -> None:
    """Draw a texture into a box of the current region."""
    try:
        shader = gpu.shader.from_builtin("IMAGE_SCENE_LINEAR_TO_REC709_SRGB")
    except ValueError:  # before Blender 5.0, where that is done for all shaders
        shader = gpu.shader.from_builtin("IMAGE")
    left, bottom, right, top = box
    corners = [(left, bottom), (right, bottom), (right, top), (left, top)]
    places = {"pos": corners, "texCoord": [(0, 0), (1, 0), (1, 1), (0, 1)]}
    batch = batch_for_shader(shader, "TRI_FAN", places)
    shader.bind()
    shader.uniform_sampler("image", texture)
    batch.draw(shader)


def _main_view(context: bpy.types.Context) -> bpy.types.Area | None:
    """Return the active area where that is a 3D viewport, else the largest one."""
    views = list(areas("VIEW_3D"))
    largest = max(views, key=lambda a: a.width * a.height, default=None)
    return context.area if context.area in views else largest


def frame_selected(context: bpy.types.Context, armatures: Sequence[bpy.types.Object]) -> None:
    """Have the main view frame what is selected, unless it shows one of these armatures already, looks
    through a camera, or shows some objects alone."""
    area = _main_view(context)
    region = camera_region(area) if area is not None else None
    if area is None or region is None or context.mode != "OBJECT":
        return
    space, (left, bottom, right, top) = area.spaces.active, free_box(area, region)
    if space.region_3d.view_perspective == "CAMERA" or space.local_view is not None:
        return
    for armature in armatures:
        points = [armature.matrix_world @ bone.head for bone in armature.pose.bones]
        clip = np.array([space.region_3d.perspective_matrix @ point.to_4d() for point in points])
        places = (clip[:, :2] / clip[:, 3:] + 1.0) * [region.width / 2.0, region.height / 2.0]
        inside = (places >= [left, bottom]) & (places <= [right, top]) & (clip[:, 3:] > 0.0)
        if inside.all() and np.ptp(places, axis=0).max() >= _LEAST_HAND * ui_scale():
            return
    windows = context.window_manager.windows
    window = next(one for one in windows if area in one.screen.areas[:])
    with context.temp_override(window=window, area=area, region=region):
        if bpy.ops.view3d.view_selected.poll():
            bpy.ops.view3d.view_selected()


def look_through_camera(context: bpy.types.Context) -> None:
    """Turn the main view to the scene's camera, with the whole picture in it."""
    area = _main_view(context)
    if area is None:
        return
    space = area.spaces.active
    camera = context.scene.camera
    if camera is None or space.use_local_camera:
        return
    space.region_3d.view_perspective = "CAMERA"
    frame_whole_picture(area, camera, context.scene)


def frame_whole_picture(area: bpy.types.Area, camera: bpy.types.Object, scene: bpy.types.Scene) -> None:
    """Zoom and move the camera view of a 3D viewport so that the whole frame of `camera` is in sight."""
    space, region = area.spaces.active, camera_region(area)
    if region is None or not isinstance(space, bpy.types.SpaceView3D):
        return
    render = scene.render
    size = (render.resolution_x * render.pixel_aspect_x, render.resolution_y * render.pixel_aspect_y)
    fit = camera.data.sensor_fit if isinstance(camera.data, bpy.types.Camera) else "AUTO"
    free = free_box(area, region)
    if min(free[2] - free[0], free[3] - free[1]) < 1.0:
        return
    zoom, offset = zoom_and_offset((region.width, region.height), free, size, fit)
    space.region_3d.view_camera_zoom = zoom
    space.region_3d.view_camera_offset = offset
    area.tag_redraw()


def camera_region(area: bpy.types.Area) -> bpy.types.Region | None:
    """Return the region of a 3D viewport that `space.region_3d` belongs to: in a quad view the last one."""
    windows = [region for region in area.regions if region.type == "WINDOW"]
    return windows[-1] if windows and area.spaces.active.region_quadviews else next(iter(windows), None)


def zoom_and_offset(
    region: tuple[float, float], free: Box, frame: tuple[float, float], sensor_fit: str
) -> tuple[float, tuple[float, float]]:
    """Return `view_camera_zoom` and `view_camera_offset` with which a camera's frame fills the box `free` of
    a region.

    `region`: width and height in pixels; `frame`: those of the rendered picture, in square pixels;
    `sensor_fit`: the camera's. Blender's zoom has limits: a frame that is very much higher than the region is
    wide cannot be made small enough.
    """
    # Blender lays the sensor's fitted side over the same side of the frame and, at a factor of 1, of the
    # region.
    if sensor_fit == "AUTO":
        scale = max(region) / max(frame)
    else:
        side = 0 if sensor_fit == "HORIZONTAL" else 1
        scale = region[side] / frame[side]
    width, height = frame[0] * scale, frame[1] * scale
    zoom = _zoom_of(min((free[2] - free[0]) / width, (free[3] - free[1]) / height))
    return zoom, _offset(zoom, region, ((free[0] + free[2]) / 2.0, (free[1] + free[3]) / 2.0))


def enlarged(
    zoom: float,
    offset: Sequence[float],
    region: tuple[float, float],
    factor: float,
    source: np.ndarray,
    target: np.ndarray,
) -> tuple[float, tuple[float, float]]:
    """Return `view_camera_zoom` and `view_camera_offset` of a camera view that is enlarged by `factor`, as
    far as Blender's limits allow, and in which `target` lies what lay at `source`: (2,) pixels of the region
    each."""
    before = _enlargement(zoom)
    zoom = _zoom_of(before * factor)
    grown = _enlargement(zoom) / before
    middle = [size * (0.5 - 2.0 * before * moved) for size, moved in zip(region, offset, strict=True)]
    x, y = (to + (at - old) * grown for at, old, to in zip(middle, source, target, strict=True))
    return zoom, _offset(zoom, region, (x, y))


def _enlargement(zoom: float) -> float:
    return (math.sqrt(2.0) + zoom / 50.0) ** 2 / 4.0


def _zoom_of(enlargement: float) -> float:
    return min(max((math.sqrt(4.0 * enlargement) - math.sqrt(2.0)) * 50.0, _LOWEST_ZOOM), _HIGHEST_ZOOM)


def _offset(zoom: float, region: tuple[float, float], middle: tuple[float, float]) -> tuple[float, float]:
    """Return the `view_camera_offset` with which the frame's middle lies at `middle`: in twice the region's
    size, growing with the zoom."""
    factor = _enlargement(zoom)
    x, y = ((size / 2.0 - at) / (2.0 * factor * size) for size, at in zip(region, middle, strict=True))
    return x, y


def free_box(area: bpy.types.Area, region: bpy.types.Region) -> Box:
    """Return the box that the sidebar, the toolbar and the headers leave of a region, in its own pixels, less
    a margin."""
    scale = ui_scale()
    whole = (0.0, 0.0, float(region.width), float(region.height))
    free = whole
    for other in area.regions:
        if other.type in _OVER_THE_VIEW and min(other.width, other.height) > 1:
            left, bottom = other.x - region.x, other.y - region.y
            free = _largest_side(free, (left, bottom, left + other.width, bottom + other.height))
    if min(free[2] - free[0], free[3] - free[1]) < _LEAST * scale:
        free = whole
    margin = _MARGIN * scale
    return free[0] + margin, free[1] + margin, free[2] - margin, free[3] - margin


def _largest_side(free: Box, cover: Box) -> Box:
    """Return the largest part of `free` on one side of `cover`; all of it where they do not meet."""
    left, bottom, right, top = free
    if cover[0] >= right or cover[2] <= left or cover[1] >= top or cover[3] <= bottom:
        return free
    rests = (
        (left, bottom, min(right, cover[0]), top),
        (max(left, cover[2]), bottom, right, top),
        (left, bottom, right, min(top, cover[1])),
        (left, max(bottom, cover[3]), right, top),
    )
    return max(rests, key=lambda box: max(0.0, box[2] - box[0]) * max(0.0, box[3] - box[1]))
