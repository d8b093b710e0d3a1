"""What stands in Edit > Preferences > Add-ons > Manient Hand Capture, one block per subject."""

from __future__ import annotations

import bpy

from ..common import plugins, preferences
from ..common.section import props, row_of, sentence, split
from ..common.wording import capitalised
from ..operators import check_installation, housekeeping
from ..session import cache, details


class ManientPreferences(preferences.Values, bpy.types.AddonPreferences):
    """The add-on's own preferences, as Blender keeps and shows them."""

    bl_idname = preferences.ADDON

    def draw(self, context):
        layout = self.layout
        split(layout)
        for draw in (_draw_worker, _draw_mano, _draw_cache, _draw_habits, _draw_plugins):
            draw(self, layout.column(), context)


def _draw_worker(self, layout: bpy.types.UILayout, _context: bpy.types.Context) -> None:
    props(layout, self, "python", "threads", "max_megapixels")
    row = layout.row(align=True)
    row.operator("manient.check_installation", icon="CHECKMARK")
    if details.local_text(check_installation.TEXT_NAME) is not None:
        show = row.operator("manient.show_details", text="Show", icon="TEXT")
        copy = row.operator("manient.copy_details", text="Copy", icon="COPYDOWN")
        show.text = copy.text = check_installation.TEXT_NAME


def _draw_mano(self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    layout.separator()
    layout.prop(self, "mano_folder")
    row = row_of(layout, bool(self.mano_folder))
    row.operator("manient.check_mano", icon="CHECKMARK").path = self.mano_folder
    for result in housekeeping.results(self.mano_folder):
        sentence(layout, context, result.sentence, "CHECKMARK" if result.ok else "ERROR")


def _draw_cache(self, layout: bpy.types.UILayout, _context: bpy.types.Context) -> None:
    layout.separator()
    layout.prop(self, "cache_folder")
    row = layout.row()
    row.label(text=f"{cache.shown_size() / 1e6:.1f} MB in use", icon="BLANK1", translate=False)
    row.operator("manient.clear_cache", icon="TRASH")


def _draw_habits(self, layout: bpy.types.UILayout, _context: bpy.types.Context) -> None:
    layout.separator()
    props(layout, self, "default_preset", "drop_captures", "hand_opacity")


def _draw_plugins(_self, layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    layout.separator()
    layout.operator("manient.open_plugins", icon="FILE_FOLDER")
    for trouble in plugins.troubles():
        sentence(layout, context, capitalised(trouble), "ERROR")
