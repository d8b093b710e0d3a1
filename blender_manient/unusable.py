"""What is registered in place of the add-on where it cannot run: the reason, where an artist looks for it."""

from __future__ import annotations

import bpy

from .common import installation
from .common.section import Section, sentence
from .common.wording import capitalised

ADDON = __package__ or ""
_REPOSITORY = ADDON.split(".")[1] if ADDON.count(".") > 1 else "none"


class _Reason:
    """Draws why the add-on cannot run."""

    layout: bpy.types.UILayout

    def draw(self, context):
        """Why, and what to do."""
        found = installation.fault()
        if found is not None:
            sentence(self.layout, context, capitalised(found.sentence), "ERROR", alert=True)


class MANIENT_PT_unusable(_Reason, Section, bpy.types.Panel):
    """The tab, with nothing in it but the reason."""

    # Two copies of the add-on, from two repositories, may both be unusable.
    bl_idname = f"MANIENT_PT_unusable_{_REPOSITORY}"[:60]
    bl_label = "Installation"


class ManientUnusablePreferences(_Reason, bpy.types.AddonPreferences):
    """What was chosen before stays in Blender's preferences; it is not shown."""

    bl_idname = ADDON


register, unregister = bpy.utils.register_classes_factory((ManientUnusablePreferences, MANIENT_PT_unusable))
