"""3D viewports in which a mode runs: what they show, how it is enlarged, and what is drawn over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import bpy
import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.picture_map import picture_to_region

from ...common.screen import camera_region, enlarged, frame_whole_picture, free_box, redraw, ui_scale
from ...scene import captures

MAX_ZOOM: Final = 64.0
"""The most pixels of the region for one of the picture"""
_OF_REGION = (
    *("view_perspective", "view_camera_zoom", "view_camera_offset"),
    *("view_distance", "view_location", "view_rotation"),
)
_OF_SPACE = ("camera", "use_local_camera", "lock_camera")
_STEP: Final = 1.25
"""The factor by which one notch of the wheel enlarges"""
_SWIPE: Final = 20.0
"""The pixels that fingers move on a trackpad to enlarge as one notch of the wheel does"""
_GIZMO_MARGIN, _GIZMO_BUTTONS = 20.0, 170.0
"""pixels at a user interface scale of 1: around the axes in a viewport's upper right corner, and the height
of the buttons below them"""
_ZOOMS: Final = {"WHEELUPMOUSE": 1, "NUMPAD_PLUS": 1, "WHEELDOWNMOUSE": -1, "NUMPAD_MINUS": -1}
"""By the type of an event, by how many notches it enlarges"""


@dataclass(frozen=True)
class Viewport:
    """A 3D viewport's parts. Held for one event only: Blender may free them between two."""

    area: bpy.types.Area
    region: bpy.types.Region
    space: bpy.types.SpaceView3D

    @property
    def view(self) -> bpy.types.RegionView3D:
        """Return Blender's own data of the region's view."""
        return self.space.region_3d

    def contains(self, x: int, y: int) -> bool:
        """True if a place in window pixels lies in the view, and not in what overlaps it."""

        def inside(region: bpy.types.Region) -> bool:
            shown = min(region.width, region.height) > 1
            return shown and 0 <= x - region.x < region.width and 0 <= y - region.y < region.height

        return inside(self.region) and not any(inside(r) for r in self.area.regions if r.type != "WINDOW")

    def mouse(self, event: bpy.types.Event) -> np.ndarray:
        """Return (2,) pixels of the region: where the mouse is."""
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

    def has_gizmos(self, place: np.ndarray) -> bool:
        """True if Blender's buttons for turning and moving the view may lie there, pixels of the region."""
        preferences = bpy.context.preferences
        if preferences is None or not (self.space.show_gizmo and self.space.show_gizmo_navigate):
            return False
        size = preferences.view.gizmo_size_navigate_v3d + _GIZMO_MARGIN
        corner = self.free()[1] - np.array([size, size + _GIZMO_BUTTONS]) * ui_scale()
        return bool((place >= corner).all())

    def free(self) -> np.ndarray:
        """Return (2, 2) pixels of the region: the lower left and upper right of what lies free of the sidebar
        and the headers."""
        return np.reshape(free_box(self.area, self.region), (2, 2))


def zoom_of(event: bpy.types.Event) -> float | None:
    """Return the factor by which the wheel, a key or a trackpad enlarges the picture; None for another
    event."""
    if event.ctrl or event.shift or event.alt or event.oskey:
        return None
    if event.type == "TRACKPADZOOM":
        return _STEP ** ((event.mouse_x - event.mouse_prev_x) / _SWIPE)
    notches = _ZOOMS.get(event.type) if event.value == "PRESS" else None
    return None if notches is None else _STEP**notches


def first_viewport(context: bpy.types.Context) -> Viewport | None:
    """Return the viewport that the mouse is in, else the largest of the window; None where there is none."""
    areas = _areas(context)
    if context.area in areas:
        return _parts(context.area)
    return _parts(max(areas, key=lambda a: a.width * a.height)) if areas else None


def viewport_at(context: bpy.types.Context, address: int) -> Viewport | None:
    """Return the viewport whose area lies at that address; None where it is gone or shows something else."""
    return next((_parts(area) for area in _areas(context) if area.as_pointer() == address), None)


def viewports(context: bpy.types.Context) -> list[Viewport]:
    """Return all viewports of the window."""
    return [there for there in map(_parts, _areas(context)) if there is not None]


def _areas(context: bpy.types.Context) -> list[bpy.types.Area]:
    window = context.window
    return [] if window is None else [area for area in window.screen.areas if area.type == "VIEW_3D"]


