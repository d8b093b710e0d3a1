"""What is registered in place of the add-on where it cannot run: the reason, where an artist looks for it."""

from __future__ import annotations

import bpy

from .common import installation
from .common.section import Section, sentence

_REPOSITORY = __name__.split(".")[1] if installation.is_installed() else "none"


class MANIENT_PT_unusable(Section, bpy.types.Panel):
    """The tab, with nothing in it but the reason."""

    # Two copies of the add-on, from two repositories, may both be unusable.
    bl_idname = f"MANIENT_PT_unusable_{_REPOSITORY}"[:60]
    bl_label = "Installation"

    def draw(self, context):
        """Draw why the add-on cannot run, and what to do."""
        sentence(self.layout, context, installation.why_not, "ERROR")


register, unregister = bpy.utils.register_classes_factory((MANIENT_PT_unusable,))
