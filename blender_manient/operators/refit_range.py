"""Fitting many frames again; Re-fit Range: over time, with their pins, touches and locks."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import HandfitError, OptionError

from ..common import screen
from ..common.section import sentence
from ..common.wording import capitalised, counted
from ..scene import spans
from ..scene.corrections import corrections_of
from ..scene.own_keys import keyed_by_hand
from ..scene.store import active_hand, scene_frames
from ..scene.timing import span_of
from ..session import shared_worker
from ..session.refiner import BonePoses, Refiner, smoothing_of, why_not
from .base import ModalState, StepsOperator, polled_hand, show_frame_again

_WIDTH = 360
"""pixels of the dialog, at a user interface scale of 1"""
_MARGIN = 0.5
"""Seconds before and after the range that are fitted too, so that motion leads smoothly into it, but not
written"""


class RangeFit:
    """The frames of a range on their way through the worker."""

    requests: list[tuple[int, Callable[[], dict[str, Any]]]]
    """For each request to the worker, the number of its frames and a function that makes its fields"""
    poses: BonePoses
    fitted: int
    """The poses that are written, and the number of their frames"""

    def __init__(self, operator: RangeFitOperator, context: bpy.types.Context) -> None:
        """Prepare the range's frames and poses for the worker. Raises HandfitError where nothing can be
        fitted."""
        self.refiner = Refiner(polled_hand(context).armature)
        self.rows = operator.rows(context, self.refiner)
        self.count = len(self.rows)
        self.spread = context.scene.manient.spread

    def received(self, poses: BonePoses) -> None:
        """Take over what the worker found in the rows. Raises OptionError where that is nothing."""
        self.poses, self.fitted = poses, int(poses.present.sum())
        if self.fitted == 0:
            raise OptionError("no hand can be fitted in this range: nothing was detected or pinned there")

    def writing(self) -> Iterator[float]:
        """Write the keys; yields how much is done, 0..1."""
        raise NotImplementedError


class RangeFitOperator(StepsOperator):
    """The base of operators that ask for a range of frames and have the worker fit them."""

    as_keywords: Callable[[], dict[str, Any]]
    bl_label: str
    title = "Re-fitting"
    undone = "re-fitting was stopped by an undo: nothing more was changed"
    progress_text = "Re-fitting"
    """The status line while the worker fits"""

    scope: bpy.props.EnumProperty(
        name="Range",
        items=(
            ("PREVIEW", "Preview Range", "The preview range where it is used, else all captured frames"),
            ("CUSTOM", "First to Last", "The frames given here"),
        ),
        default="PREVIEW",
    )
    first: bpy.props.IntProperty(name="First", description="First scene frame", default=1)
    last: bpy.props.IntProperty(name="Last", description="Last scene frame", default=250)

    asked: bpy.props.BoolProperty(
        description="The range was asked for already", options={"HIDDEN", "SKIP_SAVE"}
    )

    _dialog = False
    """True if this instance asks for the range"""
    _summary: tuple[str, bool] | None = None
    """The result of `summary` since the last change, so that drawing again costs nothing"""

    @classmethod
    def fitting(cls) -> tuple[str, ModalState] | None:
        """Return the name and the `ModalState` of the operator that is re-fitting a range now; None where
        there is none."""
        names = [each.bl_idname for each in RangeFitOperator.__subclasses__()]
        return next(((name, cls.running[name]) for name in names if name in cls.running), None)

    @classmethod
    def stop(cls) -> None:
        """Stop what is being fitted, as long as nothing is written."""
        if fit := cls.fitting():
            fit[1].stop()

    @classmethod
    def poll_reason(cls, context):
        if cls.fitting():
            return "A range is being fitted already"
        if "manient.edit_keypoints" in cls.running:
            return "Leave Edit Keypoints first"
        return why_not(context, active_hand(context))

    def make_fit(self, context: bpy.types.Context) -> RangeFit:
        """Return the work on the frames that are to be fitted. Raises HandfitError."""
        raise NotImplementedError

    def suggest(self, context: bpy.types.Context) -> None:
        """Set the properties to the range that is likely meant. Raises HandfitError."""
        self.first, self.last = suggested_range(context)

    def summary(self, context: bpy.types.Context) -> tuple[str, bool]:
        """Return a sentence about what would be done, and whether it is a warning. Raises HandfitError where
        nothing would be done."""
        raise NotImplementedError

    def draw_properties(self):
        """Draw the properties beside the range."""

    def check(self, _context):
        """Compute the dialog's summary anew whenever a property changes."""
        self._summary = None
        return True

    def draw(self, context):
        self.draw_properties()
        row = self.layout.row(align=True)
        row.prop(self, "first")
        row.prop(self, "last")
        if self._summary is None:
            try:
                self._summary = self.summary(context)
            except HandfitError as error:
                self._summary = capitalised(str(error)), True
        text, alert = self._summary
        sentence(self.layout, context, text, "ERROR" if alert else "INFO", width=_WIDTH)

    def run(self, context):
        """Fit and wait for it. From the dialog: an operator cannot go on running from its own dialog, so
        another one of its kind does."""
        if not self._dialog:
            return super().run(context)
        try:
            operator = getattr(bpy.ops.manient, type(self).bl_idname.removeprefix("manient."))
            operator("INVOKE_DEFAULT", **self.as_keywords() | {"asked": True})
        except RuntimeError as error:  # its own report
            self.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
        return {"CANCELLED"}

    def begin(self, context):
        """Ask for the range, or fit while the window stays free."""
        if self.asked:
            return super().begin(context)
        self.suggest(context)
        self.scope, self._dialog = "CUSTOM", True
        title = self.bl_label
        return context.window_manager.invoke_props_dialog(self, width=_WIDTH, title=title, confirm_text=title)

    def steps(self, context):
        return self._fitting(self.make_fit(context))

    def _fitting(self, fit: RangeFit) -> Generator[str | shared_worker.Progress, None, RangeFit]:
        text = f"{self.progress_text}: {fit.count} frames"
        parts = []
        for count, fields in fit.requests:
            done = yield from shared_worker.ask("refit", text, **fields())
            parts.append(fit.refiner.poses(done, count))
        fit.received(BonePoses.concatenate(parts))
        if type(self).bl_idname in self.running:
            self.running[type(self).bl_idname].can_stop = False
        screen.redraw_sidebars()
        for part in fit.writing():
            yield f"Writing keys  {part:.0%}"
        return fit

    def ended(self, context):
        super().ended(context)
        screen.redraw("VIEW_3D")

    def finished(self, context, result):
        show_frame_again(context)
        kind, text = self.report_text(result)
        return self._done(text, kind=kind)

    def report_text(self, fit: Any) -> tuple[str, str]:
        """Return the kind and the text of the report at the end."""
        return "INFO", f"{counted(fit.fitted, 'frame')} fitted again"

    def rows(self, context: bpy.types.Context, refiner: Refiner) -> np.ndarray:
        """Return the take's rows in the range, as indices. Raises OptionError where there are none."""
        frames = refiner.scene_frames()
        first, last = frames[0], frames[-1]
        if self.scope == "CUSTOM":
            first, last = self.first, self.last
        elif context.scene.use_preview_range:
            first, last = span_of(context.scene)
        if first > last:
            raise OptionError(f"the range runs backwards, from {first:g} to {last:g}: set First before Last")
        rows = rows_within(frames, first, last)
        if len(rows) == 0:
            raise OptionError(
                f"none of the frames {first:g} to {last:g} was captured: the capture has {frames[0]:g} to "
                f"{frames[-1]:g}"
            )
        return rows