def _parts(area: bpy.types.Area) -> Viewport | None:
    region, space = camera_region(area), area.spaces.active
    if region is None or not isinstance(space, bpy.types.SpaceView3D):
        return None
    return Viewport(area, region, space)


def free_corner(viewport: Viewport) -> tuple[float, float]:
    """Return where a line of text can begin, x and y in pixels of the region: right of the toolbar, below
    Blender's own lines."""
    (left, _), (_, top) = viewport.free()
    return left + 12.0 * ui_scale(), top - 64.0 * ui_scale()


class Overlay:
    """Draws over one viewport until `remove`."""

    def __init__(self, viewport: Viewport) -> None:
        self.address = viewport.area.as_pointer()
        self._handler = bpy.types.SpaceView3D.draw_handler_add(self._on_draw, (), "WINDOW", "POST_PIXEL")
        viewport.area.tag_redraw()

    def remove(self) -> bool:
        """Draw no more; return whether it did until now."""
        handler, self._handler = self._handler, None
        if handler is None:
            return False
        bpy.types.SpaceView3D.draw_handler_remove(handler, "WINDOW")
        redraw("VIEW_3D")
        return True

    def viewport(self) -> Viewport | None:
        """Return the viewport; None where it is gone."""
        return viewport_at(bpy.context, self.address)

    def draw(self, viewport: Viewport) -> None:
        """Draw in the viewport's region, in pixels."""
        raise NotImplementedError

    def draw_beside(self, viewport: Viewport) -> None:
        """Draw in the region of another viewport of the window, in pixels."""

    def _on_draw(self) -> None:
        context = bpy.context
        viewport = _parts(context.area) if context.area in _areas(context) else None
        if viewport is not None and context.region == viewport.region:
            here = context.area.as_pointer() == self.address
            (self.draw if here else self.draw_beside)(viewport)


def _kept(view: bpy.types.RegionView3D) -> dict[str, float | str | tuple[float, ...]]:
    # Vectors of Blender are views of what will change.
    now = {name: getattr(view, name) for name in _OF_REGION}
    return {name: v if isinstance(v, float | str) else tuple(v) for name, v in now.items()}


class CaptureView:
    """Turns a viewport to one of a capture's cameras, and back to how it was."""

    def __init__(
        self, viewport: Viewport, cameras: Sequence[bpy.types.Object], context: bpy.types.Context
    ) -> None:
        """Look through the camera that the viewport looks through already, else the scene's, else the
        first."""
        self.address = viewport.area.as_pointer()
        self._cameras = [camera.name for camera in cameras]
        looking = self.looks(viewport)
        if looking is None:
            looking = next((i for i, camera in enumerate(cameras) if camera == context.scene.camera), 0)
        self.camera = self._cameras[looking]
        """The name of the camera that is looked through, or was last"""
        space = viewport.space
        self._region = _kept(viewport.view)
        # Objects are named, never held.
        self._space = {name: getattr(space, name) for name in _OF_SPACE}
        self._space["camera"] = space.camera.name if space.camera is not None else None
        shows = self.shows(viewport)
        # With the lock, turning the view would move the camera away from its picture.
        space.lock_camera = False
        if not shows:
            self.face(viewport)
            viewport.show_picture(cameras[looking], context.scene)

    @property
    def looking(self) -> int:
        """Return the index of the camera that is looked through, or was last."""
        return self._cameras.index(self.camera)

    def face(self, viewport: Viewport) -> None:
        """Have the viewport look through the capture camera."""
        scene, space, camera = bpy.context.scene, viewport.space, bpy.data.objects[self.camera]
        if scene is not None:
            captures.leave_other_view(scene, camera)
        if scene is not None and scene.camera != camera:
            space.use_local_camera = True
        if space.use_local_camera:
            space.camera = camera
        viewport.view.view_perspective = "CAMERA"

    def looks(self, viewport: Viewport) -> int | None:
        """Return the index of the camera that a viewport looks through now; None where it is another one, or
        none."""
        scene, space = bpy.context.scene, viewport.space
        camera = space.camera if space.use_local_camera or scene is None else scene.camera
        through = viewport.view.view_perspective == "CAMERA"
        name = camera.name if through and camera is not None else ""
        return self._cameras.index(name) if name in self._cameras else None

    def shows(self, viewport: Viewport) -> bool:
        """True if the viewport looks through one of the cameras now."""
        return self.looks(viewport) is not None

    def follow(self, viewport: Viewport) -> bool:
        """Take notice of the camera that the viewport looks through now; return whether that is another
        one."""
        before, looking = self.camera, self.looks(viewport)
        self.camera = before if looking is None else self._cameras[looking]
        return self.camera != before

    def switch(self, viewport: Viewport, scene: bpy.types.Scene) -> None:
        """Look through the other camera. The scene does so, too, where the viewport has none of its own."""
        other = bpy.data.objects[self._cameras[1 - self.looking]]
        if viewport.space.use_local_camera:
            viewport.space.camera = other
        else:
            captures.leave_other_view(scene, other)

    def leave(self, context: bpy.types.Context) -> None:
        """Put the view back; nothing where the viewport is gone."""
        viewport = viewport_at(context, self.address)
        if viewport is None:
            return
        of_space = {**self._space, "camera": bpy.data.objects.get(self._space["camera"] or "")}
        if not (self._space["use_local_camera"] or viewport.space.use_local_camera):
            del of_space["camera"]  # the scene's, which may have been switched meanwhile
        for where, values in ((viewport.space, of_space), (viewport.view, self._region)):
            for name, value in values.items():
                setattr(where, name, value)


