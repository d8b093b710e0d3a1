"""What operators share: their names, polls and reports, which hand they work on, and how they go on while the
window stays free."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Final

import bpy

from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.common.slices import slice_clock

from ..scene.build import ChangeWatch
from ..scene.characters import active_character, why_not_reachable
from ..scene.editable import why_not_editable
from ..scene.store import CapturedHand, active_hand, hand_of
from ..session.shared_worker import Progress

NO_CHARACTER: Final = "Select a character first: its armature, or a mesh that it deforms"
LINKED_SCENE: Final = "This scene is linked from another file: open or make one of your own"


class ManientOperator:
    """The base of all operators: the class' name is the operator's, its docstring the tooltip,
    `poll_reason` the poll, and `run` does the work."""

    bl_options = {"REGISTER", "UNDO"}
    layout: Any
    properties: Any
    report: Any

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if cls.__name__.startswith("MANIENT_OT_"):
            cls.bl_idname = f"manient.{cls.__name__.removeprefix('MANIENT_OT_')}"
            cls.bl_description = " ".join((cls.__doc__ or "").split()).removesuffix(".")

    @classmethod
    def poll(cls: Any, context):
        why = cls.poll_reason(context)
        if why:
            cls.poll_message_set(why)
        return not why

    @classmethod
    def poll_reason(cls, context: bpy.types.Context) -> str | None:
        """Return why the operator cannot begin, a sentence for its tooltip; None where it can."""

    def run(self, context: bpy.types.Context) -> str | set[str] | None:
        """Do the work. Return what is reported of it, or Blender's own result. Raises HandfitError, which
        cancels it."""
        raise NotImplementedError

    def execute(self, context):
        return self._reported(self.run, context)

    def _reported(self, method: Callable[..., Any], *args: Any) -> set[str]:
        try:
            result = method(*args)
        except HandfitError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return result if isinstance(result, set) else self._done(result)

    def _done(self, sentence: str | None = None, *, kind: str = "INFO") -> set[str]:
        if sentence:
            self.report({kind}, sentence)
        return {"FINISHED"}

    def _nothing_done(self, sentence: str) -> set[str]:
        """Return the result where there is nothing to do, which is no error, and report the sentence."""
        self.report({"INFO"}, sentence)
        return {"CANCELLED"}


class InternalOperator(ManientOperator):
    """The base of operators that change nothing in the file: no undo, and not in Blender's search."""

    bl_options = {"INTERNAL"}


class SceneOperator(ManientOperator):
    """The base of operators that need a scene that may be changed."""

    @classmethod
    def poll_reason(cls, context) -> str | None:
        return None if context.scene is not None and context.scene.is_editable else LINKED_SCENE


class HandOperator(ManientOperator):
    """The base of operators on the active captured hand."""

    why_not = staticmethod(why_not_editable)
    """Returns why the hand cannot be worked on, a sentence, or None; by default why nothing of it can be
    changed"""
    anywhere = False
    """True if the operator works in every mode, and not only where the hand is posed"""

    @classmethod
    def poll_reason(cls, context) -> str | None:
        hand = active_hand(context)
        if hand is None:
            return "Select a captured hand first: its armature or its mesh"
        if not cls.anywhere and context.mode not in {"OBJECT", "POSE"}:
            return "Go to Object or Pose Mode first"
        return cls.why_not(hand.armature)


class CharacterOperator(ManientOperator):
    """The base of operators on the selected character."""

    @classmethod
    def poll_reason(cls, context) -> str | None:
        armature = active_character(context)
        return NO_CHARACTER if armature is None else why_not_reachable(armature)


@dataclass
class ModalState:
    """The state of a modal operator that goes on."""

    timer: Any = None
    can_stop: bool = True
    """True if the operator can still be stopped before anything is changed"""
    stopped: bool = False

    def stop(self) -> None:
        self.stopped |= self.can_stop
        self.can_stop = False


_running: dict[str, ModalState] = {}
"""The modal operators that go on now, by their names, which are their classes': an instance's `bl_idname` is
Blender's own, MANIENT_OT_... An annotation in an operator must name no class of ours: Blender keeps it, and
hangs when Python ends."""


