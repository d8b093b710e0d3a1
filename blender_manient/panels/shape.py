"""Shape of the active hand."""

from __future__ import annotations

import bpy

from ..common.section import EditSection, note
from ..scene import reshape
from ..scene.store import active_hand


class MANIENT_PT_shape(EditSection, bpy.types.Panel):
    bl_label = "Shape"
    bl_order = 5
    works_on = staticmethod(active_hand)

    def draw(self, context):
        layout, hand = self.layout, self.works_on(context)
        kept = hand.armature.manient
        column = layout.column(align=True)
        for index, name in enumerate(reshape.shape_names_of(hand)):
            column.prop(kept, "betas", index=index, text=name or f"Shape {index + 1}", slider=True)
        trouble = reshape.trouble(hand.armature)
        if trouble:
            note(layout, trouble, "ERROR")
        layout.operator("manient.reset_shape", icon="LOOP_BACK")
        if kept.wrist != "open":
            layout.prop(kept, "forearm")
        layout.operator("manient.origin_to_wrist", icon="OBJECT_ORIGIN")
