"""Show Details: the text block with what went wrong, in a Text Editor."""

from __future__ import annotations

import bpy

from .. import details


class MANIENT_OT_show_details(bpy.types.Operator):
    bl_idname = "manient.show_details"
    bl_label = "Show Details"
    bl_description = "Open the text with the details in a Text Editor"
    bl_options = {"INTERNAL"}  # noqa: RUF012

    text: bpy.props.StringProperty(  # type: ignore
        name="Text", default=details.TEXT_NAME, options={"HIDDEN", "SKIP_SAVE"}
    )

    def execute(self, context):
        text = details.local_text(self.text)
        if text is None:
            self.report({"ERROR"}, f"This file has no text '{self.text}': nothing was written yet")
            return {"CANCELLED"}
        if bpy.app.background:
            self.report({"INFO"}, text.as_string())
            return {"FINISHED"}
        area = _text_editor(context) or _new_window(context)
        space = area.spaces.active
        assert isinstance(space, bpy.types.SpaceTextEditor)
        space.text = text
        space.show_word_wrap = True
        space.top = 0
        area.tag_redraw()
        return {"FINISHED"}


def _text_editor(context: bpy.types.Context) -> bpy.types.Area | None:
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "TEXT_EDITOR":
                return area
    return None


def _new_window(context: bpy.types.Context) -> bpy.types.Area:
    bpy.ops.wm.window_new()
    area = context.window_manager.windows[-1].screen.areas[0]
    area.type = "TEXT_EDITOR"
    return area


def register() -> None:
    """Add the operator."""
    bpy.utils.register_class(MANIENT_OT_show_details)


def unregister() -> None:
    """Take it away again."""
    bpy.utils.unregister_class(MANIENT_OT_show_details)
