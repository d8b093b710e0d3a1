"""What all sections share."""

from __future__ import annotations

import textwrap

import bpy

CATEGORY = "Hand Capture"


class Section:
    """A panel of the tab."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CATEGORY


def sentence(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE", alert: bool = False
) -> None:
    """A text of any length, wrapped to the sidebar's width."""
    width = context.region.width if context.region else 300
    scale = context.preferences.system.ui_scale
    characters = max(16, int((width / scale - 52) / 6.4))
    column = layout.column(align=True)
    column.alert = alert
    column.scale_y = 0.8
    for number, line in enumerate(textwrap.wrap(text[:1].upper() + text[1:], characters) or [""]):
        column.label(text=line, icon=icon if number == 0 else "BLANK1", translate=False)
