"""Make a captured hand the active object."""

from __future__ import annotations

import bpy

from ..scene.store import hand_of


class MANIENT_OT_select_hand(bpy.types.Operator):
    bl_idname = "manient.select_hand"
    bl_label = "Select Hand"
    bl_description = "Make this hand the active object"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    hand: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})  # type: ignore

    def execute(self, context):
        """Select it alone; another object's mode is left."""
        armature = context.scene.objects.get(self.hand)
        if armature is None or hand_of(armature) is None:
            self.report({"ERROR"}, f"The hand {self.hand} is not in this scene any more")
            return {"CANCELLED"}
        if not armature.visible_get():
            self.report({"ERROR"}, f"The hand {self.hand} is hidden: show it first")
            return {"CANCELLED"}
        if context.mode != "OBJECT" and context.active_object is not armature:
            bpy.ops.object.mode_set(mode="OBJECT")
        for other in context.selected_objects:
            other.select_set(False)
        armature.select_set(True)
        context.view_layer.objects.active = armature
        return {"FINISHED"}
