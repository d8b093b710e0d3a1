"""Installation: there only while something that a capture needs is missing or wrong."""

from __future__ import annotations

import bpy

from ..common.preferences import ADDON
from ..common.section import Section, sentence
from ..session import shared_worker


class MANIENT_PT_installation(Section, bpy.types.Panel):
    bl_label = "Installation"
    bl_order = 0

    @classmethod
    def poll(cls, _context):
        return bool(shared_worker.capture_sentence())

    def draw(self, context):
        layout = self.layout
        sentence(layout, context, shared_worker.capture_sentence(), "ERROR", alert=True)
        layout.operator("manient.check_installation", icon="CHECKMARK")
        layout.operator("preferences.addon_show", text="Preferences", icon="PREFERENCES").module = ADDON
