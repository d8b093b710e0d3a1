"""What all sections share."""

from __future__ import annotations

from typing import Any

import blf
import bpy

from .wording import shortened

CATEGORY = "Hand Capture"

_LABEL_MARGIN = 100
"""Pixels at scale 1 of a sidebar that are no label: margins, those of a box too, icon, the tabs"""
_BUTTON = 22
"""pixels at scale 1 of a button that is only an icon"""


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
    width: int | None = None,
) -> None:
    """A text of any length, wrapped to the region's width; in a dialog, which has none, to `width` pixels at
    scale 1. With the icon ERROR it is red."""
    column = layout.column(align=True)
    column.alert = icon == "ERROR"
    column.scale_y = 0.8
    for number, line in enumerate(wrapped(text, _room(context, width))):
        column.label(text=line, icon=icon if number == 0 else "BLANK1", translate=False)


def props(layout: bpy.types.UILayout, data: Any, *names: str) -> None:
    """Properties one below the other."""
    for name in names:
        layout.prop(data, name)


def split(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """A layout in which properties have their names on the left, and no dots for keys."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


def fitted(context: bpy.types.Context, text: str, beside: str = "", buttons: int = 0) -> str:
    """A name shortened in its middle so that it fits into one line, with the text `beside` it and so many
    square buttons at the line's end."""
    room = _room(context, None) - buttons * _BUTTON * context.preferences.system.ui_scale
    return shortened(text, lambda name: blf.dimensions(0, name + beside)[0] <= room)


def _room(context: bpy.types.Context, width: int | None) -> float:
    """Pixels that a label beside an icon has; sets the font's size for measuring."""
    scale = context.preferences.system.ui_scale
    blf.size(0, context.preferences.ui_styles[0].widget.points * scale)
    if width is not None:
        return (width - _LABEL_MARGIN) * scale
    return (context.region.width if context.region else 300) - _LABEL_MARGIN * scale


def wrapped(text: str, room: float) -> list[str]:
    """The text's lines that have room in so many pixels, in the font's present size."""
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
