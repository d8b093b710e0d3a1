"""What operators share: their polls, which captured hand they work on, how they wait and how they fail."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import bpy

from handfit_core.errors import HandfitError, OptionError

from ..scene.editable import why_not_editable
from ..scene.store import CapturedHand, active_hand, hand_of


class PollMixin:
    """An operator's poll whose message is the sentence that `lacks` returns."""

    @classmethod
    def poll(cls: Any, context):
        """Whether it can begin."""
        why = cls.lacks(context)
        if why:
            cls.poll_message_set(why)
        return not why

    @classmethod
    def lacks(cls, context: bpy.types.Context, /) -> str | None:
        """What is missing; None where it can begin. By default: a scene that may be changed."""
        return None if context.scene.is_editable else "This scene is linked from another file"


class HandOperator(PollMixin):
    """The poll and the options of an operator on the active captured hand."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    why_not = staticmethod(why_not_editable)
    """Tells why the hand cannot be worked on; by default why nothing of it can be changed"""
    anywhere = False
    """Whether it works in every mode, and not only where the hand is posed"""

    @classmethod
    def lacks(cls, context):
        hand = active_hand(context)
        if hand is None:
            return "Select a captured hand first: its armature or its mesh"
        if not cls.anywhere and context.mode not in {"OBJECT", "POSE"}:
            return "Go to Object or Pose Mode first"
        return cls.why_not(hand.armature)


class TimerMixin:
    """The timer and the status line of a modal operator, whose `cancel` Blender calls when it ends the
    operator itself, as on loading a file."""

    _timer = None

    def _start_timer(self, context: bpy.types.Context, seconds: float) -> set[str]:
        """Get a TIMER event every few `seconds` from now on."""
        self._timer = context.window_manager.event_timer_add(seconds, window=context.window)
        context.window_manager.modal_handler_add(self)  # type: ignore[arg-type]
        return {"RUNNING_MODAL"}

    def _show_status(self, context: bpy.types.Context, text: str | None) -> None:
        """Show a line in the status bar; None: Blender's own again."""
        if context.workspace is not None:
            context.workspace.status_text_set(text)

    def _stop_timer(self, context: bpy.types.Context) -> None:
        """End the timer and give the status bar back. May be called twice."""
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        self._show_status(context, None)


def named_hand(context: bpy.types.Context, name: str) -> CapturedHand:
    """The captured hand of the armature with that name, or with an empty name the active object's. Raises
    OptionError."""
    obj = bpy.data.objects.get(name) if name else context.active_object
    hand = hand_of(obj) if obj is not None else None
    if hand is None:
        raise OptionError("No captured hand: select a hand that keeps its take")
    return hand


def polled_hand(context: bpy.types.Context) -> CapturedHand:
    """The captured hand that the poll found."""
    hand = active_hand(context)
    assert hand is not None
    return hand


def select_alone(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Make an object the active and the only selected one."""
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


def errors_reported(method: Callable[..., set[str]]) -> Any:
    """An operator's method in which a HandfitError becomes a report, and the operator is cancelled."""

    def reported(operator, *args):
        try:
            return method(operator, *args)
        except HandfitError as error:
            operator.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    # Blender counts the arguments of each function: of `invoke` and of `execute`.
    with_event: Any = lambda self, context, event: reported(self, context, event)  # noqa: E731
    without: Any = lambda self, context: reported(self, context)  # noqa: E731
    return functools.wraps(method)(with_event if method.__code__.co_argcount == 3 else without)
