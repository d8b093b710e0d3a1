"""Hand: which hands, and as which model."""

from __future__ import annotations

import bpy

from ..common import preferences
from ..common.section import Section, sentence, split
from ..operators import housekeeping


class MANIENT_PT_hand(Section, bpy.types.Panel):
    bl_label = "Hand"
    bl_order = 2
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, settings = self.layout, context.scene.manient
        split(layout)
        layout.prop(settings, "hands")
        layout.prop(settings, "model")
        if settings.model == "MANO":
            layout.prop(settings, "model_path", text="Files")
            folder = preferences.get().mano_folder
            if not settings.model_path and folder:
                sentence(layout, context, f"From the preferences: {folder}", "INFO")
            elif not settings.model_path:
                sentence(layout, context, "Choose your MANO file or folder", "ERROR")
            layout.operator("manient.check_mano", text="Check Files")
            for result in housekeeping.results(settings.model_path or folder):
                icon = "CHECKMARK" if result.ok else "ERROR"
                sentence(layout, context, result.sentence, icon)
        row = layout.row(heading="Expected Size")
        row.prop(settings, "use_hand_length", text="")
        sub = row.row()
        sub.active = settings.use_hand_length
        sub.prop(settings, "hand_length", text="cm")
