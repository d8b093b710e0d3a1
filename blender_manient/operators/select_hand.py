"""Make a captured hand the active object."""

from __future__ import annotations

import bpy

from handfit_core.errors import OptionError

from ..scene.store import hand_of
from .mixins import errors_reported, select_alone


class MANIENT_OT_select_hand(bpy.types.Operator):
    bl_idname = "manient.select_hand"
    bl_label = "Select Hand"
    bl_description = "Make this hand the active object"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    hand: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})  # type: ignore

    @errors_reported
    def execute(self, context):
        """Select it alone; another object's mode is left."""
        armature = context.scene.objects.get(self.hand)
        if armature is None or hand_of(armature) is None:
            raise OptionError(f"The hand {self.hand} is not in this scene any more")
        if not armature.visible_get():
            raise OptionError(f"The hand {self.hand} is hidden: show it first")
        if context.mode != "OBJECT" and context.active_object is not armature:
            bpy.ops.object.mode_set(mode="OBJECT")
        select_alone(context, armature)
        return {"FINISHED"}
