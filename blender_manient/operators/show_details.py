"""A text block of ours, with what went wrong: onto the clipboard for a bug report, or in a Text Editor."""

from __future__ import annotations

from typing import Any

import bpy

from .. import details
from .mixins import PollMixin


class _TextOperator:
    """What works on one of the file's text blocks."""

    bl_options = {"INTERNAL"}  # noqa: RUF012

    text: bpy.props.StringProperty(  # type: ignore
        name="Text", default=details.TEXT_NAME, options={"HIDDEN", "SKIP_SAVE"}
    )

    def execute(self: Any, context):
        """Hand the text over where the file has it."""
        text = details.local_text(self.text)
        if text is None:
            self.report({"ERROR"}, f"This file has no text '{self.text}': nothing was written yet")
            return {"CANCELLED"}
        self._show(context, text)
        return {"FINISHED"}


class MANIENT_OT_copy_details(PollMixin, _TextOperator, bpy.types.Operator):
    bl_idname = "manient.copy_details"
    bl_label = "Copy Details"
    bl_description = "Copy the text with the details to the clipboard, for a bug report"

    @classmethod
    def lacks(cls, _context):
        return "There is no clipboard without a window" if bpy.app.background else None

    def _show(self, context: bpy.types.Context, text: bpy.types.Text) -> None:
        context.window_manager.clipboard = text.as_string()
        self.report({"INFO"}, "Copied to the clipboard")


class MANIENT_OT_show_details(_TextOperator, bpy.types.Operator):
    bl_idname = "manient.show_details"
    bl_label = "Show Details"
    bl_description = "Open the text with the details in a Text Editor"

    def _show(self, context: bpy.types.Context, text: bpy.types.Text) -> None:
        if bpy.app.background:
            self.report({"INFO"}, text.as_string())
            return
        area = _text_editor(context) or _new_window(context)
        space = area.spaces.active
        assert isinstance(space, bpy.types.SpaceTextEditor)
        space.text = text
        space.show_word_wrap = True
        space.top = 0
        area.tag_redraw()


def _text_editor(context: bpy.types.Context) -> bpy.types.Area | None:
    areas = (area for window in context.window_manager.windows for area in window.screen.areas)
    return next((area for area in areas if area.type == "TEXT_EDITOR"), None)


def _new_window(context: bpy.types.Context) -> bpy.types.Area:
    bpy.ops.wm.window_new()
    area = context.window_manager.windows[-1].screen.areas[0]
    area.type = "TEXT_EDITOR"
    return area
