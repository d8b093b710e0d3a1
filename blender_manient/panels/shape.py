"""Shape of the active hand, and its motion as a whole."""

from __future__ import annotations

import bpy

from ..common.section import Section, sentence
from ..scene import reshape
from ..scene.store import active_hand


class MANIENT_PT_shape(Section, bpy.types.Panel):
    bl_label = "Shape and Pose"
    bl_order = 6
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, hand = self.layout, active_hand(context)
        if hand is None:
            sentence(layout, context, "Select a captured hand to shape it", "INFO")
            return
        column = layout.column(align=True)
        column.operator("manient.mirror_hand", icon="MOD_MIRROR")
        column.operator("manient.apply_take", icon="IMPORT")
        column = layout.column(align=True)
        if hand.rig.controls:
            row = column.row(align=True)
            row.prop(hand.armature.manient, "use_controls", toggle=True)
            row.prop(hand.armature.manient, "limits", toggle=True)
            column.operator("manient.bake_controls", icon="ACTION")
            column.operator("manient.remove_controls", icon="X")
        else:
            column.operator("manient.add_controls", icon="POSE_HLT")
        layout.operator("manient.origin_to_wrist", icon="OBJECT_ORIGIN")
        if hand.armature.manient.wrist != "open":
            layout.prop(hand.armature.manient, "forearm")


class MANIENT_PT_proportions(Section, bpy.types.Panel):
    bl_label = "Proportions"
    bl_parent_id = "MANIENT_PT_shape"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return active_hand(context) is not None

    def draw(self, context):
        layout, hand = self.layout, active_hand(context)
        assert hand is not None
        column = layout.column(align=True)
        for index, name in enumerate(reshape.shape_names_of(hand)):
            if name is not None:
                column.prop(hand.armature.manient, "betas", index=index, text=name, slider=True)
        trouble = reshape.trouble(hand.armature)
        if trouble:
            sentence(layout, context, trouble, "ERROR")
        layout.operator("manient.reset_shape", icon="LOOP_BACK")


class MANIENT_PT_other_proportions(Section, bpy.types.Panel):
    bl_label = "Without a Name"
    bl_parent_id = "MANIENT_PT_proportions"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        hand = active_hand(context)
        return hand is not None and None in reshape.shape_names_of(hand)

    def draw(self, context):
        layout, hand = self.layout, active_hand(context)
        assert hand is not None
        column = layout.column(align=True)
        for index, name in enumerate(reshape.shape_names_of(hand)):
            if name is None:
                column.prop(
                    hand.armature.manient, "betas", index=index, text=f"Shape {index + 1}", slider=True
                )
