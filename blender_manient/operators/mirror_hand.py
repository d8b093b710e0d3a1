"""Make the opposite hand of a captured one."""

from __future__ import annotations

import bpy

from ..scene.mirror import mirror_hand
from .mixins import HandOperator, errors_reported, polled_hand, select_alone


class MANIENT_OT_mirror_hand(HandOperator, bpy.types.Operator):
    bl_idname = "manient.mirror_hand"
    bl_label = "Mirror Hand"
    bl_description = (
        "Add the opposite hand with the same motion, mirrored across the middle of the camera's view, "
        "or beside the hand where the two would overlap"
    )

    @errors_reported
    def execute(self, context):
        """Build it and make it the active object."""
        armature = mirror_hand(polled_hand(context))
        if context.mode == "OBJECT" and armature.name in context.view_layer.objects:
            select_alone(context, armature)
        return {"FINISHED"}
