"""Fitting many frames again; Re-fit Range: over time, with their pins, touches and locks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import bpy
import numpy as np

from handfit_core.errors import HandfitError, OptionError
from handfit_core.slices import slice_clock

from .. import details, screen, shared_worker
from ..refiner import Refiner, smoothing_of, why_not
from ..scene import spans
from ..scene.build import ChangeWatch
from ..scene.corrections import corrections_of
from ..scene.own_keys import keyed_by_hand
from ..scene.store import active_hand, scene_frames
from ..scene.timing import span_of
from ..section import sentence
from ..wording import counted
from . import edit_keypoints
from .mixins import PollMixin, TimerMixin, errors_reported

_TICK = 0.02
_SLICE = 0.02
"""seconds that one tick may write keys; a bone is written at once, whatever it takes"""
_WIDTH = 360
"""pixels of the dialog, at a user interface scale of 1"""
_LONGEST_SUMMARY = (
    "Fits 1000 frames again. Replaces 1000 keys set by hand, on 100 frames and 10 applied poses. The points "
    "of 100 corrected frames stay"
)
"""The dialog reserves room for this summary, so that its buttons stay where they are"""
_MARGIN = 0.5
"""seconds before and after the range that are fitted too, so that motion leads smoothly into it, but not
written"""


class FitTask(Protocol):
    """A range of frames on its way through the worker."""

    count: int
    """frames"""

    @property
    def fields(self) -> Callable[[], dict[str, Any]]:
        """Makes the request's fields."""
        ...

    def received(self, done: dict[str, Any]) -> None:
        """The worker's answer."""
        ...

    def writing(self) -> Iterator[float]:
        """Write the keys; yields how much is done, 0..1."""
        ...


