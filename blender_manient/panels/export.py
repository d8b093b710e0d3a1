"""Export of the active hand's capture, or of the active character."""

from __future__ import annotations

import bpy

from ..common.section import EditSection, note, row_of, split
from ..exporters import EXPORTERS
from ..operators.export import format_buttons
from ..scene.characters import active_character, why_not_written
from ..scene.store import CapturedHand, active_hand, hand_of


def _exported(context: bpy.types.Context) -> bpy.types.Object | CapturedHand | None:
    """Return the character, or else the hand, that the buttons are for; None for neither."""
    chosen = context.active_object
    is_hand = chosen is not None and hand_of(chosen) is not None
    character = None if is_hand else active_character(context)
    return character or active_hand(context)


class MANIENT_PT_export(EditSection, bpy.types.Panel):
    bl_label = "Export"
    bl_order = 7
    works_on = staticmethod(_exported)

    def draw(self, context):
        layout, settings, chosen = self.layout, context.scene.manient, self.works_on(context)
        character = None if isinstance(chosen, CapturedHand) else chosen
        why = why_not_written(character, context.scene) if character is not None else None
        if character is not None:
            layout.label(text=character.name, icon="OUTLINER_OB_ARMATURE", translate=False)
        else:
            layout.label(text=chosen.collection.name, icon="VIEW_PAN", translate=False)
        if why is not None:
            note(layout, why, "ERROR")
        can = format_buttons(layout, settings, "export_format", character=character is not None)
        column = split(layout.column())
        if EXPORTERS[settings.export_format].presets:
            column.prop(settings, "export_preset")
        if character is not None and EXPORTERS[settings.export_format].bakes:
            column.prop(settings, "export_meshes")
        row = row_of(layout, can and why is None)
        if character is None:
            row.operator("manient.export_hand", text="Export", icon="EXPORT")
            return
        button = row.operator("manient.export_character", text="Export", icon="EXPORT")
        button.file_format, button.preset = settings.export_format, settings.export_preset
        button.meshes = settings.export_meshes
