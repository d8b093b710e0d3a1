"""Give a hand the shape back that it was captured with."""

from __future__ import annotations

import bpy

from ..scene.reshape import reset
from .needs_hand import OnHand, errors_reported, hand_in


class MANIENT_OT_reset_shape(OnHand, bpy.types.Operator):
    bl_idname = "manient.reset_shape"
    bl_label = "Reset Shape"
    bl_description = "Give the hand the proportions back that it was captured with"

    @errors_reported
    def execute(self, context):
        """Set the sliders, and reshape within the same undo step."""
        reset(hand_in(context))
        return {"FINISHED"}
