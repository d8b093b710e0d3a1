"""What operators share: their polls, which captured hand they work on, and how they fail."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import bpy

from handfit_core.errors import HandfitError

from ..scene.editable import why_not_editable, why_not_keyable, why_not_readable
from ..scene.store import CapturedHand, hand_of
from ..selection import active_hand


def hand_is_there(
    cls: type[Any], context: bpy.types.Context, *, change: bool = True, keys: bool = False
) -> bool:
    """Whether there is a captured hand to work on, in a mode to do so; the operator says what is missing.

    `change` also asks that the hand may be changed: not linked from another file. `keys` asks that single
    keys of it may be changed: its motion is in an action, not in the NLA.
    """
    hand = active_hand(context)
    if hand is None:
        cls.poll_message_set("Select a captured hand first")
        return False
    if change and context.mode not in {"OBJECT", "POSE"}:
        cls.poll_message_set("Go to Object or Pose Mode first")
        return False
    why_not = why_not_keyable if keys else why_not_editable if change else why_not_readable
    why = why_not(hand.armature)
    if why is not None:
        cls.poll_message_set(why)
    return why is None


def scene_is_editable(cls: type[Any], context: bpy.types.Context) -> bool:
    """Whether the scene may be changed; the operator says why not."""
    if not context.scene.is_editable:
        cls.poll_message_set("This scene is linked from another file")
        return False
    return True


def named_hand(context: bpy.types.Context, name: str) -> CapturedHand | None:
    """The captured hand of the armature with that name, or with an empty name the active object's."""
    obj = bpy.data.objects.get(name) if name else context.active_object
    return hand_of(obj) if obj is not None else None


def hand_in(context: bpy.types.Context) -> CapturedHand:
    """The captured hand that the poll found."""
    hand = active_hand(context)
    assert hand is not None
    return hand


def errors_reported(execute: Callable[[Any, bpy.types.Context], set[str]]) -> Any:
    """An operator's `execute` in which a HandfitError becomes a report, and the operator is cancelled."""

    @functools.wraps(execute)
    def reported(self, context):
        try:
            return execute(self, context)
        except HandfitError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    return reported
