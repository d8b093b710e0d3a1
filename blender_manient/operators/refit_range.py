"""Re-fit Range: fit many frames again, over time, with their pins and locks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import bpy
import numpy as np

from handfit_core.errors import HandfitError, OptionError

from .. import details, screen
from ..keypoint_mode.abandoned import abandon
from ..refiner import Refiner, why_not
from ..scene.corrections import corrections_of
from ..scene.frame_span import span_of
from ..selection import active_hand
from ..worker import shared
from ..worker.client import as_error
from . import edit_keypoints

_TICK = 0.02
_SLICE = 0.02
"""seconds that one tick may write keys; a bone is written at once, whatever it takes"""
_MARGIN = 0.5
"""seconds before and after the range that are fitted too, so that motion leads smoothly into it, but not
written"""


class MANIENT_OT_refit_range(bpy.types.Operator):
    bl_idname = "manient.refit_range"
    bl_label = "Re-fit Range"
    bl_description = (
        "Fit the preview range (else all captured frames) again, smoothly over time, with pinned points and "
        "locked joints. Replaces the keys of these frames"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    scope: bpy.props.EnumProperty(  # type: ignore
        name="Range",
        items=(
            ("PREVIEW", "Preview Range", "The preview range where it is used, else all captured frames"),
            ("CUSTOM", "First to Last", "The frames given here"),
        ),
        default="PREVIEW",
    )
    first: bpy.props.IntProperty(name="First", description="First scene frame", default=1)  # type: ignore
    last: bpy.props.IntProperty(name="Last", description="Last scene frame", default=250)  # type: ignore

    _running = False
    """Whether a range is being fitted already"""
    _timer = None

    @classmethod
    def poll(cls, context):
        """Whether there is a hand that can be fitted again."""
        why = why_not(context, active_hand(context))
        if cls._running:
            why = "A range is being fitted already"
        elif edit_keypoints.running():
            why = "Leave Edit Keypoints first"
        if why is not None:
            cls.poll_message_set(why)
        return why is None

    def execute(self, context):
        """Fit and wait for it: for scripts, and without a window."""
        try:
            work = _Work(context, self._rows)
            worker = shared.worker()
            work.received(worker.wait(worker.request("refit", **work.fields())))
            for _ in work.writing():
                pass
        except HandfitError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return self._finished(context, work)

    def invoke(self, context, _event):
        """Fit while the window stays free."""
        try:
            self._work = _Work(context, self._rows)
        except HandfitError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._request = 0
        self._writing: Iterator[float] | None = None
        self._undone = False
        self._began = time.monotonic()
        type(self)._running = True
        bpy.app.handlers.undo_post.append(self._on_undo)
        bpy.app.handlers.redo_post.append(self._on_undo)
        self._timer = context.window_manager.event_timer_add(_TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Look for the answer; Esc stops, as long as nothing is written."""
        try:
            if self._undone:
                raise OptionError("re-fitting was stopped by an undo: nothing more was changed")
            if event.type == "ESC" and event.value == "PRESS" and self._writing is None:
                self.report({"INFO"}, "Re-fitting was stopped; nothing was changed")
                self._end(context)
                return {"CANCELLED"}
            if event.type != "TIMER":
                return {"PASS_THROUGH"}
            if self._step(context):
                self._end(context)
                return self._finished(context, self._work)
        except HandfitError as error:
            details.write_details("Re-fit Range", str(error), getattr(error, "details", "") or "")
            self.report({"ERROR"}, str(error))
            self._end(context)
            return {"CANCELLED"}
        except Exception:
            # An operator that Blender ends after an error cannot clean up later.
            self._end(context)
            raise
        return {"PASS_THROUGH"}

    def cancel(self, context):
        """Blender ends the operator, as on loading a file."""
        self._end(context)

    def _step(self, context) -> bool:
        """Go on; whether all is done."""
        if self._writing is not None:
            until = time.perf_counter() + _SLICE
            for part in self._writing:
                self._tell(context, f"Writing keys  {part:.0%}")
                if time.perf_counter() > until:
                    return False
            return True
        if not self._request:
            self._request = shared.worker().request("refit", **self._work.fields())
        for event in shared.worker().poll(self._request):
            if event["event"] == "error":
                self._request = 0
                raise as_error(event)
            if event["event"] == "done":
                self._request = 0
                self._work.received(event)
                self._writing = self._work.writing()
                return False
        spent = time.monotonic() - self._began
        self._tell(context, f"Re-fitting {self._work.count} frames  {spent:.0f} s   Esc: Stop")
        return False

    def _finished(self, context, work: _Work):
        scene = context.scene
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
        frames = "1 frame" if work.fitted == 1 else f"{work.fitted} frames"
        self.report({"INFO"}, f"{frames} fitted again")
        return {"FINISHED"}

    def _tell(self, context, text: str) -> None:
        if context.workspace is not None:
            context.workspace.status_text_set(text)

    def _on_undo(self, *_args) -> None:
        self._undone = True

    def _end(self, context) -> None:
        type(self)._running = False
        for handlers in (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post):
            if self._on_undo in handlers:
                handlers.remove(self._on_undo)
        if self._request:
            shared.worker().cancel(self._request)
            abandon(self._request)
            self._request = 0
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        screen.redraw_viewports(context)

    def _rows(self, context, refiner: Refiner) -> np.ndarray:
        """The take's rows in the range."""
        frames = refiner.scene_frames()
        first, last = frames[0], frames[-1]
        if self.scope == "CUSTOM":
            first, last = self.first, self.last
        elif context.scene.use_preview_range:
            first, last = span_of(context.scene)
        rows = np.flatnonzero((frames >= first - 0.5) & (frames <= last + 0.5))
        if len(rows) == 0:
            raise OptionError(
                f"none of the frames {first:g} to {last:g} was captured: the capture has {frames[0]:g} to "
                f"{frames[-1]:g}"
            )
        return rows


