"""Export of the active hand's capture, or of the active character."""

from __future__ import annotations

import bpy

from ..common.section import Section, fitted, sentence, split
from ..exporters import EXPORTERS
from ..operators.export import format_buttons
from ..scene.characters import active_character, why_not_written
from ..scene.store import active_hand, hand_of


class MANIENT_PT_export(Section, bpy.types.Panel):
    bl_label = "Export"
    bl_order = 9
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, settings = self.layout, context.scene.manient
        chosen = context.active_object
        character = None if chosen is not None and hand_of(chosen) is not None else active_character(context)
        hand = None if character is not None else active_hand(context)
        if character is None and hand is None:
            text = "Select a captured hand, or a character, to export it"
            sentence(layout, context, text, "INFO")
            return
        can = True
        if character is not None:
            name = fitted(context, character.name)
            layout.label(text=name, icon="OUTLINER_OB_ARMATURE", translate=False)
            why = why_not_written(character, context.scene)
            if why is not None:
                sentence(layout, context, why, "ERROR")
                can = False
        elif hand is not None:
            layout.label(text=fitted(context, hand.collection.name), icon="VIEW_PAN", translate=False)
        can &= format_buttons(layout, context, settings, "export_format", character=character is not None)
        column = split(layout.column())
        if EXPORTERS[settings.export_format].presets:
            column.prop(settings, "export_preset")
        if character is not None and EXPORTERS[settings.export_format].bakes:
            column.prop(settings, "export_meshes")
        row = layout.row()
        row.enabled = can
        if character is None:
            row.operator("manient.export_hand", text="Export", icon="EXPORT")
            return
        button = row.operator("manient.export_character", text="Export", icon="EXPORT")
        button.file_format, button.preset = settings.export_format, settings.export_preset
        button.meshes = settings.export_meshes
