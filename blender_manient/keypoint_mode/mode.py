"""What happens while keypoints are edited: hovering, dragging, and hands that follow.

Of a drag at most one request is with the worker; the newest place of the mouse goes there as soon as the
answer is back. Bones follow at once, without keys; releasing the mouse writes the keys, the neighbours'
too, and one undo step.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Final

import bpy
import numpy as np

from handfit_core.edit.corrections import Pins
from handfit_core.errors import HandfitError
from handfit_core.geometry.picture_map import mapped
from handfit_core.skeleton import NUM_KEYPOINTS

from .. import details, jobs, preferences, screen, shared_worker
from ..refiner import BonePoses, Refiner
from ..rigs import rig_of
from ..scene import see_through
from ..scene.keys import set_pose
from ..wording import capitalised, counted
from . import drawing, view

REACH: Final = 14.0
"""pixels from a handle within which the mouse takes it, at a user interface scale of 1"""
_MIN_REACH: Final = 5.0
"""Pixels: how near the mouse must come to a handle with others close by"""
_REDRAW_AFTER_SECONDS: Final = 0.06
"""seconds after which the dragged point is drawn without the hand. Before that the answer is nearly there,
and drawing twice would only make it later"""
_ANSWER_WAIT_SECONDS: Final = 0.04
"""seconds that a movement of the mouse may wait for its answer, so that the next picture has the hand in its
place; a worker that was slower the last time is not waited for"""
_SENSIBLE_POINTS: Final = 6
"""points of a hand that was added: so many make a sensible pose"""
_CLICK_PIXELS: Final = 3
"""pixels. A press that moves less is a click"""
_FRAME_SIZES: Final = 2.0
"""sizes of the hand that the view shows of the picture: half of one on each side of it"""

latencies: deque[float] = deque(maxlen=2000)
"""seconds from a movement of the mouse to the hand that followed it, newest last"""


@dataclass(frozen=True, eq=False)
class _SavedView:
    """The camera view in which the artist last saw a hand."""

    zoom: float
    offset: tuple[float, float]
    places: np.ndarray
    """(21, 2) pixels of the picture: where the hand was then"""


_saved_views: dict[int, _SavedView] = {}
"""By the armatures' session_uid, which a rename and an undo leave and which no other file's hand gets"""


def forget_views() -> None:
    """Forget all saved views: another file is opened."""
    _saved_views.clear()


@dataclass(eq=False)
class _Drag:
    """One keypoint between press and release, or one that is let go of."""

    keypoint: int
    row: int
    frame: float
    """Scene frame"""
    pins_before: Pins
    """The frame's pins until now"""
    start: BonePoses
    """What the pins are measured against"""
    poses_before: BonePoses
    """What the bones are put back to when it is cancelled"""
    mouse: tuple[int, int]
    grip: np.ndarray
    """(2,) pixels of the region from the mouse to the handle"""
    place: np.ndarray | None = None
    """(2,) pixels of the picture: where the pin is to be; None: it goes"""
    moved_at: float = 0.0
    moved: bool = False
    released: bool = False
    request: int = 0
    sent: np.ndarray | None = None
    sent_at: float = 0.0
    is_sent: bool = False
    is_final: bool = False
    """Whether the last request was one for the result to be kept, and not a draft"""
    requested_pins: Pins = field(default_factory=dict)
    """The pins of the request"""
    answer: BonePoses | None = None
    answered_pins: Pins = field(default_factory=dict)
    """The pins that `answer` was fitted to"""
    drawn: bool = True
    """Whether the view was asked to show the newest place"""

    @property
    def pins(self) -> Pins:
        """The frame's pins with this one where it is to be."""
        others = {k: p for k, p in self.pins_before.items() if k != self.keypoint}
        if self.place is None:
            return others
        return {**others, self.keypoint: (float(self.place[0]), float(self.place[1]))}

    @property
    def needs_request(self) -> bool:
        """Whether no request has the newest place yet."""
        return not self.is_sent or self.sent is not self.place or (self.released and not self.is_final)


