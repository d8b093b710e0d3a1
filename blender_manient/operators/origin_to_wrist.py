"""Put the origin of a hand's object at its wrist."""

from __future__ import annotations

import bpy

from ..scene.editable import why_not_editable
from ..scene.origin import origin_to_wrist, why_not_at_wrist
from .mixins import HandOperator, errors_reported, polled_hand


class MANIENT_OT_origin_to_wrist(HandOperator, bpy.types.Operator):
    bl_idname = "manient.origin_to_wrist"
    bl_label = "Origin to Wrist"
    bl_description = (
        "Move the origin of the hand's object to where its wrist is in this frame. The hand stays where it "
        "is in every frame, and so does its relation to the picture"
    )

    @staticmethod
    def why_not(armature):
        """The object has to be one that can be moved."""
        return why_not_editable(armature) or why_not_at_wrist(armature)

    @errors_reported
    def execute(self, context):
        origin_to_wrist(polled_hand(context))
        return {"FINISHED"}
