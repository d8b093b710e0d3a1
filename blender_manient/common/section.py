"""The base classes of the sidebar's sections, and the layouts that all of them share."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from typing import Any, ClassVar

import blf
import bpy

from .wording import headline

CAPTURE, EDIT = "Hand Capture", "Hand Edit"
"""The tabs of the sidebar"""

_LABEL_MARGIN = 100
"""Pixels of a dialog or region that no label takes, at a user interface scale of 1: margins, those of a box
too, and the icon"""


class Section:
    """A panel of the tab in which hands are captured, closed at first."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = CAPTURE
    bl_options: ClassVar = {"DEFAULT_CLOSED"}


class EditSection(Section):
    """A panel of the tab in which captured hands are edited, shown where there is something to work on."""

    bl_category = EDIT
    works_on: Callable[[bpy.types.Context], Any]
    """Finds what the section works on; None where there is nothing"""

    @classmethod
    def poll(cls, context):
        """Return whether there is something that the section works on."""
        return cls.works_on(context) is not None


def note(layout: bpy.types.UILayout, text: str, icon: str = "NONE", short: str = "") -> None:
    """Draw a message in one line, whatever its length: `short`, else as much of it as there is room for. All
    of it is the tooltip. With the icon ERROR it is red."""
    row = layout.row(align=True)
    row.alert, row.emboss, row.alignment = icon == "ERROR", "NONE", "LEFT"
    row.operator("manient.note", text=short or headline(text), icon=icon, translate=False).text = text


def sentence(
    layout: bpy.types.UILayout,
    context: bpy.types.Context,
    text: str,
    icon: str = "NONE",
    width: int | None = None,
) -> None:
    """Draw a text of any length in a dialog of `width` pixels at scale 1, or wrapped to the region's width.
    With the icon ERROR it is red."""
    column = layout.column(align=True)
    column.alert = icon == "ERROR"
    column.scale_y = 0.8
    for number, line in enumerate(wrapped(text, _room(context, width))):
        column.label(text=line, icon=icon if number == 0 else "BLANK1", translate=False)


def row_of(layout: Any, enabled: bool = True, scale: float = 1.0) -> Any:
    """Make a row of buttons side by side, grey where it is not `enabled`, `scale` times as high as usual."""
    row = layout.row(align=True)
    row.enabled, row.scale_y = enabled, scale
    return row


def props(layout: bpy.types.UILayout, data: Any, *names: str) -> None:
    """Draw properties one below the other."""
    for name in names:
        layout.prop(data, name)


def split(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """Make a layout in which properties have their names on the left, and no dots for keys."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


def _room(context: bpy.types.Context, width: int | None) -> float:
    """Return how many pixels a label beside an icon has; sets the font's size for measuring."""
    scale = context.preferences.system.ui_scale
    blf.size(0, context.preferences.ui_styles[0].widget.points * scale)
    if width is not None:
        return (width - _LABEL_MARGIN) * scale
    return (context.region.width if context.region else 300) - _LABEL_MARGIN * scale


def wrapped(text: str, room: float) -> list[str]:
    """Break a text into lines about as wide as so many pixels in the font's present size."""
    letter = blf.dimensions(0, "n")[0] or 1.0
    return textwrap.wrap(text, max(8, int(room / letter))) or [""]
