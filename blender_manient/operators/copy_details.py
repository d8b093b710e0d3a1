"""Copy Details: a text block of ours onto the clipboard, for a bug report."""

from __future__ import annotations

import bpy

from .. import details


class MANIENT_OT_copy_details(bpy.types.Operator):
    bl_idname = "manient.copy_details"
    bl_label = "Copy Details"
    bl_description = "Copy the text with the details to the clipboard, for a bug report"
    bl_options = {"INTERNAL"}  # noqa: RUF012

    text: bpy.props.StringProperty(  # type: ignore
        name="Text", default=details.TEXT_NAME, options={"HIDDEN", "SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, _context):
        """Without a window there is no clipboard."""
        if bpy.app.background:
            cls.poll_message_set("There is no clipboard without a window")
            return False
        return True

    def execute(self, context):
        text = details.local_text(self.text)
        if text is None:
            self.report({"ERROR"}, f"This file has no text '{self.text}': nothing was written yet")
            return {"CANCELLED"}
        context.window_manager.clipboard = text.as_string()
        self.report({"INFO"}, "Copied to the clipboard")
        return {"FINISHED"}


def register() -> None:
    """Add the operator."""
    bpy.utils.register_class(MANIENT_OT_copy_details)


def unregister() -> None:
    """Take it away again."""
    bpy.utils.unregister_class(MANIENT_OT_copy_details)
