"""Which captured hand the artist works on."""

from __future__ import annotations

import bpy

from .scene.store import CapturedHand, captured_hands, hand_of


def active_hand(context: bpy.types.Context) -> CapturedHand | None:
    """The captured hand that the artist works on: the active object's, else the only one there is."""
    if context.active_object is not None:
        hand = hand_of(context.active_object)
        if hand is not None:
            return hand
    armatures = captured_hands(context.scene)
    return hand_of(armatures[0]) if len(armatures) == 1 else None
