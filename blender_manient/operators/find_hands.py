"""Find Hands: all hands of the source's picture over it; those that are chosen are captured."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.media.frame_range import FrameRange

from ..session import jobs, source_info
from .base import ManientOperator, ModeOperator
from .capture import new_request, why_no_capture
from .modes import find_hands as mode
from .modes import view

_PASS_THROUGH_KEYS = {"N", "T", *(f"F{n}" for n in range(1, 13))}
"""The keys that pass through the mode and do what they do elsewhere"""


class MANIENT_OT_find_hands(ModeOperator, bpy.types.Operator):
    """Show all hands of the picture over it, to choose those that are captured, to say which are left and
    right, and to draw a box around one that was missed. Of a clip the scene's current frame is shown."""

    bl_label = "Find Hands"
    tick = 0.03

    @classmethod
    def poll_reason(cls, context):
        if cls.current is not None:
            return "Hands are being chosen already"
        return why_no_capture(context, alone=True)

    def begin(self, context):
        """Begin the mode in the viewport under the mouse, or the largest one."""
        viewport = view.first_viewport(context)
        if viewport is None:
            raise OptionError("Hands are chosen in a 3D viewport: open one in this window")
        type(self).current = mode.FindMode(chosen_source(context), viewport, context.scene.manient.source)
        self._panned: np.ndarray | None = None
        self.show_status(context, self.current.keys)

    def run(self, context):
        raise OptionError("Hands are chosen in a window; scripts give regions to a capture")

    def follow(self, context, event):
        session = self.current
        if session is None:
            return self.end(context)
        trouble = session.trouble(context)
        if trouble is not None:
            if trouble:
                self.report({"INFO"}, trouble)
            return self.end(context)
        session.tick(context)
        viewport = view.viewport_at(context, session.address)
        if viewport is None or event.type == "TIMER":
            return {"PASS_THROUGH"}
        mouse = viewport.mouse(event)
        if event.type in ("MOUSEMOVE", "INBETWEEN_MOUSEMOVE"):
            return self._moved(session, viewport, mouse, viewport.contains(event.mouse_x, event.mouse_y))
        if session.picture_view is not None and viewport.contains(event.mouse_x, event.mouse_y):
            if (factor := view.zoom_of(event)) is not None:
                session.picture_view.zoom(
                    factor, session.picture_point(viewport, mouse), session.room(viewport)
                )
                session.hover(viewport, mouse)
                viewport.area.tag_redraw()
                return {"RUNNING_MODAL"}
            if event.type == "TRACKPADPAN":
                by = [event.mouse_x - event.mouse_prev_x, event.mouse_y - event.mouse_prev_y]
                session.picture_view.move(np.array(by, dtype=float), session.room(viewport))
                viewport.area.tag_redraw()
                return {"RUNNING_MODAL"}
        if event.value == "RELEASE":
            return self._released(context, session, viewport, event)
        if event.value == "PRESS" and viewport.contains(event.mouse_x, event.mouse_y):
            done = self._pressed(context, session, viewport, mouse, event)
            viewport.area.tag_redraw()
            return done
        return {"PASS_THROUGH"}

    def _moved(self, session, viewport, mouse, inside):
        if self._panned is not None and session.picture_view is not None:
            session.picture_view.move(mouse - self._panned, session.room(viewport))
            self._panned = mouse
        elif session.dragged is not None:
            session.dragged = (session.dragged[0], mouse)
        elif not inside or not session.hover(viewport, mouse):
            return {"PASS_THROUGH"}
        viewport.area.tag_redraw()
        return {"PASS_THROUGH"}

    def _released(self, context, session, viewport, event):
        if event.type == "MIDDLEMOUSE" and self._panned is not None:
            self._panned = None
            return {"RUNNING_MODAL"}
        if event.type != "LEFTMOUSE" or session.dragged is None:
            return {"PASS_THROUGH"}
        todo = session.release(viewport)
        viewport.area.tag_redraw()
        return self._do(context, session, todo)

    def _pressed(self, context, session, viewport, mouse, event):
        kind = event.type
        if kind == "LEFTMOUSE":
            session.hover(viewport, mouse)
            session.dragged = (mouse, mouse)
        elif kind == "ESC" and session.dragged is not None:
            session.dragged = None
        elif kind == "ESC":
            return self.end(context)
        elif kind in ("RET", "NUMPAD_ENTER"):
            return self._do(context, session, "capture")
        elif kind == "Z" and (event.ctrl or event.oskey):
            session.message = "" if session.choice.undo() else "Nothing to undo here"
        elif event.ctrl or event.oskey or event.alt or kind in _PASS_THROUGH_KEYS:
            return {"PASS_THROUGH"}
        elif kind in ("X", "DEL", "BACK_SPACE") and session.hovered is not None:
            session.choice.remove(session.hovered)
            session.hover(viewport, mouse)
        elif kind == "S" and session.hovered is not None:
            session.choice.flip_side(session.hovered)
        elif kind == "A":
            session.choice.toggle_all()
        elif session.picture_view is not None:
            if kind == "MIDDLEMOUSE":
                self._panned = mouse
            elif kind == "HOME":
                session.picture_view.show_all()
        if kind != "LEFTMOUSE":
            session.hover(viewport, mouse)
        return {"RUNNING_MODAL"}

    def _do(self, context, session, todo):
        """Do what a button or a key asks for; a hand is added to the picture of the chosen ones, if there are
        any."""
        chosen = bool(session.choice.chosen)
        if todo in ("capture", "add") and session.busy:
            session.message = "The worker is still looking: wait a moment"
        elif todo == "capture" and not chosen:
            session.message = "No hand is chosen: click one, or drag a box around one that you see"
        elif todo:
            try:
                if todo != "leave" and chosen:
                    capture_chosen(context, then_add_hand=todo == "add")
            except HandfitError as error:
                session.message = str(error)
                return {"RUNNING_MODAL"}
            ended = self.end(context)
            if jobs.busy():
                bpy.ops.manient.capture("INVOKE_DEFAULT", queued=True)
            elif todo == "add":
                bpy.ops.manient.add_hand("INVOKE_DEFAULT")
            return ended
        return {"RUNNING_MODAL"}