class RangeFitOperator(PollMixin, TimerMixin):
    """The base of operators that ask for a range of frames and have the worker fit them."""

    bl_idname: str
    bl_label: str
    layout: Any
    report: Any
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

    asked: bpy.props.BoolProperty(  # type: ignore
        description="The range was asked for already", options={"HIDDEN", "SKIP_SAVE"}
    )

    progress_text = "Re-fitting"
    """What is said while it works"""

    _dialog = False
    """Whether this instance asks for the range"""
    _summary: tuple[tuple[Any, ...], tuple[str, bool]] | None = None
    """the properties when `summary` was last called, and its result, so that drawing again costs nothing"""
    running = ""
    """The operator by which a range is being fitted"""
    can_stop = False
    """Whether the fit can still be stopped before anything is changed"""

    @classmethod
    def lacks(cls, context):
        if RangeFitOperator.running:
            return "A range is being fitted already"
        if edit_keypoints.running():
            return "Leave Edit Keypoints first"
        return why_not(context, active_hand(context))

    @errors_reported
    def execute(self, context):
        """Fit and wait for it: for scripts, and without a window. After the dialog: fit as `invoke` does."""
        if self._dialog:
            # An operator cannot go on running from its own dialog: another one of its kind does.
            try:
                operator = getattr(bpy.ops.manient, type(self).bl_idname.removeprefix("manient."))
                wanted = {"scope": "CUSTOM", "first": self.first, "last": self.last, "asked": True}
                operator("INVOKE_DEFAULT", **wanted, **self.other_properties())
            except RuntimeError as error:  # its own report
                self.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
            return {"CANCELLED"}
        work = self.make_task(context)
        worker = shared_worker.worker()
        work.received(worker.wait(worker.submit("refit", **work.fields())))
        for _ in work.writing():
            pass
        return self._finished(context, work)

    @errors_reported
    def invoke(self, context, _event):
        """Ask for the range, then fit while the window stays free."""
        if not self.asked:
            self.suggest(context)
            self.scope, self._dialog = "CUSTOM", True
            return context.window_manager.invoke_props_dialog(
                self, width=_WIDTH, title=self.bl_label, confirm_text=self.bl_label
            )
        self._work = self.make_task(context)
        self._request = 0
        self._writing: Iterator[float] | None = None
        self._watch = ChangeWatch()
        self._began = time.monotonic()
        RangeFitOperator.running, RangeFitOperator.can_stop = type(self).bl_idname, True
        return self._start_timer(context, _TICK)

    @staticmethod
    def stop() -> None:
        """Stop what is being fitted, as long as nothing is written."""
        RangeFitOperator.can_stop = False

    def make_task(self, context) -> FitTask:
        """What is to be done. Raises HandfitError."""
        raise NotImplementedError

    def suggest(self, context):
        """Set the range that is likely meant."""
        self.first, self.last = suggested_range(context)

    def other_properties(self) -> dict[str, Any]:
        """The values of the properties beside the range, for running the operator from its dialog."""
        return {}

    def report_text(self, work: Any) -> tuple[str, str]:
        """The kind and the text of the report at the end."""
        return "INFO", f"{counted(work.fitted, 'frame')} fitted again"

    def check(self, _context):
        """Say anew what would be done whenever something changes."""
        return True

    def draw(self, context):
        """The range, and what would be done there."""
        self.draw_properties()
        row = self.layout.row(align=True)
        row.prop(self, "first")
        row.prop(self, "last")
        asked = (self.first, self.last, *self.other_properties().values())
        if self._summary is None or self._summary[0] != asked:
            self._summary = asked, self.summary(context)
        summary, alert = self._summary[1]
        icon = "ERROR" if alert else "INFO"
        sentence(
            self.layout, context, summary, icon, alert=alert, width=_WIDTH, reserve_for=[_LONGEST_SUMMARY]
        )

    def draw_properties(self):
        """Draw the properties beside the range."""

    def summary(self, context) -> tuple[str, bool]:
        """A sentence about what would be done, and whether it is a warning."""
        raise NotImplementedError

    def modal(self, context, event):
        """Look for the answer; Esc stops, as long as nothing is written."""
        try:
            if self._watch.changed:
                raise OptionError("re-fitting was stopped by an undo: nothing more was changed")
            if event.type == "ESC" and event.value == "PRESS":
                RangeFitOperator.stop()
            if not RangeFitOperator.can_stop and self._writing is None:
                self.report({"INFO"}, "Re-fitting was stopped; nothing was changed")
                self._end(context)
                return {"CANCELLED"}
            if event.type != "TIMER":
                return {"PASS_THROUGH"}
            if self._step(context):
                self._end(context)
                return self._finished(context, self._work)
        except HandfitError as error:
            details.write_details(self.bl_label, str(error), getattr(error, "details", "") or "")
            self.report({"ERROR"}, str(error))
            self._end(context)
            return {"CANCELLED"}
        except Exception:
            # An operator that Blender ends after an error cannot clean up later.
            self._end(context)
            raise
        return {"PASS_THROUGH"}

    def cancel(self, context):
        """Blender ends the operator, as on loading a file; a dialog that is left has begun nothing."""
        if not self._dialog:
            self._end(context)

    def _step(self, context) -> bool:
        """Go on; whether all is done."""
        if self._writing is not None:
            is_over = slice_clock(_SLICE)
            for part in self._writing:
                self._show_status(context, f"Writing keys  {part:.0%}")
                if is_over():
                    return False
            return True
        if not self._request:
            self._request = shared_worker.worker().submit("refit", **self._work.fields())
        done = shared_worker.answer(self._request)
        if done is not None:
            self._request = 0
            self._work.received(done)
            self._writing, RangeFitOperator.can_stop = self._work.writing(), False
            screen.redraw_sidebars()
            return False
        spent = time.monotonic() - self._began
        self._show_status(
            context, f"{self.progress_text}: {self._work.count} frames  {spent:.0f} s   Esc: Stop"
        )
        return False

    def _finished(self, context, work: FitTask):
        scene = context.scene
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
        kind, text = self.report_text(work)
        self.report({kind}, text)
        return {"FINISHED"}

    def _end(self, context) -> None:
        RangeFitOperator.running, RangeFitOperator.can_stop = "", False
        self._watch.stop()
        if self._request:
            shared_worker.worker().cancel(self._request)
            shared_worker.abandon(self._request)
            self._request = 0
        self._stop_timer(context)
        screen.redraw("VIEW_3D")

    def rows(self, context, refiner: Refiner) -> np.ndarray:
        """The take's rows in the range."""
        frames = refiner.scene_frames()
        first, last = frames[0], frames[-1]
        if self.scope == "CUSTOM":
            first, last = self.first, self.last
        elif context.scene.use_preview_range:
            first, last = span_of(context.scene)
        rows = rows_within(frames, first, last)
        if len(rows) == 0:
            raise OptionError(
                f"none of the frames {first:g} to {last:g} was captured: the capture has {frames[0]:g} to "
                f"{frames[-1]:g}"
            )
        return rows