class FrontView:
    """Turns a viewport to look along +Y, as the camera of new hands does, at hands an arm's length away; and
    back to how it was."""

    _DISTANCE, _AWAY = 0.9, 0.45
    """Metres: how far the view stands from the point that it looks at, and that point from the camera of the
    hands"""

    def __init__(self, viewport: Viewport, scene: bpy.types.Scene) -> None:
        self._address, view = viewport.area.as_pointer(), viewport.view
        self._before = _kept(view)
        units = 1.0 / scene.unit_settings.scale_length
        view.view_perspective = "PERSP"
        view.view_rotation = (0.5**0.5, 0.5**0.5, 0.0, 0.0)
        view.view_location, view.view_distance = (0.0, self._AWAY * units, 0.0), self._DISTANCE * units

    def leave(self, context: bpy.types.Context) -> None:
        """Put the view back; nothing where the viewport is gone."""
        viewport = viewport_at(context, self._address)
        if viewport is not None:
            for name, value in self._before.items():
                setattr(viewport.view, name, value)


def picture_matrix(viewport: Viewport, camera: bpy.types.Object, intrinsics: Intrinsics) -> np.ndarray:
    """Return the (3, 3) map from pixels of the picture to pixels of the viewport's region."""
    size = viewport.region.width, viewport.region.height
    perspective = np.array(viewport.view.perspective_matrix)
    return picture_to_region(intrinsics, np.array(camera.matrix_world), perspective, size)


class PictureView:
    """Pan and zoom of a picture that no camera shows, in pixels of a region of which a box is `free`: left,
    bottom, right, top."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = np.array(size, dtype=np.float64)
        """(2,) pixels: the width and height of the picture"""
        self.show_all()

    def show_all(self) -> None:
        """Show the whole picture."""
        self._zoom, self._centre = 1.0, self.size / 2.0

    def scale(self, free: Sequence[float]) -> float:
        """Return how many pixels of the region one of the picture takes."""
        room = np.maximum([free[2] - free[0], free[3] - free[1]], 1.0)
        return float((room / self.size).min()) * self._zoom

    def matrix(self, free: Sequence[float]) -> np.ndarray:
        """Return the (3, 3) map from pixels of the picture to those of the region, whose y grows upwards."""
        scale, middle = self.scale(free), np.array([free[0] + free[2], free[1] + free[3]]) / 2.0
        x, y = middle - self._centre * [scale, -scale]
        return np.array([[scale, 0.0, x], [0.0, -scale, y], [0.0, 0.0, 1.0]])

    def zoom(self, factor: float, place: np.ndarray, free: Sequence[float]) -> None:
        """Enlarge by a factor about a place (2,) in the picture."""
        before = self._zoom
        most = MAX_ZOOM * self._zoom / self.scale(free)
        self._zoom = float(np.clip(before * factor, min(1.0, most), most))
        self._look_at(place + (self._centre - place) * before / self._zoom)

    def move(self, by: np.ndarray, free: Sequence[float]) -> None:
        """Move the picture by (2,) pixels of the region."""
        self._look_at(self._centre - by * [1.0, -1.0] / self.scale(free))

    def _look_at(self, centre: np.ndarray) -> None:
        """Move the middle of the view to this place of the picture, as far as it is in the picture."""
        self._centre = np.clip(centre, 0.0, self.size)