class _Work:
    """What is asked of the worker, and what becomes of it."""

    def __init__(self, context, rows_of: Callable[[Any, Refiner], np.ndarray]) -> None:
        hand = active_hand(context)
        assert hand is not None
        self.refiner = Refiner(hand.armature)
        rows = rows_of(context, self.refiner)
        self.count = len(rows)
        self.fitted = 0
        numbers = np.asarray(self.refiner.take.frame_numbers)
        margin = _MARGIN * self.refiner.take.fps
        near = (numbers >= numbers[rows[0]] - margin) & (numbers <= numbers[rows[-1]] + margin)
        self._asked = np.flatnonzero(near)
        self._wanted = np.isin(self._asked, rows)
        field = corrections_of(hand.armature)
        self.fields = self.refiner.request(
            self._asked.tolist(),
            [field.pins(int(numbers[row])) for row in self._asked],
            self.refiner.keyed_poses(self._asked.tolist()),
            mode="range",
            smoothing=context.scene.manient.smoothing,
        )

    def received(self, done: dict[str, Any]) -> None:
        """The worker's answer."""
        poses = self.refiner.poses(done, len(self._asked))
        # What was fitted only to lead into the range is left alone.
        poses.quats[~self._wanted] = np.nan
        poses.locations[~self._wanted] = np.nan
        self.fitted = int(poses.present.sum())
        if self.fitted == 0:
            raise OptionError("no hand can be fitted in this range: nothing was detected or pinned there")
        self._poses = poses

    def writing(self) -> Iterator[float]:
        """Write the keys; yields how much is done."""
        return self.refiner.replacing(self._asked.tolist(), self._poses)


def register() -> None:
    """Add the operator."""
    bpy.utils.register_class(MANIENT_OT_refit_range)


def unregister() -> None:
    """Take it away again."""
    bpy.utils.unregister_class(MANIENT_OT_refit_range)
