"""Put what captured hands do on a character."""

from __future__ import annotations

from collections.abc import Generator

import bpy

from handfit_core.errors import HandfitError, OptionError
from handfit_core.slices import run_to_completion, slice_clock

from ..block_reference import BlockReference
from ..scene.build import ChangeWatch
from ..scene.characters import active_character, hands_to_move, why_not_reachable
from ..scene.onto_character import Applied, TransferOptions, putting, shortcomings
from ..wording import capitalised, counted
from .mixins import PollMixin, TimerMixin, errors_reported

_TICK = 1 / 60
"""seconds between two looks"""


class MANIENT_OT_apply_to_character(PollMixin, TimerMixin, bpy.types.Operator):
    bl_idname = "manient.apply_to_character"
    bl_label = "Apply to Character"
    bl_description = (
        "Key what the captured hands do on the hands of the selected character, whatever its bones are "
        "called and however they lie"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    mode: bpy.props.EnumProperty(  # type: ignore
        name="Apply",
        items=(
            ("ANIMATION", "Animation", "All that the captured hands do"),
            ("POSE", "Pose", "Their pose in the current frame, into the present action"),
        ),
        default="ANIMATION",
        options={"SKIP_SAVE"},
    )

    _running = False
    """Whether one is at work already"""

    @classmethod
    def lacks(cls, context):
        if cls._running:
            return "Motion is being applied already"
        armature = active_character(context)
        if armature is None:
            return "Select a character first: its armature, or a mesh that it deforms"
        why = why_not_reachable(armature)
        if why is not None:
            return why
        try:
            hands_to_move(armature, context)
        except HandfitError as error:
            return capitalised(str(error))
        return None

    @errors_reported
    def execute(self, context):
        """Do it at once: for scripts, and without a window."""
        return self._finished(context, run_to_completion(self._work(context)))

    @errors_reported
    def invoke(self, context, _event):
        """Do it while the window stays free."""
        self._steps = self._work(context)
        self._watch = ChangeWatch()
        self._armature = BlockReference.of("objects", active_character(context))
        MANIENT_OT_apply_to_character._running = True
        return self._start_timer(context, _TICK)

    def modal(self, context, event):
        """Go on; Esc stops, and nothing was changed then."""
        try:
            if self._watch.changed or self._armature.find() is None:
                raise OptionError("an undo or a deletion stopped Apply to Character")
            if event.type == "ESC" and event.value == "PRESS":
                self._end(context)
                self.report({"INFO"}, "Apply to Character was stopped; nothing was changed")
                return {"CANCELLED"}
            if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
                return {"PASS_THROUGH"}
            is_over = slice_clock()
            while not is_over():
                try:
                    done = next(self._steps)
                except StopIteration as stop:
                    self._end(context)
                    return self._finished(context, stop.value)
                self._show_status(context, f"Applying to {self._armature.name}  {done:.0%}   Esc: Stop")
        except (HandfitError, ReferenceError) as error:
            gone = "a hand was deleted while its motion was being applied: nothing was changed"
            self.report({"ERROR"}, gone if isinstance(error, ReferenceError) else str(error))
            self._end(context)
            return {"CANCELLED"}
        except Exception:
            self._end(context)
            raise
        return {"RUNNING_MODAL"}

    def cancel(self, context):
        self._end(context)

    def _work(self, context) -> Generator[float, None, list[Applied]]:
        armature = active_character(context)
        assert armature is not None
        posing = self.mode == "POSE"
        onto = TransferOptions.of(armature, **({"into": "ACTION", "wrist": "FINGERS"} if posing else {}))
        hands = hands_to_move(armature, context)
        return (
            yield from putting(armature, hands, onto, [context.scene.frame_current_final] if posing else None)
        )

    def _finished(self, context, applied: list[Applied]):
        scene = context.scene
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
        for sentence in shortcomings(applied):
            self.report({"WARNING"}, sentence[:1].upper() + sentence[1:])
        bones = sum(one.bones for one in applied)
        frames = max(one.frames for one in applied)
        self.report({"INFO"}, f"Keyed {counted(bones, 'bone')} in {counted(frames, 'frame')}")
        return {"FINISHED"}

    def _end(self, context) -> None:
        MANIENT_OT_apply_to_character._running = False
        self._watch.stop()
        self._stop_timer(context)
        self._steps.close()
