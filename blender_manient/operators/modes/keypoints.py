"""What happens while keypoints are edited: hovering, dragging, and hands that follow.

Of a drag at most one request is with the worker; the newest place of the mouse goes there as soon as the
answer is back. Bones follow at once, without keys; releasing the mouse writes the keys, the neighbours'
too, and one undo step.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

import bpy
import numpy as np

from handfit_core.common.errors import HandfitError
from handfit_core.common.skeleton import NUM_KEYPOINTS
from handfit_core.edit.corrections import Pins
from handfit_core.geometry.picture_map import mapped

from ...common import preferences, screen
from ...common.wording import capitalised, counted
from ...rigs import rig_of
from ...scene import see_through
from ...scene.camera import captured_place
from ...scene.keys import set_pose
from ...session import jobs, shared_worker
from ...session.refiner import BonePoses, Refiner
from ..base import show_frame_again
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
saved_views: dict[tuple[int, int], tuple[float, tuple[float, ...], np.ndarray]] = {}
"""For each hand (its armature's session_uid) and view: zoom and offset of the camera view in which the artist
last saw the hand, and its (21, 2) pixels of the picture then. A session_uid outlives renames and undos."""


class _Request(NamedTuple):
    """A request to the worker about a drag."""

    place: np.ndarray | None
    moved_at: float
    pins: Pins
    final: bool
    """True if the answer is to be kept, and is no draft"""


@dataclass(eq=False)
class _Drag:
    """One keypoint between press and release, or one that is let go of."""

    keypoint: int
    row: int
    frame: float
    """The scene frame on which the keypoint is dragged"""
    pins_before: Pins
    start: BonePoses
    """The poses that the fit to the pins starts from"""
    poses_before: BonePoses
    """The poses that the bones get back when the drag is cancelled"""
    mouse: np.ndarray | None = None
    """(2,) pixels of the region: where it was pressed; None: nowhere, the pin goes"""
    grip: np.ndarray | float = 0.0
    """(2,) pixels of the region: from the place of the press to the handle"""
    place: np.ndarray | None = None
    """(2,) pixels of the picture: where the pin is to be; None: it is taken away"""
    moved_at: float = 0.0
    moved: bool = False
    released: bool = False
    asked: _Request | None = None
    asking: shared_worker.Asking | None = None
    """The request that is with the worker; None while there is none"""
    answer: tuple[Pins, BonePoses] | None = None
    """The newest answer of the worker, after the pins that it was fitted to; None before the first"""
    drawn: bool = True
    """True if the view was asked to show the newest place"""

    @property
    def waiting(self) -> bool:
        """True if the worker has not answered yet."""
        return self.asking is not None

    @property
    def pins(self) -> Pins:
        pins = {k: p for k, p in self.pins_before.items() if k != self.keypoint}
        if self.place is not None:
            x, y = self.place
            pins[self.keypoint] = float(x), float(y)
        return pins

    @property
    def needs_request(self) -> bool:
        """True if no request has the newest place yet."""
        asked = self.asked
        return asked is None or asked.place is not self.place or (self.released and not asked.final)


class KeypointMode(view.Overlay):
    """The state of the mode, from its start to `end`. Data-blocks are named, never held.

    Of a take of two views the points are those of the picture that a viewport shows: the second clip's frames
    lie between the first one's, and its points are where they are at the moment of the picture. Points are
    dragged in the first view alone.
    """

    looking = 0
    """The view that the viewport shows, 0 or 1"""
    _places = np.full((NUM_KEYPOINTS, 2), np.nan)
    """(21, 2) pixels of the picture: the hand on the shown frame, or on the last one before that had one"""

    def __init__(self, context: bpy.types.Context, refiner: Refiner, viewport: view.Viewport) -> None:
        """Turn the viewport to the hand in its picture and warm the worker up. Raises HandfitError."""
        self.refiner = refiner
        self.drag: _Drag | None = None
        self.hovered: int | None = None
        self.message = ""
        self.undone = 0
        self.done = 0
        """How many drags of this mode can be undone, and how many can be done again"""
        self.own_undo = False
        self.ended: str | None = None
        """Why the mode is over, in a sentence; None while it goes on"""
        self._warming: shared_worker.Asking | None = shared_worker.ask("warm", "Edit Keypoints")
        next(self._warming)
        self._solved_in = _ANSWER_WAIT_SECONDS
        self.view = view.CaptureView(viewport, refiner.cameras, context)
        self.solid = False
        super().__init__(viewport)
        try:
            self._look()
            self._frame = context.scene.frame_current_final
            self._places = self.picture_places()
            self._restore_view(viewport)
        except BaseException:
            self.end(context)
            raise

    # Beginning and end

    def end(self, context: bpy.types.Context) -> None:
        """Take the drawing away and put the viewport back as it was. May be called twice."""
        if not self.remove():
            return
        self.cancel_drag(context)
        if self._warming:
            self._warming.close()
        see_through.end()
        self._save_view()
        self.view.leave(context)

    def trouble(self, context: bpy.types.Context) -> str | None:
        """Return why the mode cannot go on, in a sentence; None where it can."""
        if self.ended is not None:
            return self.ended
        if jobs.busy():
            return "Keypoints: a capture has begun"
        if self.viewport() is None:
            return "Keypoints: the viewport is gone"
        armature = self.refiner.armature_or_none
        if armature is None or armature.name not in context.view_layer.objects:
            return "Keypoints: the hand is gone"
        try:
            if not self.refiner.cameras:
                return "Keypoints: the capture camera is gone"
        except HandfitError as error:
            return f"Keypoints: {error}"
        if context.mode not in ("OBJECT", "POSE"):
            return "Keypoints: refining works in Object and Pose mode"
        return None

    # The view, its zoom and pan

    def switch_view(self, context: bpy.types.Context, viewport: view.Viewport) -> None:
        """Show the capture's other view."""
        if len(self.refiner.cameras) > 1:
            self.view.switch(viewport, context.scene)
            if not viewport.space.use_local_camera:
                bpy.ops.ed.undo_push(message="Switch View")
            self._follow_view(context)

    def _look(self) -> None:
        """Take up the view, 0 or 1, that the viewport looks through."""
        self.looking = self.view.looking
        see_through.end()
        camera, hand = bpy.data.objects[self.view.camera], self.refiner.armature
        units = 1.0 / bpy.context.scene.unit_settings.scale_length
        place = captured_place(self.refiner.take, self.looking, units)
        see_through.begin(camera, hand, place, lambda: 1.0 if self.solid else preferences.get().hand_opacity)

    def _follow_view(self, context: bpy.types.Context, *, own_undo: bool = False) -> None:
        """Go on in the view that the viewport shows now."""
        viewport = self.viewport()
        if viewport is None or not self.view.follow(viewport):
            return
        if not own_undo and not viewport.space.use_local_camera:
            self.done, self.undone = self.done + 1, 0  # switching the scene's camera is an undo step
        self.cancel_drag(context)
        self._look()
        self.hovered, self._places = None, self.picture_places()
        self._restore_view(viewport)
        screen.redraw("VIEW_3D")

    def show_hand(self, viewport: view.Viewport) -> None:
        """Frame the hand with half its size on each side; the whole picture on a frame without it."""
        self.show_picture(viewport)
        places = self.region_places(viewport)
        if not np.isnan(places).all():
            low, high, free = np.nanmin(places, axis=0), np.nanmax(places, axis=0), viewport.free()
            factor = ((free[1] - free[0]) / np.maximum(_FRAME_SIZES * (high - low), 1.0)).min()
            viewport.enlarge(float(factor), (low + high) / 2.0, free.mean(axis=0))

    def show_picture(self, viewport: view.Viewport) -> None:
        """Frame the whole picture."""
        self.view.face(viewport)
        viewport.show_picture(self.refiner.cameras[self.looking], bpy.context.scene)

    def _restore_view(self, viewport: view.Viewport) -> None:
        """Restore the saved view of the hand; without one, or where no point would be seen, frame the
        hand."""
        saved = saved_views.get((self.refiner.armature.session_uid, self.looking))
        if saved is not None:
            viewport.set_zoom(*saved[:2])
        if saved is None or not self._keep_visible(viewport, saved[2]):
            self.show_hand(viewport)

    def _save_view(self) -> None:
        viewport, armature = self.viewport(), self.refiner.armature_or_none
        if viewport is not None and armature is not None and self.view.shows(viewport):
            zoom, offset = viewport.view.view_camera_zoom, tuple(viewport.view.view_camera_offset)
            saved_views[armature.session_uid, self.looking] = zoom, offset, self._places

    def _follow_hand(self, context: bpy.types.Context) -> None:
        """Move the view with the hand where another frame is shown now."""
        if context.scene.frame_current_final == self._frame:
            return
        self._frame, before, now = context.scene.frame_current_final, self._places, self.picture_places()
        if np.isnan(now).all():
            return
        self._places, viewport = now, self.viewport()
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
        (low, high), places = viewport.free(), mapped(matrix, before)
        seen = ((places >= low) & (places <= high)).all(axis=1)
        places = mapped(matrix, self._places)[seen]
        places = places[np.isfinite(places).all(axis=1)]
        if ((places < low) | (places > high)).any():
            middle = (places.min(axis=0) + places.max(axis=0)) / 2.0
            viewport.enlarge(1.0, middle, (low + high) / 2.0)
        return len(places) > 0

    def toggle_solid(self) -> None:
        """Make the hand solid, or see-through again."""
        self.solid = not self.solid
        see_through.follow()
        screen.redraw("VIEW_3D")

    # Places of the handles

    def row(self) -> int | None:
        """Return the row, an index, of the take's frame that the scene shows; None where it shows none."""
        scene = bpy.context.scene
        return None if scene is None else self.refiner.row_at(scene.frame_current_final)

    def shown_row(self, of_view: int) -> int | None:
        """Return the row, among a view's own frames, of the picture that the view shows; None where it has
        none."""
        return self.refiner.row_of_view(bpy.context.scene.frame_current_final) if of_view else self.row()

    def pins(self, of_view: int = 0) -> Pins:
        row = self.row()
        if row is None or of_view:
            return {}
        return self.drag.pins if self.drag is not None else self.refiner.pins(row)

    def _detected(self, row: int, of_view: int) -> np.ndarray | None:
        """Return (21, 2) pixels: the points that were detected in the picture that a view shows; None where
        none were."""
        track, seen, shown = self.refiner.track, None, self.shown_row(of_view)
        if not of_view:
            return np.array(track.keypoints_2d[row], dtype=np.float64) if track.detected[row] else None
        seen = track.seen_by[of_view - 1] if track.seen_by else None
        there = seen is not None and shown is not None and (seen.detected & seen.used)[shown]
        return np.array(seen.keypoints_2d[shown], dtype=np.float64) if seen is not None and there else None

    def picture_places(self, of_view: int | None = None) -> np.ndarray:
        """Return where the points lie, (21, 2) pixels of a view's picture (None: of the one that is looked
        at).

        They are pins, else the fitted hand's points where the frame was re-fitted, else the detected ones,
        else those of the animated hand."""
        row, of_view = self.row(), self.looking if of_view is None else of_view
        shown = self.shown_row(of_view)
        if row is None or shown is None:
            return np.full((NUM_KEYPOINTS, 2), np.nan)
        places = None
        if self.drag is None and not self.refiner.is_corrected(row):
            places = self._detected(row, of_view)
        if places is None:
            places = self.refiner.shown_landmarks(of_view)
            if of_view:
                places += self.refiner.motion_until(row, shown)
        for keypoint, place in self.pins(of_view).items():
            places[keypoint] = place
        return places

    def shows_detections(self, of_view: int) -> bool:
        """True if corrections in frames beside this one move the hand away from its detected points."""
        row = self.row()
        if row is None or self.drag is not None or not self.refiner.is_beside_correction(row):
            return False
        return self._detected(row, of_view) is not None

    def matrix(self, viewport: view.Viewport) -> np.ndarray | None:
        """Return the (3, 3) matrix from pixels of the picture to pixels of the viewport's region; None while
        the viewport does not look through the capture camera."""
        cameras, looking = self.refiner.cameras, self.view.looks(viewport)
        if looking is None or looking >= len(cameras):
            return None
        return view.picture_matrix(viewport, cameras[looking], self.refiner.clip(looking).intrinsics)

    def region_places(self, viewport: view.Viewport) -> np.ndarray:
        """Return where the handles of the points are, (21, 2) pixels of the region; NaN where there is
        none."""
        matrix = self.matrix(viewport)
        if matrix is None:
            return np.full((NUM_KEYPOINTS, 2), np.nan)
        return mapped(matrix, self.picture_places(self.view.looks(viewport)))

    def handle_at(self, viewport: view.Viewport, x: int, y: int) -> int | None:
        """Return the index of the handle nearest to a place in window pixels, within reach; None in the
        second view."""
        if self.looking:
            return None
        places, scale = self.region_places(viewport), screen.ui_scale()
        away = np.linalg.norm(places - [x - viewport.region.x, y - viewport.region.y], axis=-1)
        if np.isnan(away).all():
            return None
        nearest = int(np.nanargmin(away))
        reach = np.clip(drawing.half_gaps(places)[nearest], _MIN_REACH * scale, REACH * scale)
        return nearest if away[nearest] <= reach else None

    # Dragging

    def press(self, context: bpy.types.Context, viewport: view.Viewport, x: int, y: int) -> bool:
        """Begin to drag the handle at this place in window pixels; return whether there is one."""
        keypoint, row = self.handle_at(viewport, x, y), self.row()
        if keypoint is None or row is None or self.drag is not None:
            return False
        if context.screen is not None and context.screen.is_animation_playing:
            bpy.ops.screen.animation_cancel(restore_frame=False)
        mouse = np.array([x - viewport.region.x, y - viewport.region.y])
        self.drag = self._new_drag(keypoint, row)
        self.drag.mouse, self.drag.grip = mouse, self.region_places(viewport)[keypoint] - mouse
        self.message = ""
        return True

    def move(self, viewport: view.Viewport, x: int, y: int) -> None:
        """Drag the handle to this place of the mouse, in window pixels."""
        drag, matrix = self.drag, self.matrix(viewport)
        if drag is None or drag.mouse is None or matrix is None or drag.released:
            return
        mouse = np.array([x - viewport.region.x, y - viewport.region.y])
        drag.moved |= bool(np.abs(mouse - drag.mouse).max() >= _CLICK_PIXELS)
        if drag.moved:
            size = np.array([self.refiner.take.width, self.refiner.take.height])
            # A hand may well reach out of the picture, but not for miles.
            drag.place = np.clip(mapped(np.linalg.inv(matrix), mouse + drag.grip), -size, 2 * size)
            drag.moved_at, drag.drawn = time.perf_counter(), False

    def release(self) -> None:
        """End a drag; its last request is still waited for."""
        if self.drag is not None and self.drag.moved:
            self.drag.released = True
        else:
            self.drag = None

    def unpin(self, keypoint: int) -> bool:
        """Take the pin of a keypoint away: the hand follows the other pins only. Returns False where
        it has none, or another drag goes on."""
        row = self.row()
        if row is None or self.drag is not None or keypoint not in self.pins():
            return False
        self.drag = self._new_drag(keypoint, row)
        self.drag.moved = self.drag.released = True
        self.drag.moved_at = time.perf_counter()
        return True

    def _new_drag(self, keypoint: int, row: int) -> _Drag:
        frame, refiner = bpy.context.scene.frame_current_final, self.refiner
        start, before = refiner.start_poses([row]), refiner.keyed_poses([row])
        return _Drag(keypoint, row, frame, refiner.pins(row), start, before)

    def cancel_drag(self, context: bpy.types.Context) -> None:
        """End a drag without keeping it: the bones get their poses from before it back."""
        drag, self.drag = self.drag, None
        if drag is None:
            return
        if drag.asking is not None:
            drag.asking.close()
        armature = self.refiner.armature_or_none
        if armature is not None and armature.manient.is_hand:
            set_pose(rig_of(armature), drag.poses_before.quats[0], drag.poses_before.locations[0])
            if context.scene.frame_current_final != drag.frame:
                show_frame_again(context)  # that was another frame's pose
        screen.redraw("VIEW_3D")

    def tick(self, context: bpy.types.Context) -> None:
        """Take in the worker's answers, and send the newest place of the mouse where no request has it
        yet."""
        self._follow_view(context)
        self._follow_hand(context)
        try:
            if self._warming and shared_worker.advance(self._warming) is not None:
                self._warming = None
                screen.redraw("VIEW_3D")
            if self.drag is None:
                return
            if context.scene.frame_current_final != self.drag.frame:
                self.cancel_drag(context)
                return
            self._tick_drag(context, self.drag)
        except HandfitError as error:
            self._warming, self.message = None, str(error)
            self.cancel_drag(context)
            show_frame_again(context)

    def _tick_drag(self, context: bpy.types.Context, drag: _Drag) -> None:
        if drag.asked is not None and drag.asking is not None:
            done = shared_worker.advance(drag.asking)
            if done is not None:
                drag.asking, self._solved_in = None, float(done["seconds"])
                self._show(context, drag, drag.asked, self.refiner.poses(done))
        if not drag.waiting and drag.moved and drag.needs_request:
            if drag.place is None and not self._is_constrained(drag):
                self._finish(context, drag)  # nothing pinned any more: nothing to be fitted
            else:
                mode = "each" if drag.released else "draft"
                fields = self.refiner.request([drag.row], [drag.pins], drag.start, mode)()
                drag.asking = shared_worker.ask("refit", "Edit Keypoints", **fields)
                drag.asked = _Request(drag.place, drag.moved_at, drag.pins, drag.released)
                next(drag.asking)
        elif not drag.waiting and drag.released:
            self._finish(context, drag)
        if not drag.drawn and time.perf_counter() - drag.moved_at > _REDRAW_AFTER_SECONDS:
            drag.drawn = True
            self._redraw()

    def follow(self, context: bpy.types.Context) -> None:
        """Do as `tick` does, and wait a moment for the worker's answer."""
        waited_before = self.drag is not None and self.drag.waiting
        self.tick(context)
        # A drawing of a crowded scene takes longer than the answer, which would then be late by one.
        patient = not waited_before and self._solved_in <= _ANSWER_WAIT_SECONDS
        until = time.perf_counter() + (_ANSWER_WAIT_SECONDS if patient else 0.0)
        while self.drag is not None and self.drag.waiting and time.perf_counter() < until:
            time.sleep(0.001)
            self.tick(context)

    def _redraw(self) -> None:
        """Have Blender draw the picture and what is over it again; not the headers and the sidebar beside
        it."""
        for viewport in view.viewports(bpy.context):
            if self.view.shows(viewport):
                viewport.region.tag_redraw()

    def _show(self, context: bpy.types.Context, drag: _Drag, asked: _Request, poses: BonePoses) -> None:
        if not poses.present[0]:
            self.message = "No hand can be fitted to these points"
            return
        drag.answer = asked.pins, poses
        set_pose(self.refiner.hand.rig, poses.quats[0], poses.locations[0])
        context.view_layer.update()
        latencies.append(time.perf_counter() - asked.moved_at)
        drag.drawn = asked.place is drag.place
        self._redraw()

    def _is_constrained(self, drag: _Drag) -> bool:
        """True if the frame's hand has pins, or points that touch."""
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
            self.refiner.correct(drag.row, *drag.answer, context.scene.manient.spread)
        show_frame_again(context)
        self.done, self.undone = self.done + 1, 0
        bpy.ops.ed.undo_push(message="Move Keypoint" if drag.place is not None else "Remove Pin")
        screen.redraw("VIEW_3D")

    def step(self, scene: bpy.types.Scene, direction: int) -> None:
        """Go to the next frame (1) or the one before (-1); the source's where the scene has others."""
        frames = self.refiner.scene_frames()
        ahead = (frames - scene.frame_current_final) * direction
        if np.all(np.abs(frames - np.round(frames)) < 1e-3) or not np.any(ahead > 1e-3):
            scene.frame_set(scene.frame_current + direction)
            return
        frame = float(frames[ahead > 1e-3][np.argmin(ahead[ahead > 1e-3])])
        scene.frame_set(int(np.floor(frame)), subframe=frame - np.floor(frame))

    # Undo and redo of single drags

    def undo(self, context: bpy.types.Context, *, redo: bool) -> None:
        """Take the last drag of this mode back, or do it again."""
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
        self._follow_view(context, own_undo=True)
        show_frame_again(bpy.context)

    # Drawing

    def draw(self, viewport: view.Viewport) -> None:
        """Draw the points, and the line about them."""
        if self.trouble(bpy.context) is None:
            self._draw(viewport, self.looking, self.hovered, *self.status_line(viewport))

    def draw_beside(self, viewport: view.Viewport) -> None:
        """Draw the points in another viewport that looks through one of the capture's cameras."""
        looking = self.view.looks(viewport)
        if looking is not None and self.trouble(bpy.context) is None:
            self._draw(viewport, looking, None, "", False)

    def _draw(
        self, viewport: view.Viewport, looking: int, hovered: int | None, text: str, warning: bool
    ) -> None:
        places, pinned = self.region_places(viewport), frozenset(self.pins(looking))
        dragged = self.drag.keypoint if self.drag is not None else None
        corner, hollow = view.free_corner(viewport), self.shows_detections(looking)
        drawing.draw(drawing.Picture(places, pinned, hovered, dragged, text, warning, corner, hollow))

    def status_line(self, viewport: view.Viewport) -> tuple[str, bool]:
        """Return the line over the picture about this frame, and whether it is a warning."""
        row = self.row()
        if self.message:
            return capitalised(self.message), True
        if not self.view.shows(viewport):
            return "Numpad 0: look through the capture camera again", True
        if row is None:
            return "This frame was not captured: go to another one", True
        if self.shown_row(self.looking) is None:
            return "This view has no picture of this frame: go to another one, or to the other view", True
        if self.looking:
            return "V: points are dragged in the other view", False
        if self._warming:
            return "Starting the solver ...", False
        track, placed = self.refiner.track, len(self.pins())
        if track.added:
            enough = ": three to six are enough, fingertips first" if placed < _SENSIBLE_POINTS else ""
            return f"{counted(placed, 'point')} of the {track.side} hand placed{enough}", False
        if self.refiner.is_corrected(row):
            return f"{placed} pinned in this frame", False
        if self._detected(row, 0) is None:
            return "No hand was found in this frame: drag points to where they belong", True
        if track.doubtful is not None and track.doubtful[row]:
            return "Doubtful frame", True
        if self.shows_detections(0):
            return "Hollow points: what was detected, from which a correction nearby moves the hand", False
        return "", False