class MANIENT_OT_capture_found(ManientOperator, bpy.types.Operator):
    """Capture the hands that are chosen in the picture, and no others."""

    bl_label = "Capture Chosen Hands"
    bl_options = {"REGISTER"}

    @classmethod
    def poll_reason(cls, context):
        choosing = MANIENT_OT_find_hands.current
        if choosing is not None and choosing.busy:
            return "The worker is still looking: wait a moment"
        return (
            None
            if choosing is not None and choosing.choice.chosen
            else "No hand is chosen: click one in the picture"
        )

    def run(self, context):
        """Queue the capture; the mode finds out with its next event."""
        capture_chosen(context)
        unregister()
        bpy.ops.manient.capture("INVOKE_DEFAULT", queued=True)


def capture_chosen(context: bpy.types.Context, *, then_add_hand: bool = False) -> None:
    """Queue a capture of the hands that are chosen; `then_add_hand` is a field of the request. Raises
    HandfitError."""
    regions = MANIENT_OT_find_hands.current.regions()
    request = new_request(context, only_frame=False, regions=regions)
    jobs.submit(replace(request, then_add_hand=then_add_hand))


def chosen_source(context: bpy.types.Context) -> mode.Source:
    """Return the source of the panel's settings, at the frame that the scene shows. Raises HandfitError."""
    settings, request = context.scene.manient, new_request(context, only_frame=False)
    info = source_info.of(settings)
    assert info.files is not None
    frame = None
    if info.files.kind != "photo":
        frame = _frame(source_info.shown_frame(context, info.files), request.options, info)
    return mode.Source(request.files, frame, request.options)


def _frame(current: int, options: CaptureOptions, info: source_info.SourceInfo) -> int:
    """Return the used frame of the source that is nearest to its frame `current`; the first one where
    `current` lies before or after all of them."""
    wanted = options.frames or FrameRange()
    # Until the worker has counted a video's frames, the scene's is believed to be among them.
    used = wanted.within(info.first, info.last if info.frames else max(info.first, current))
    if info.files is not None and (numbers := info.files.numbers):
        used = [number for number in numbers if number in wanted]
    if not used:
        raise OptionError("the frame range has none of the source's frames: mend it")
    return min(used, key=lambda n: abs(n - current)) if used[0] <= current <= used[-1] else used[0]


unregister = MANIENT_OT_find_hands.leave
HANDLERS = {"load_pre": lambda *_args: unregister()}