class MANIENT_OT_refit_range(RangeFitOperator, bpy.types.Operator):
    bl_idname = "manient.refit_range"
    bl_label = "Re-fit Range"
    bl_description = (
        "Fit a range of frames again, smoothly over time, with pinned points, touches and locked joints. "
        "Asks for the range first, and says what keys of your own it would replace"
    )

    def make_task(self, context):
        return RefitTask(context, self.rows)

    def summary(self, context):
        return replaced(context, self.first, self.last)


def suggested_range(context: bpy.types.Context) -> tuple[int, int]:
    """First and last scene frame that are likely meant on the active hand. Raises HandfitError."""
    return spans.suggested_range(context.scene, active_hand(context))


def replaced(context: bpy.types.Context, first: int, last: int) -> tuple[str, bool]:
    """What fitting these scene frames again would replace, in words, and whether it is the artist's work."""
    hand = active_hand(context)
    assert hand is not None
    rows = rows_within(scene_frames(hand.collection, hand.take), first, last)
    if len(rows) == 0:
        return "None of these frames was captured", False
    try:
        field = corrections_of(hand.armature)
        own = keyed_by_hand(hand, rows)
    except HandfitError as error:
        return str(error), True
    numbers = np.asarray(hand.take.frame_numbers)[rows]
    corrected = [field.corrections[g] for g in field.corrected if numbers[0] <= g <= numbers[-1]]
    pinned = np.array([bool(field.pins(g) or field.touching(g)) for g in numbers.tolist()])
    # Frames without a hand get no new keys, locked joints keep theirs.
    own &= (hand.track.present[rows] | pinned)[:, None]
    own[:, :-1] &= ~np.array(hand.armature.manient.locked, dtype=bool)
    keys, frames = int(own.sum()), int(own.any(axis=1).sum())
    poses, points = sum(c.posed for c in corrected), sum(bool(c.pins or c.touches) for c in corrected)
    lost = [f"{counted(keys, 'key')} set by hand, on {counted(frames, 'frame')}"] if keys else []
    lost += [counted(poses, "applied pose")] if poses else []
    summary = f"Fits {counted(len(rows), 'frame')} again. "
    summary += f"Replaces {' and '.join(lost)}" if lost else "Replaces no key set by hand"
    summary += f". The points of {counted(points, 'corrected frame')} stay" if points else ""
    return summary, bool(lost)


def rows_within(frames: np.ndarray, first: float, last: float) -> np.ndarray:
    """The rows of a take whose scene frames (T,) lie from first to last."""
    return np.flatnonzero((frames >= first - 0.5) & (frames <= last + 0.5))


class RefitTask:
    """The frames of a range, and some around, fitted over time with their pins, touches and locks."""

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
        self._fit_rows = np.flatnonzero(near)
        self._is_written = np.isin(self._fit_rows, rows)
        self.fields = self._request(smoothing_of(context.scene, hand.armature))

    def _request(self, smoothing: float) -> Callable[[], dict[str, Any]]:
        field, rows = corrections_of(self.refiner.armature), self._fit_rows.tolist()
        pins = [field.pins(self.refiner.source_frame(row)) for row in rows]
        poses = self.refiner.keyed_poses(rows)
        return self.refiner.request(rows, pins, poses, mode="range", smoothing=smoothing)

    def received(self, done: dict[str, Any]) -> None:
        """The worker's answer."""
        poses = self.refiner.poses(done, len(self._fit_rows))
        # What was fitted only to lead into the range is left alone.
        poses.quats[~self._is_written] = np.nan
        poses.locations[~self._is_written] = np.nan
        self.fitted = int(poses.present.sum())
        if self.fitted == 0:
            raise OptionError("no hand can be fitted in this range: nothing was detected or pinned there")
        self._poses = poses

    def writing(self) -> Iterator[float]:
        """Write the keys; yields how much is done."""
        return self.refiner.replacing(self._fit_rows.tolist(), self._poses)