class MANIENT_OT_refit_range(RangeFitOperator, bpy.types.Operator):
    """Fit a range of frames again, smoothly over time, with pinned points, touches and locked joints. Asks
    for the range first, and says what keys of your own it would replace."""

    bl_label = "Re-fit Range"

    def make_fit(self, context):
        return MotionFit(self, context)

    def summary(self, context):
        return replaced(context, self.first, self.last)


def suggested_range(context: bpy.types.Context) -> tuple[int, int]:
    """Return the first and last scene frame that are likely meant on the active hand. Raises HandfitError."""
    return spans.suggested_range(context.scene, active_hand(context))


def replaced(context: bpy.types.Context, first: int, last: int) -> tuple[str, bool]:
    """Return what fitting these scene frames again would replace, in words, and whether it is the artist's
    work."""
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
    held = (field.corrections.get(g) for g in numbers.tolist())
    pinned = np.array([one is not None and one.placed > 0 for one in held])
    # Frames without a hand get no new keys, locked joints keep theirs.
    own &= (hand.track.present[rows] | pinned)[:, None]
    own[:, :-1] &= ~np.array(hand.armature.manient.locked, dtype=bool)
    keys, frames = int(own.sum()), int(own.any(axis=1).sum())
    poses, points = sum(c.posed for c in corrected), sum(c.placed > 0 for c in corrected)
    lost = [f"{counted(keys, 'key')} set by hand, on {counted(frames, 'frame')}"] if keys else []
    lost += [counted(poses, "applied pose")] if poses else []
    summary = f"Fits {counted(len(rows), 'frame')} again. "
    summary += f"Replaces {' and '.join(lost)}" if lost else "Replaces no key set by hand"
    summary += f". The points of {counted(points, 'corrected frame')} stay" if points else ""
    return summary, bool(lost)


def rows_within(frames: np.ndarray, first: float, last: float) -> np.ndarray:
    """Return the rows of a take, as indices, whose scene frames (T,) lie from `first` to `last`, both
    included."""
    return np.flatnonzero((frames >= first - 0.5) & (frames <= last + 0.5))


class MotionFit(RangeFit):
    """The frames of a range, and some around, fitted over time with their pins, touches and locks."""

    def __init__(self, operator: RangeFitOperator, context: bpy.types.Context) -> None:
        super().__init__(operator, context)
        numbers = np.asarray(self.refiner.take.frame_numbers)
        margin = _MARGIN * self.refiner.take.fps
        written, first, last = self.rows, numbers[self.rows[0]], numbers[self.rows[-1]]
        self.rows = np.flatnonzero((numbers >= first - margin) & (numbers <= last + margin))
        self._is_written = np.isin(self.rows, written)
        smoothing = smoothing_of(context.scene, self.refiner.armature)
        self.requests = [(len(self.rows), self.request(smoothing))]

    def request(self, smoothing: float) -> Callable[[], dict[str, Any]]:
        """Return a function that makes the request's fields: the poses to start from, and the strength of
        smoothing."""
        field, rows = corrections_of(self.refiner.armature), self.rows.tolist()
        pins = [field.pins(self.refiner.source_frame(row)) for row in rows]
        poses = self.refiner.keyed_poses(rows)
        return self.refiner.request(rows, pins, poses, mode="range", smoothing=smoothing)

    def received(self, poses):
        # What was fitted only to lead into the range is left alone.
        poses.quats[~self._is_written] = poses.locations[~self._is_written] = np.nan
        super().received(poses)

    def writing(self):
        yield from self.refiner.replacing(self.rows.tolist(), self.poses)
