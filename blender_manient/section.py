"""What all sections share."""

from __future__ import annotations

import blf
import bpy

CATEGORY = "Hand Capture"

_BESIDE = 84
"""Pixels at scale 1 of a sidebar that are no label: margins, icon, the tabs"""


class Section:
    """A panel of the tab."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CATEGORY


def sentence(
    layout: bpy.types.UILayout,
    context: bpy.types.Context,
    text: str,
    icon: str = "NONE",
    alert: bool = False,
    width: int | None = None,
) -> None:
    """A text of any length, wrapped to the region's width; in a dialog, which has none, to `width` pixels at
    scale 1."""
    column = layout.column(align=True)
    column.alert = alert
    column.scale_y = 0.8
    for number, line in enumerate(_wrapped(context, text, width)):
        column.label(text=line, icon=icon if number == 0 else "BLANK1", translate=False)


def _wrapped(context: bpy.types.Context, text: str, width: int | None) -> list[str]:
    """The text's lines as wide as a label beside an icon has room for."""
    scale = context.preferences.system.ui_scale
    if width is not None:
        room = (width - _BESIDE) * scale
    else:
        room = (context.region.width if context.region else 300) - _BESIDE * scale
    blf.size(0, context.preferences.ui_styles[0].widget.points * scale)
    lines, line = [], ""
    for word in text.split():
        longer = f"{line} {word}" if line else word
        if blf.dimensions(0, longer)[0] <= room:
            line = longer
            continue
        if line:
            lines.append(line)
        # Paths have no spaces to break at.
        while len(word) > 1 and blf.dimensions(0, word)[0] > room:
            fits = next(
                n for n in range(len(word) - 1, 0, -1) if n == 1 or blf.dimensions(0, word[:n])[0] <= room
            )
            lines.append(word[:fits])
            word = word[fits:]
        line = word
    return [*lines, line]