class KeypointMode:
    """The state of the mode, from its start to `end`. Data-blocks are named, never held."""

    def __init__(self, context: bpy.types.Context, refiner: Refiner, viewport: view.Viewport) -> None:
        """Turn the viewport to the hand in its picture and warm the worker up. Raises HandfitError."""
        self.refiner = refiner
        self.drag: _Drag | None = None
        self.hovered: int | None = None
        self.message = ""
        self.undone = 0
        self.done = 0
        """drags of this mode that can be undone, and those that can be done again"""
        self.own_undo = False
        self.ended: str | None = None
        """Why the mode is over, in a sentence; empty: because the artist said so"""
        camera = refiner.hand.camera
        assert camera is not None
        self._warming = shared_worker.worker().submit("warm")
        self._solved_in = _ANSWER_WAIT_SECONDS
        self.view = view.CaptureView(viewport, camera, context)
        self.solid = False
        """Whether the hand hides the picture, whatever its opacity is otherwise"""
        see_through.begin(camera.data, self._opacity)
        self._frame = context.scene.frame_current_final
        self._places = self.picture_places()
        """(21, 2) pixels of the picture: the hand on that frame, or on the last one before that had one"""
        self._restore_view(viewport)
        self._handler = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), "WINDOW", "POST_PIXEL")
        viewport.area.tag_redraw()

    # Beginning and end

    def end(self, context: bpy.types.Context) -> None:
        """Leave nothing behind. May be called twice."""
        if self._handler is None:
            return
        if self.drag is not None:
            self.cancel_drag(context)
        bpy.types.SpaceView3D.draw_handler_remove(self._handler, "WINDOW")
        self._handler = None
        if self._warming:
            shared_worker.abandon(self._warming)
        see_through.end()
        self._save_view(context)
        self.view.leave(context)
        screen.redraw("VIEW_3D")

    def trouble(self, context: bpy.types.Context) -> str | None:
        """Why the mode cannot go on, in a sentence."""
        if self.ended is not None:
            return self.ended
        if jobs.busy():
            return "Keypoints: a capture has begun"
        if view.viewport_at(context, self.view.address) is None:
            return "Keypoints: the viewport is gone"
        armature = self.refiner.armature_or_none
        if armature is None or armature.name not in context.view_layer.objects:
            return "Keypoints: the hand is gone"
        try:
            if self.refiner.hand.camera is None:
                return "Keypoints: the capture camera is gone"
        except HandfitError as error:
            return f"Keypoints: {error}"
        if context.mode not in ("OBJECT", "POSE"):
            return "Keypoints: refining works in Object and Pose mode"
        return None

    # Zoom and pan of the picture

    def show_hand(self, viewport: view.Viewport) -> None:
        """Frame the hand with half its size on each side; the whole picture on a frame without it."""
        self.show_picture(viewport)
        places = self.region_places(viewport)
        if np.isnan(places).all():
            return
        low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
        free = viewport.free()
        factor = ((free[1] - free[0]) / np.maximum(_FRAME_SIZES * (high - low), 1.0)).min()
        viewport.enlarge(float(factor), (low + high) / 2.0, free.mean(axis=0))

    def show_picture(self, viewport: view.Viewport) -> None:
        """Frame the whole picture."""
        self.view.face(viewport)
        camera = self.refiner.hand.camera
        assert camera is not None
        viewport.show_picture(camera, bpy.context.scene)

    def _restore_view(self, viewport: view.Viewport) -> None:
        """Restore the saved view of the hand; without one, or where no point would be seen, frame the
        hand."""
        armature = self.refiner.armature_or_none
        saved = _saved_views.get(armature.session_uid) if armature is not None else None
        if saved is None:
            self.show_hand(viewport)
            return
        viewport.set_zoom(saved.zoom, saved.offset)
        if not self._keep_visible(viewport, saved.places):
            self.show_hand(viewport)

    def _save_view(self, context: bpy.types.Context) -> None:
        viewport, armature = view.viewport_at(context, self.view.address), self.refiner.armature_or_none
        if viewport is not None and armature is not None and self.view.shows(viewport):
            seen = viewport.view
            offset = tuple(seen.view_camera_offset)
            _saved_views[armature.session_uid] = _SavedView(seen.view_camera_zoom, offset, self._places)

    def _follow_hand(self, context: bpy.types.Context) -> None:
        """Move the view with the hand where another frame is shown now."""
        if context.scene.frame_current_final == self._frame:
            return
        self._frame, before = context.scene.frame_current_final, self._places
        now = self.picture_places()
        if np.isnan(now).all():
            return
        self._places = now
        viewport = view.viewport_at(context, self.view.address)
        if viewport is not None:
            self._keep_visible(viewport, before)

    def _keep_visible(self, viewport: view.Viewport, before: np.ndarray) -> bool:
        """Have the view show those points that it showed when they were at `before`, (21, 2) pixels of the
        picture: it moves to their middle if one has left it, and keeps its zoom. Returns whether there are
        any."""
        viewport.view.update()  # since the last zoom
        matrix = self.matrix(viewport)
        if matrix is None:
            return False
        low, high = viewport.free()
        places = mapped(matrix, before)
        seen = ((places >= low) & (places <= high)).all(axis=1)
        places = mapped(matrix, self._places)[seen]
        places = places[np.isfinite(places).all(axis=1)]
        if ((places < low) | (places > high)).any():
            middle = (places.min(axis=0) + places.max(axis=0)) / 2.0
            viewport.enlarge(1.0, middle, (low + high) / 2.0)
        return len(places) > 0

    # The hand over the picture

    def toggle_solid(self) -> None:
        """Make the hand solid, or see-through again."""
        self.solid = not self.solid
        see_through.follow()
        screen.redraw("VIEW_3D")

    def _opacity(self) -> float:
        return 1.0 if self.solid else preferences.get().hand_opacity

    # Places of the handles

    def row(self) -> int | None:
        """The take's row that the scene shows."""
        scene = bpy.context.scene
        return None if scene is None else self.refiner.row_at(scene.frame_current_final)

    def picture_places(self) -> np.ndarray:
        """(21, 2) pixels of the picture: pins, else the fitted hand's points where the frame was re-fitted,
        else what was detected, else the points of the animated hand."""
        row = self.row()
        if row is None:
            return np.full((NUM_KEYPOINTS, 2), np.nan)
        pins: Pins = self.refiner.pins(row)
        if self.drag is not None:
            pins = self.drag.pins
        if self.drag is not None or self.refiner.is_corrected(row) or not self.refiner.track.detected[row]:
            places = self.refiner.shown_landmarks()
        else:
            places = np.array(self.refiner.track.keypoints_2d[row], dtype=np.float64)
        for keypoint, place in pins.items():
            places[keypoint] = place
        return places

    def matrix(self, viewport: view.Viewport) -> np.ndarray | None:
        """Picture to region; None while the viewport does not look through the capture camera."""
        camera = self.refiner.hand.camera
        if camera is None or not self.view.shows(viewport):
            return None
        return view.picture_matrix(viewport, camera, self.refiner.take.intrinsics)

    def region_places(self, viewport: view.Viewport) -> np.ndarray:
        """(21, 2) pixels of the region; NaN where there is no handle."""
        matrix = self.matrix(viewport)
        if matrix is None:
            return np.full((NUM_KEYPOINTS, 2), np.nan)
        return mapped(matrix, self.picture_places())

    def handle_at(self, viewport: view.Viewport, x: int, y: int) -> int | None:
        """The handle nearest to a place in window pixels, within reach."""
        mouse = np.array([x - viewport.region.x, y - viewport.region.y])
        places = self.region_places(viewport)
        away = np.linalg.norm(places - mouse, axis=-1)
        if np.isnan(away).all():
            return None
        nearest, scale = int(np.nanargmin(away)), screen.ui_scale()
        reach = np.clip(drawing.half_gaps(places)[nearest], _MIN_REACH * scale, REACH * scale)
        return nearest if away[nearest] <= reach else None

    # Dragging

    def press(self, context: bpy.types.Context, viewport: view.Viewport, x: int, y: int) -> bool:
        """Take the handle there, if there is one."""
        keypoint, row = self.handle_at(viewport, x, y), self.row()
        if keypoint is None or row is None or self.drag is not None:
            return False
        if context.screen is not None and context.screen.is_animation_playing:
            bpy.ops.screen.animation_cancel(restore_frame=False)
        places = self.region_places(viewport)
        grip = places[keypoint] - [x - viewport.region.x, y - viewport.region.y]
        self.drag = self._new_drag(keypoint, row, (x, y), grip)
        self.message = ""
        return True

    def move(self, viewport: view.Viewport, x: int, y: int) -> None:
        """The mouse drags the handle there."""
        drag, matrix = self.drag, self.matrix(viewport)
        if drag is None or matrix is None or drag.released:
            return
        drag.moved |= max(abs(x - drag.mouse[0]), abs(y - drag.mouse[1])) >= _CLICK_PIXELS
        if not drag.moved:
            return
        region = np.array([x - viewport.region.x, y - viewport.region.y]) + drag.grip
        size = self.refiner.take.width, self.refiner.take.height
        # A hand may well reach out of the picture, but not for miles.
        drag.place = np.clip(mapped(np.linalg.inv(matrix), region), -np.array(size), 2 * np.array(size))
        drag.moved_at = time.perf_counter()
        drag.drawn = False

    def release(self) -> None:
        """End a drag; its last request is still waited for."""
        if self.drag is None:
            return
        if self.drag.moved:
            self.drag.released = True
        else:
            self.drag = None

    def unpin(self, keypoint: int) -> bool:
        """Let a pinned keypoint go: the hand follows the other pins only."""
        row = self.row()
        if row is None or self.drag is not None or keypoint not in self.refiner.pins(row):
            return False
        self.drag = self._new_drag(keypoint, row, (0, 0), np.zeros(2))
        self.drag.moved = self.drag.released = True
        self.drag.moved_at = time.perf_counter()
        return True

    def cancel_drag(self, context: bpy.types.Context) -> None:
        """Put the hand back to before the drag."""
        drag, self.drag = self.drag, None
        if drag is None:
            return
        if drag.request:
            shared_worker.worker().cancel(drag.request)
            shared_worker.abandon(drag.request)
        armature = self.refiner.armature_or_none
        if armature is not None and armature.manient.is_hand:
            set_pose(rig_of(armature), drag.poses_before.quats[0], drag.poses_before.locations[0])
            if context.scene.frame_current_final != drag.frame:
                refresh(context.scene)  # that was another frame's pose
        screen.redraw("VIEW_3D")

    def tick(self, context: bpy.types.Context) -> None:
        """Look for answers, and ask for what has not been asked for."""
        self._follow_hand(context)
        drag = self.drag
        try:
            if self._warming and shared_worker.answer(self._warming) is not None:
                self._warming = 0
                screen.redraw("VIEW_3D")
            if drag is None:
                return
            if context.scene.frame_current_final != drag.frame:
                self.cancel_drag(context)
                return
            if drag.request:
                done = shared_worker.answer(drag.request)
                if done is not None:
                    drag.request = 0
                    self._solved_in = float(done.get("seconds", 0.0))
                    self._show(context, drag, self.refiner.poses(done))
            if not drag.request and drag.moved and drag.needs_request:
                if drag.place is None and not self._is_constrained(drag):
                    self._finish(context, drag)  # nothing pinned any more: nothing to be fitted
                else:
                    self._send(drag)
            elif not drag.request and drag.released:
                self._finish(context, drag)
            if not drag.drawn and time.perf_counter() - drag.moved_at > _REDRAW_AFTER_SECONDS:
                drag.drawn = True
                self._redraw(context)
        except HandfitError as error:
            self._fail(context, error)

    def follow(self, context: bpy.types.Context) -> None:
        """`tick`, and a moment's patience with the answer."""
        waited_before = self.drag is not None and self.drag.request
        self.tick(context)
        # A drawing of a crowded scene takes longer than the answer, which would then be late by one.
        until = time.perf_counter() + (
            0.0 if waited_before or self._solved_in > _ANSWER_WAIT_SECONDS else _ANSWER_WAIT_SECONDS
        )
        while self.drag is not None and self.drag.request and time.perf_counter() < until:
            time.sleep(0.001)
            self.tick(context)

    def _redraw(self, context: bpy.types.Context) -> None:
        """The picture and what is over it; not the headers and the sidebar beside it."""
        viewport = view.viewport_at(context, self.view.address)
        if viewport is not None:
            viewport.region.tag_redraw()

    def _new_drag(self, keypoint: int, row: int, mouse: tuple[int, int], grip: np.ndarray) -> _Drag:
        refiner = self.refiner
        return _Drag(
            keypoint,
            row,
            bpy.context.scene.frame_current_final,
            refiner.pins(row),
            refiner.start_poses([row]),
            refiner.keyed_poses([row]),
            mouse,
            grip,
        )

    def _send(self, drag: _Drag) -> None:
        drag.sent, drag.sent_at, drag.is_sent = drag.place, drag.moved_at, True
        drag.requested_pins = drag.pins
        drag.is_final = drag.released
        mode = "each" if drag.released else "draft"
        fields = self.refiner.request([drag.row], [drag.requested_pins], drag.start, mode)()
        drag.request = shared_worker.worker().submit("refit", **fields)

    def _show(self, context: bpy.types.Context, drag: _Drag, poses: BonePoses) -> None:
        if not poses.present[0]:
            self.message = "No hand can be fitted to these points"
            return
        drag.answer, drag.answered_pins = poses, drag.requested_pins
        set_pose(self.refiner.hand.rig, poses.quats[0], poses.locations[0])
        context.view_layer.update()
        latencies.append(time.perf_counter() - drag.sent_at)
        drag.drawn = drag.sent is drag.place
        self._redraw(context)

    def _is_constrained(self, drag: _Drag) -> bool:
        """Whether the frame's hand has pins, or points that touch."""
        return bool(drag.pins or self.refiner.touches(drag.row))

    def _finish(self, context: bpy.types.Context, drag: _Drag) -> None:
        """Write the keys, and make an undo step of it."""
        self.drag = None
        if not self._is_constrained(drag):
            self.refiner.unpin(drag.row)
        elif drag.answer is None:
            set_pose(self.refiner.hand.rig, drag.poses_before.quats[0], drag.poses_before.locations[0])
            return
        else:
            self.refiner.correct(drag.row, drag.answered_pins, drag.answer, context.scene.manient.spread)
        refresh(context.scene)
        self.done, self.undone = self.done + 1, 0
        bpy.ops.ed.undo_push(message="Move Keypoint" if drag.place is not None else "Remove Pin")
        screen.redraw("VIEW_3D")

    def _fail(self, context: bpy.types.Context, error: HandfitError) -> None:
        self._warming, self.message = 0, str(error)
        if self.drag is not None:
            self.drag.request = 0
        details.write_details("Edit Keypoints", str(error), getattr(error, "details", "") or "")
        self.cancel_drag(context)
        refresh(context.scene)

    def step(self, scene: bpy.types.Scene, direction: int) -> None:
        """Go to the next frame (1) or the one before (-1); the source's where the scene has others."""
        frames = self.refiner.scene_frames()
        here = scene.frame_current_final
        ahead = (frames - here) * direction
        if np.all(np.abs(frames - np.round(frames)) < 1e-3) or not np.any(ahead > 1e-3):
            scene.frame_set(scene.frame_current + direction)
            return
        frame = float(frames[ahead > 1e-3][np.argmin(ahead[ahead > 1e-3])])
        scene.frame_set(int(np.floor(frame)), subframe=frame - np.floor(frame))

    # Undo and redo of single drags

    def undo(self, context: bpy.types.Context, *, redo: bool) -> None:
        """Take the last drag of this mode back, or do it again."""
        if self.drag is not None:
            self.cancel_drag(context)
        if (self.undone if redo else self.done) == 0:
            self.message = "Nothing to do again here" if redo else "Nothing to undo here"
            return
        self.own_undo = True
        try:
            bpy.ops.ed.redo() if redo else bpy.ops.ed.undo()
        except RuntimeError as error:
            self.message = str(error).strip()
            return
        finally:
            self.own_undo = False
        step = 1 if redo else -1
        self.done, self.undone = self.done + step, self.undone - step
        self.message = ""
        refresh(bpy.context.scene)

    # Drawing

    def _draw(self) -> None:
        context = bpy.context
        if context.area is None or context.area.as_pointer() != self.view.address:
            return
        if self.trouble(context) is not None:
            return
        viewport = view.viewport_at(context, self.view.address)
        if viewport is None or context.region != viewport.region:
            return
        text, warning = self.status_line(viewport)
        drawing.draw(
            drawing.Picture(
                places=self.region_places(viewport),
                pinned=frozenset(self._pinned()),
                hovered=self.hovered,
                dragged=self.drag.keypoint if self.drag is not None else None,
                text=text,
                warning=warning,
                corner=free_corner(viewport),
            )
        )

    def _pinned(self) -> Pins:
        row = self.row()
        if row is None:
            return {}
        return self.drag.pins if self.drag is not None else self.refiner.pins(row)

    def status_line(self, viewport: view.Viewport) -> tuple[str, bool]:
        """The line over the picture about this frame, and whether it is a warning."""
        row = self.row()
        if self.message:
            return capitalised(self.message), True
        if not self.view.shows(viewport):
            return "Numpad 0: look through the capture camera again", True
        if row is None:
            return "This frame was not captured: go to another one", True
        if self._warming:
            return "Starting the solver ...", False
        track = self.refiner.track
        if track.added:
            placed = len(self._pinned())
            enough = ": three to six are enough, fingertips first" if placed < _SENSIBLE_POINTS else ""
            return f"{counted(placed, 'point')} of the {track.side} hand placed{enough}", False
        if self.refiner.is_corrected(row):
            return f"{len(self._pinned())} pinned in this frame", False
        if not track.detected[row]:
            return "No hand was found in this frame: drag points to where they belong", True
        if track.doubtful is not None and track.doubtful[row]:
            return "Doubtful frame", True
        return "", False


def refresh(scene: bpy.types.Scene) -> None:
    """Show what the keys of the present frame say now."""
    scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)


def free_corner(viewport: view.Viewport) -> tuple[float, float]:
    """Where a line can begin, pixels of the region: right of the toolbar, below Blender's own lines."""
    region, others = viewport.region, [r for r in viewport.area.regions if min(r.width, r.height) > 1]
    top = min([r.y for r in others if r.type in ("HEADER", "TOOL_HEADER")] + [region.y + region.height])
    if top < region.y + region.height / 2:
        top = region.y + region.height  # headers may be flipped to the lower edge
    tools = [r.x + r.width for r in others if r.type == "TOOLS" and r.x < region.x + region.width / 2]
    scale = screen.ui_scale()
    return max([region.x, *tools]) - region.x + 18.0 * scale, top - region.y - 70.0 * scale
