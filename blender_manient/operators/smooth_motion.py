"""Smooth Motion: the strength of smoothing, changed after the capture, by a slider in the panel."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import OptionError

from ..common.wording import capitalised, counted
from ..scene.own_keys import captured_poses, smoothed, writing
from ..scene.store import active_hand
from ..session import properties
from ..session.refiner import Refiner, smoothing_of, why_not_smoothable
from .base import polled_hand
from .refit_range import MotionFit, RangeFitOperator

_QUIET_SECONDS = 0.3
"""Seconds for which the slider rests before the motion is smoothed"""
_RETRY_SECONDS = 0.1
"""Seconds after which is looked again whether another fit is over"""

_wanted: tuple[int, float] | None = None
"""The session_uid of a hand's armature, and the strength to which its slider was moved and that its keys do
not have yet; None for none"""


class MANIENT_OT_smooth_motion(RangeFitOperator, bpy.types.Operator):
    """Fit the motion anew to the keypoints of the capture, with another strength of smoothing. Frames that
    you corrected, posed or keyed stay as they are; keys around lead there over Spread. Works on the preview
    range where it is used, else on all frames."""

    bl_label = "Smooth Motion"
    progress_text = "Smoothing"

    strength: bpy.props.FloatProperty(
        name="Smoothing", soft_max=3.0, options={"SKIP_SAVE"}, **properties.option_property("smoothing")
    )

    @classmethod
    def poll_reason(cls, context):
        hand = active_hand(context)
        why = why_not_smoothable(hand) if hand is not None else None
        return capitalised(why) if why is not None else super().poll_reason(context)

    def make_fit(self, context):
        return _SmoothFit(self, context)

    def suggest(self, context):
        """Set the range to the preview range, or else to all frames."""
        refiner = Refiner(polled_hand(context).armature)
        places = refiner.scene_frames()[self.rows(context, refiner)]
        self.first, self.last = int(np.ceil(places[0])), int(places[-1])
        self.strength = self.wanted_strength(context)

    def wanted_strength(self, context: bpy.types.Context) -> float:
        """Return the strength of smoothing that was asked for, else the one that the keys have."""
        if self.properties.is_property_set("strength"):
            return self.strength
        return smoothing_of(context.scene, polled_hand(context).armature)

    def draw_properties(self):
        self.layout.prop(self, "strength", slider=True)

    def summary(self, context):
        """Return a sentence about how many frames would be smoothed, and whether it is a warning."""
        count = len(self.rows(context, Refiner(polled_hand(context).armature)))
        return f"Smooths {counted(count, 'frame')}; what you corrected or keyed stays", False

    def report_text(self, fit):
        kept = fit.count - fit.fitted
        left = f", {kept} left as they were" if kept else ""
        return "INFO", f"{counted(fit.fitted, 'frame')} smoothed{left}"

    def follow(self, context, event):
        """Wait for the fit, unless the slider was moved on: then its next value is fitted instead."""
        if (
            _wanted is not None
            and _wanted[1] != self.strength
            and self.running[type(self).bl_idname].can_stop
        ):
            self.end(context)
            return {"CANCELLED"}
        return super().follow(context, event)

    def ended(self, context):
        global _wanted
        super().ended(context)
        if _wanted is not None and _wanted[1] == self.strength:
            _wanted = None


class _SmoothFit(MotionFit):
    """The work of fitting the motion of a range anew to the capture's keypoints, with another strength of
    smoothing."""

    def __init__(self, operator: MANIENT_OT_smooth_motion, context: bpy.types.Context) -> None:
        self._strength = operator.wanted_strength(context)
        super().__init__(operator, context)

    def request(self, smoothing):
        # From the captured poses: what comes out does not depend on what was smoothed before.
        rows = self.rows.tolist()
        poses, locked = self.refiner.keyed_poses(rows), np.array(self.refiner.armature.manient.locked)
        quats, locations = captured_poses(self.refiner.hand, self.rows)
        poses.quats[:, ~locked] = quats[:, ~locked]
        if not locked[0]:
            poses.locations[:] = locations
        none: list[dict[int, Any]] = [{} for _ in rows]
        return self.refiner.request(rows, none, poses, mode="range", smoothing=self._strength, touches=none)

    def received(self, poses):
        args = self.refiner.hand, self.rows, self._is_written, poses.quats, poses.locations
        self._smoothed = smoothed(*args, self.spread)
        self.fitted = self._smoothed.written
        if self.fitted == 0:
            raise OptionError(
                "no frame of this range can be smoothed: nothing was detected there, or all of it is "
                "corrected or keyed by hand"
            )

    def writing(self):
        """Write the keys, and note how smooth they are; yields how much is done."""
        yield from writing(lambda: self.refiner.hand, self._smoothed)
        self.refiner.armature.manient.smoothing = self._strength


def _shown(_owner: Any) -> float:
    """Return the slider's value: where it was moved to, else how smooth the active hand's keys are."""
    hand = active_hand(bpy.context)
    if hand is None:
        return 1.0
    if _wanted is not None and _wanted[0] == hand.armature.session_uid:
        return _wanted[1]
    return smoothing_of(bpy.context.scene, hand.armature)


def _moved(_owner: Any, value: float) -> None:
    """Remember where the slider was moved to: once it rests, the motion follows."""
    global _wanted
    hand = active_hand(bpy.context)
    if hand is None:
        return
    _wanted = hand.armature.session_uid, value
    if bpy.app.timers.is_registered(_smooth):
        bpy.app.timers.unregister(_smooth)
    bpy.app.timers.register(_smooth, first_interval=_QUIET_SECONDS)


def _forget(*_: Any) -> None:
    """Forget where the slider was moved to: another file is open."""
    global _wanted
    _wanted = None


HANDLERS = {"load_post": _forget}


def _smooth() -> float | None:
    """Smooth as the slider says, in the first window, once no other fit runs; Blender's timer calls this.
    Return the seconds until the next call, or None."""
    global _wanted
    if _wanted is None:
        return None
    if RangeFitOperator.fitting():
        return _RETRY_SECONDS
    windows = bpy.context.window_manager.windows
    try:
        with bpy.context.temp_override(window=bpy.context.window or windows[0]):
            hand = active_hand(bpy.context)
            if hand is None or hand.armature.session_uid != _wanted[0]:  # another hand was chosen meanwhile
                _wanted = None
                return None
            bpy.ops.manient.smooth_motion("INVOKE_DEFAULT", strength=_wanted[1], asked=True)
    except RuntimeError as error:  # its own report
        print(f"Hand Capture: {error}")
        _wanted = None
    return None


PROPERTIES = {
    # The window manager is in no undo step: the operator's is the only one.
    (bpy.types.WindowManager, "manient_smoothing"): lambda: bpy.props.FloatProperty(
        name="Smoothing",
        get=_shown,
        set=_moved,
        soft_max=3.0,
        **properties.option_property(
            "smoothing",
            more_help=". The captured motion is fitted anew; frames that you corrected or keyed stay as they "
            "are. Works on the preview range where it is used",
        ),
    )
}
TIMERS = (_smooth,)
unregister = _forget