class ModalOperator(ManientOperator):
    """The base of operators that go on while the window stays free, one of a kind at a time."""

    bl_options = {"REGISTER"}
    bl_idname: str
    running = _running
    tick = 0.02
    """Seconds between two TIMER events"""
    _timer: Any = None

    def begin(self, context: bpy.types.Context) -> set[str] | None:
        """Prepare what `follow` goes on with. Return a result where there is nothing to follow. Raises
        HandfitError, which cancels the operator."""

    def follow(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Go on with an event; whoever returns FINISHED or CANCELLED has called `end`. Raises HandfitError,
        which ends and cancels it."""
        raise NotImplementedError

    def ended(self, context: bpy.types.Context) -> None:
        """Clean up behind the operator at its end. May be called twice."""

    def invoke(self, context, _event):
        return self._reported(self._begun, context)

    def _begun(self, context: bpy.types.Context) -> set[str]:
        result = self.begin(context)
        if result is None:
            self._timer = context.window_manager.event_timer_add(self.tick, window=context.window)
            context.window_manager.modal_handler_add(self)  # type: ignore[arg-type]
            self.running[type(self).bl_idname] = ModalState(self._timer)
        return result or {"RUNNING_MODAL"}

    def modal(self, context, event):
        try:
            return self.follow(context, event)
        except HandfitError as error:
            self.report({"ERROR"}, str(error))
            self.end(context)
            return {"CANCELLED"}
        except Exception:
            # An operator that Blender ends after an error cannot clean up later.
            self.end(context)
            raise

    def cancel(self, context):
        """Clean up where Blender ends the operator itself, as on loading a file, or a dialog that has begun
        nothing."""
        if self._timer is not None:
            self.end(context)

    def end(self, context: bpy.types.Context) -> set[str]:
        """End the operator, its timer and its status line; return FINISHED. May be called twice."""
        self.running.pop(type(self).bl_idname, None)
        self.ended(context)
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        self.show_status(context, None)
        return {"FINISHED"}

    def show_status(self, context: bpy.types.Context, text: str | None) -> None:
        """Show a line in the status bar; None shows Blender's own again."""
        if context.workspace is not None:
            context.workspace.status_text_set(text)


class ModeOperator(ModalOperator):
    """The base of operators that run a mode over a viewport, one of a kind at a time."""

    current: Any = None
    """The mode, while it goes on; None otherwise"""

    @classmethod
    def leave(cls, *_args) -> None:
        """End the mode, if it goes on; its operator finds out with its next event."""
        ended, cls.current = cls.current, None
        if ended is not None:
            ended.end(bpy.context)

    def ended(self, context):
        self.leave()


def finish(steps: Generator[str | Progress, None, Any]) -> Any:
    """Do steps without a window beside them; return their result. `Progress` is of another process, which is
    waited for."""
    with closing(steps):
        while True:
            try:
                if isinstance(next(steps), Progress):
                    time.sleep(0.005)
            except StopIteration as stop:
                return stop.value


class StepsOperator(ModalOperator):
    """The base of operators that work in steps: in slices beside the window's work, at once for scripts."""

    bl_options = {"REGISTER", "UNDO"}
    tick = 1 / 60
    title: str
    """A name of the work, such as a sentence begins with"""
    undone: str
    """The sentence that is reported where an undo stops them"""

    def steps(self, context: bpy.types.Context) -> Generator[str | Progress, None, Any]:
        """Do the work; yields how far it is. Returns what `finished` gets. Where it is closed, nothing was
        changed, unless `can_stop` was made False."""
        raise NotImplementedError

    def finished(self, context: bpy.types.Context, result: Any) -> str | set[str] | None:
        """Return what is reported of the result, or Blender's own result, as `run` does."""
        raise NotImplementedError

    def run(self, context):
        return self.finished(context, finish(self.steps(context)))

    def begin(self, context):
        self._steps, self._watch = self.steps(context), ChangeWatch()

    def follow(self, context, event):
        """Go on; Esc stops, as long as nothing was changed."""
        state = self.running[type(self).bl_idname]
        if self._watch.changed:
            raise OptionError(self.undone)
        if event.type == "ESC" and event.value == "PRESS":
            state.stop()
        if state.stopped:
            self.end(context)
            return self._nothing_done(f"{self.title} was stopped; nothing was changed")
        if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
            return {"PASS_THROUGH"}
        is_over = slice_clock()
        while True:
            try:
                text = next(self._steps)
            except StopIteration as stop:
                self.end(context)
                return self._reported(self.finished, context, stop.value)
            self.show_status(context, f"{text}   Esc: Stop" if state.can_stop else str(text))
            if isinstance(text, Progress) or is_over():
                return {"PASS_THROUGH"}

    def ended(self, context):
        self._steps.close()


def named_hand(context: bpy.types.Context, name: str) -> CapturedHand:
    """Return the captured hand of the armature with that name, or with an empty name the active object's.
    Raises OptionError."""
    obj = bpy.data.objects.get(name) if name else context.active_object
    hand = hand_of(obj) if obj is not None else None
    if hand is None:
        raise OptionError("No captured hand: select a hand that keeps its take")
    return hand


def polled_hand(context: bpy.types.Context) -> CapturedHand:
    """Return the captured hand that the poll found."""
    hand = active_hand(context)
    assert hand is not None
    return hand


def polled_character(context: bpy.types.Context) -> Any:
    """Return the armature of the character that the poll found."""
    return active_character(context)


def select_alone(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Make an object the active and the only selected one."""
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


def show_frame_again(context: bpy.types.Context) -> None:
    """Have the scene show the keys of its present frame as they are now."""
    context.scene.frame_set(context.scene.frame_current, subframe=context.scene.frame_subframe)


def unregister() -> None:
    """End the timers and the status line of what goes on, and forget it: Blender has ended it without
    asking."""
    context = bpy.context
    for state in ModalOperator.running.values():
        context.window_manager.event_timer_remove(state.timer)
    if ModalOperator.running and context.workspace is not None:
        context.workspace.status_text_set(None)
    ModalOperator.running.clear()
