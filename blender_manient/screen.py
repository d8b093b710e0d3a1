"""What is on the screen: redrawing the sidebar, finding views."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from .camera_view import frame_whole_picture


def redraw_sidebars(context: bpy.types.Context) -> None:
    """Draw the sidebars of all 3D viewports again."""
    for area in _viewports(context):
        for region in area.regions:
            if region.type == "UI":
                region.tag_redraw()


def redraw_viewports(context: bpy.types.Context) -> None:
    """Draw all 3D viewports again, with their sidebars."""
    for area in _viewports(context):
        area.tag_redraw()


def redraw_preferences() -> None:
    """Draw all Preferences editors again."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager else ():
        for area in window.screen.areas:
            if area.type == "PREFERENCES":
                area.tag_redraw()


def look_through_camera(context: bpy.types.Context) -> None:
    """Turn the view of the active area, else of the largest 3D viewport, to the scene's camera, with the
    whole picture in it."""
    views = list(_viewports(context))
    if not views:
        return
    area = context.area if context.area in views else max(views, key=lambda a: a.width * a.height)
    assert area is not None
    space = area.spaces.active
    camera = context.scene.camera
    if camera is None or space.use_local_camera:
        return
    space.region_3d.view_perspective = "CAMERA"
    frame_whole_picture(area, camera, context.scene)


def _viewports(context: bpy.types.Context) -> Iterator[bpy.types.Area]:
    manager = context.window_manager
    for window in manager.windows if manager else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                yield area
