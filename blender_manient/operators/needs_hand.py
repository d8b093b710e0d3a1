"""The poll of operators that work on a captured hand."""

from __future__ import annotations

from typing import Any

import bpy

from ..scene.store import CapturedHand
from ..selection import active_hand


def hand_is_there(cls: type[Any], context: bpy.types.Context, *, change: bool = True) -> bool:
    """Whether there is a captured hand to work on, in a mode to do so; the operator says what is missing.

    `change` also asks that the hand may be changed: not linked from another file.
    """
    hand = active_hand(context)
    if hand is None:
        cls.poll_message_set("Select a captured hand first")
        return False
    if change and context.mode not in {"OBJECT", "POSE"}:
        cls.poll_message_set("Go to Object or Pose Mode first")
        return False
    if change and not hand.armature.is_editable:
        cls.poll_message_set("The hand is linked from another file; make it local to change it")
        return False
    return True


def hand_in(context: bpy.types.Context) -> CapturedHand:
    """The captured hand that the poll found."""
    hand = active_hand(context)
    assert hand is not None
    return hand
