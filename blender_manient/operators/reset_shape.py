"""Give a hand the shape back that it was captured with."""

from __future__ import annotations

import bpy

from ..scene.reshape import reset
from .mixins import HandOperator, errors_reported, polled_hand


class MANIENT_OT_reset_shape(HandOperator, bpy.types.Operator):
    bl_idname = "manient.reset_shape"
    bl_label = "Reset Shape"
    bl_description = "Give the hand the proportions back that it was captured with"

    @errors_reported
    def execute(self, context):
        """Set the sliders, and reshape within the same undo step."""
        reset(polled_hand(context))
        return {"FINISHED"}
