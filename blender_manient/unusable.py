"""What is registered in place of the add-on where it cannot run: the reason, where an artist looks for it."""

from __future__ import annotations

import bpy

from . import verification
from .section import Section, sentence
from .wording import capitalised

ADDON = __package__ or ""
_REPOSITORY = ADDON.split(".")[1] if ADDON.count(".") > 1 else "none"


class MANIENT_PT_unusable(Section, bpy.types.Panel):
    """The tab, with nothing in it but the reason."""

    # Two copies of the add-on, from two repositories, may both be unusable.
    bl_idname = f"MANIENT_PT_unusable_{_REPOSITORY}"[:60]
    bl_label = "Installation"

    def draw(self, context):
        """Why, and what to do."""
        _draw(self.layout, context)


class ManientUnusablePreferences(bpy.types.AddonPreferences):
    """What was chosen before stays in Blender's preferences; it is not shown."""

    bl_idname = ADDON

    def draw(self, context):
        """Why, and what to do."""
        _draw(self.layout, context)


def _draw(layout: bpy.types.UILayout | None, context: bpy.types.Context) -> None:
    assert layout is not None
    for problem in verification.problems()[:1]:
        text = capitalised(problem.sentence)
        sentence(layout, context, text, "ERROR", alert=True)


_CLASSES = (ManientUnusablePreferences, MANIENT_PT_unusable)


def register() -> None:
    """Add the panel and the preferences."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them away again."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
