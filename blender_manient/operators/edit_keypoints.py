"""Edit Keypoints: drag the 21 points over the picture, and the hand follows."""

from __future__ import annotations

import bpy

from handfit_core.errors import OptionError

from ..modes import keypoints as mode
from ..modes import view
from ..refiner import Refiner, why_not
from ..scene.store import active_hand
from .mixins import PollMixin, TimerMixin, errors_reported

_TICK = 0.008
"""seconds between two looks at the worker"""
_KEYS = (
    "Drag: Move Point    X or Ctrl Click: Remove Pin    H: Solid Hand    Ctrl Z: Undo    "
    "Left/Right: Frame    Wheel: Zoom    Home: Hand    Shift Home: Picture    Enter, Esc: Done"
)
_ENDS = {"RET", "NUMPAD_ENTER", "TAB"}

_mode: mode.KeypointMode | None = None


def running() -> bool:
    """Whether keypoints are being edited."""
    return _mode is not None


class MANIENT_OT_edit_keypoints(PollMixin, TimerMixin, bpy.types.Operator):
    bl_idname = "manient.edit_keypoints"
    bl_label = "Edit Keypoints"
    bl_description = (
        "Show the 21 points of the hand over the picture. Dragging one fits the hand again so that it "
        "lies there, and the frames around follow as far as Spread says"
    )
    bl_options = {"REGISTER"}  # noqa: RUF012

    @classmethod
    def lacks(cls, context):
        return "Keypoints are being edited already" if running() else why_not(context, active_hand(context))

    @errors_reported
    def invoke(self, context, _event):
        """Begin the mode in the viewport under the mouse, or the largest one."""
        global _mode
        hand, viewport = active_hand(context), view.first_viewport(context)
        if viewport is None:
            raise OptionError("Keypoints are edited in a 3D viewport: open one in this window")
        if hand is None or hand.camera is None:
            raise OptionError("The hand's capture camera is gone: undo its removal, or import the take")
        _mode = mode.KeypointMode(context, Refiner(hand.armature), viewport)
        # So that undoing the first drag leads back to here.
        bpy.ops.ed.undo_push(message="Edit Keypoints")
        self._show_status(context, _KEYS)
        return self._start_timer(context, _TICK)

    def execute(self, _context):
        """Without a window there is nothing to drag."""
        self.report({"ERROR"}, "Keypoints are edited in a window; scripts use manient.move_keypoint")
        return {"CANCELLED"}

    def modal(self, context, event):
        if _mode is None:
            return self._end(context)
        trouble = _mode.trouble(context)
        if trouble is not None:
            if trouble:
                self.report({"INFO"}, trouble)
            return self._end(context)
        _mode.tick(context)
        if event.type == "TIMER":
            return {"PASS_THROUGH"}
        viewport = view.viewport_at(context, _mode.view.address)
        if viewport is None:
            return self._end(context)
        if _mode.drag is not None and not _mode.drag.released:
            return self._while_dragging(context, event, viewport)
        return self._between_drags(context, event, viewport)

    def cancel(self, context):
        self._end(context)

    def _while_dragging(self, context, event, viewport):
        assert _mode is not None
        if event.type == "MOUSEMOVE":
            # Moves in between have been overtaken already.
            _mode.move(viewport, event.mouse_x, event.mouse_y)
            _mode.follow(context)
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            _mode.move(viewport, event.mouse_x, event.mouse_y)
            _mode.release()
            _mode.tick(context)
        elif event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS":
            _mode.cancel_drag(context)
        return {"RUNNING_MODAL"}

    def _between_drags(self, context, event, viewport):
        assert _mode is not None
        inside = viewport.contains(event.mouse_x, event.mouse_y)
        if event.type in ("MOUSEMOVE", "INBETWEEN_MOUSEMOVE"):
            hovered = _mode.handle_at(viewport, event.mouse_x, event.mouse_y) if inside else None
            if hovered != _mode.hovered:
                _mode.hovered = hovered
                viewport.area.tag_redraw()
            return {"PASS_THROUGH"}
        factor = view.zoom_of(event)
        if factor is not None and inside and _mode.view.shows(viewport):
            viewport.enlarge(factor, viewport.mouse(event))
            return {"RUNNING_MODAL"}
        if event.value != "PRESS":
            return {"PASS_THROUGH"}
        if event.type == "LEFTMOUSE" and inside:
            keypoint = _mode.handle_at(viewport, event.mouse_x, event.mouse_y)
            if keypoint is None:
                return {"PASS_THROUGH"}
            if event.ctrl:
                _mode.unpin(keypoint)
            else:
                _mode.press(context, viewport, event.mouse_x, event.mouse_y)
            viewport.area.tag_redraw()
            return {"RUNNING_MODAL"}
        if event.type == "Z" and (event.ctrl or event.oskey):
            _mode.undo(context, redo=event.shift)
            context.area.tag_redraw() if context.area else None
            return {"RUNNING_MODAL"}
        if not inside:
            return {"PASS_THROUGH"}
        if event.type in ("X", "DEL", "BACK_SPACE") and _mode.hovered is not None:
            _mode.unpin(_mode.hovered)
            return {"RUNNING_MODAL"}
        if event.type == "H" and not (event.ctrl or event.shift or event.alt or event.oskey):
            _mode.toggle_solid()
            return {"RUNNING_MODAL"}
        if event.type in ("LEFT_ARROW", "RIGHT_ARROW") and not (event.ctrl or event.shift or event.alt):
            _mode.step(context.scene, -1 if event.type == "LEFT_ARROW" else 1)
            return {"RUNNING_MODAL"}
        if event.type == "HOME" and not (event.ctrl or event.alt or event.oskey):
            (_mode.show_picture if event.shift else _mode.show_hand)(viewport)
            return {"RUNNING_MODAL"}
        if event.type in _ENDS or event.type == "ESC":
            return self._end(context)
        return {"PASS_THROUGH"}

    def _end(self, context):
        global _mode
        ended, _mode = _mode, None
        if ended is not None:
            ended.end(context)
        self._stop_timer(context)
        return {"FINISHED"}


@bpy.app.handlers.persistent
def _on_undo(*_args) -> None:
    if _mode is not None and not _mode.own_undo:
        _mode.ended = "Keypoints: ended by an undo"


@bpy.app.handlers.persistent
def unregister(*_args) -> None:
    """End the mode; its operator finds out with its next event."""
    if _mode is not None:
        _mode.end(bpy.context)
        _mode.ended = ""


@bpy.app.handlers.persistent
def _on_load(*_args) -> None:
    unregister()
    mode.forget_views()


HANDLERS = {"undo_post": _on_undo, "redo_post": _on_undo, "load_pre": _on_load}
