"""Export of the active hand's capture."""

from __future__ import annotations

import bpy

from ..exporters import EXPORTERS
from ..operators.export_hand import format_buttons
from ..scene.store import active_hand
from ..section import Section, sentence, split


class MANIENT_PT_export(Section, bpy.types.Panel):
    bl_idname = "MANIENT_PT_export"
    bl_label = "Export"
    bl_order = 9
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context):
        """Format, preset, button."""
        layout, settings = self.layout, context.scene.manient
        if active_hand(context) is None:
            sentence(layout, context, "Select a captured hand to export it", "INFO")
            return
        can = format_buttons(layout, context, settings, "export_format")
        column = split(layout.column())
        if EXPORTERS[settings.export_format].presets:
            column.prop(settings, "export_preset")
        row = layout.row()
        row.enabled = can
        row.operator("manient.export_hand", text="Export", icon="EXPORT")
