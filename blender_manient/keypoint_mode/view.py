"""The 3D viewport that looks through the capture camera while keypoints are edited."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import bpy
import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.picture_map import picture_to_region

from ..screen import camera_region, enlarged, frame_whole_picture, free_box

_OF_REGION = (
    "view_perspective",
    "view_camera_zoom",
    "view_camera_offset",
    "view_distance",
    "view_location",
    "view_rotation",
)
_OF_SPACE = ("use_local_camera", "lock_camera")
_STEP: Final = 1.25
"""by which one notch of the wheel enlarges"""
_SWIPE: Final = 20.0
"""pixels that fingers move on a trackpad for the same"""
_ZOOMS: Final = {
    "WHEELUPMOUSE": _STEP,
    "NUMPAD_PLUS": _STEP,
    "WHEELDOWNMOUSE": 1.0 / _STEP,
    "NUMPAD_MINUS": 1.0 / _STEP,
}


@dataclass(frozen=True)
class Viewport:
    """A 3D viewport's parts. Held for one event only: Blender may free them between two."""

    area: bpy.types.Area
    region: bpy.types.Region
    space: bpy.types.SpaceView3D

    @property
    def view(self) -> bpy.types.RegionView3D:
        """What the region shows."""
        return self.space.region_3d

    def contains(self, x: int, y: int) -> bool:
        """Whether a place in window pixels lies in the view, and not in what overlaps it."""

        def inside(region: bpy.types.Region) -> bool:
            return (
                region.x <= x < region.x + region.width and region.y <= y < region.y + region.height
            ) and min(region.width, region.height) > 1

        others = (r for r in self.area.regions if r.type != "WINDOW")
        return inside(self.region) and not any(inside(r) for r in others)

    def mouse(self, event: bpy.types.Event) -> np.ndarray:
        """(2,) pixels of the region: where the mouse is."""
        return np.array([event.mouse_x - self.region.x, event.mouse_y - self.region.y], dtype=float)

    def show_picture(self, camera: bpy.types.Object, scene: bpy.types.Scene) -> None:
        """Frame the camera's whole picture. The matrices follow at once."""
        frame_whole_picture(self.area, camera, scene)
        self.view.update()

    def enlarge(self, factor: float, source: np.ndarray, target: np.ndarray | None = None) -> None:
        """Enlarge the camera view so that what was at `source` lies at `target`, (2,) pixels of the region
        each; None: where it was."""
        seen, size = self.view, (self.region.width, self.region.height)
        target = source if target is None else target
        self.set_zoom(*enlarged(seen.view_camera_zoom, seen.view_camera_offset, size, factor, source, target))

    def set_zoom(self, zoom: float, offset: Sequence[float]) -> None:
        """Set the camera view's zoom and offset. The matrices follow at once."""
        self.view.view_camera_zoom, self.view.view_camera_offset = zoom, offset
        self.view.update()
        self.region.tag_redraw()

    def free(self) -> np.ndarray:
        """(2, 2) lower left and upper right of what lies free of the sidebar and the headers, pixels of the
        region."""
        return np.reshape(free_box(self.area, self.region), (2, 2))


def zoom_of(event: bpy.types.Event) -> float | None:
    """By how much the wheel, a key or a trackpad enlarges the picture; None for another event."""
    if event.ctrl or event.shift or event.alt or event.oskey:
        return None
    if event.type == "TRACKPADZOOM":
        return _STEP ** ((event.mouse_x - event.mouse_prev_x) / _SWIPE)
    return _ZOOMS.get(event.type) if event.value == "PRESS" else None


def first_viewport(context: bpy.types.Context) -> Viewport | None:
    """The viewport that the mouse is in, else the largest of the window."""
    window = context.window
    if window is None:
        return None
    areas = [a for a in window.screen.areas if a.type == "VIEW_3D"]
    if context.area in areas:
        areas = [context.area]
    return _parts(max(areas, key=lambda a: a.width * a.height)) if areas else None


def viewport_at(context: bpy.types.Context, address: int) -> Viewport | None:
    """The viewport whose area lies at that address; None where it is gone or shows something else."""
    window = context.window
    for area in window.screen.areas if window is not None else ():
        if area.as_pointer() == address and area.type == "VIEW_3D":
            return _parts(area)
    return None


def _parts(area: bpy.types.Area) -> Viewport | None:
    region, space = camera_region(area), area.spaces.active
    if region is None or not isinstance(space, bpy.types.SpaceView3D):
        return None
    return Viewport(area, region, space)


class CaptureView:
    """Turns a viewport to the capture camera, and back to how it was."""

    def __init__(self, viewport: Viewport, camera: bpy.types.Object, context: bpy.types.Context) -> None:
        self.address = viewport.area.as_pointer()
        self.camera = camera.name
        view, space = viewport.view, viewport.space
        self._region = {name: _copied(getattr(view, name)) for name in _OF_REGION}
        self._space = {name: getattr(space, name) for name in _OF_SPACE}
        self._space_camera = space.camera.name if space.camera is not None else None
        shows = self.shows(viewport)
        # With the lock, turning the view would move the camera away from its picture.
        space.lock_camera = False
        if shows:
            return
        self.face(viewport)
        viewport.show_picture(camera, context.scene)

    def face(self, viewport: Viewport) -> None:
        """Have the viewport look through the capture camera."""
        scene, space, camera = bpy.context.scene, viewport.space, bpy.data.objects[self.camera]
        if scene is not None and scene.camera != camera:
            space.use_local_camera = True
            space.camera = camera
        elif space.use_local_camera:
            space.camera = camera
        viewport.view.view_perspective = "CAMERA"

    def shows(self, viewport: Viewport) -> bool:
        """Whether the viewport looks through the capture camera now."""
        scene = bpy.context.scene
        space = viewport.space
        camera = space.camera if space.use_local_camera or scene is None else scene.camera
        return (
            viewport.view.view_perspective == "CAMERA" and camera is not None and camera.name == self.camera
        )

    def leave(self, context: bpy.types.Context) -> None:
        """Put the view back; nothing where the viewport is gone."""
        viewport = viewport_at(context, self.address)
        if viewport is None:
            return
        if self._space_camera is None or self._space_camera in bpy.data.objects:
            viewport.space.camera = bpy.data.objects.get(self._space_camera or "")
        for name, value in self._space.items():
            setattr(viewport.space, name, value)
        for name, value in self._region.items():
            setattr(viewport.view, name, value)


def picture_matrix(viewport: Viewport, camera: bpy.types.Object, intrinsics: Intrinsics) -> np.ndarray:
    """The (3, 3) map from pixels of the picture to pixels of the viewport's region."""
    return picture_to_region(
        intrinsics,
        np.array(camera.matrix_world),
        np.array(viewport.view.perspective_matrix),
        (viewport.region.width, viewport.region.height),
    )


def _copied(value):
    """Vectors of Blender are views of what will change."""
    return (
        value.copy()
        if hasattr(value, "copy")
        else (value if isinstance(value, str | float) else tuple(value))
    )
