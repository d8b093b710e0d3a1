"""The buttons of the list of captures: hide all but the active one, and take one out of the scene."""

from __future__ import annotations

import bpy

from handfit_core.errors import OptionError

from ..scene import captures
from .mixins import PollMixin, errors_reported


class MANIENT_OT_hide_captures(PollMixin, bpy.types.Operator):
    bl_idname = "manient.hide_captures"
    bl_label = "Hide Others"
    bl_description = "Hide all captures but the active one, in viewports and in renders"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    hide: bpy.props.BoolProperty(name="Hide", default=True, options={"SKIP_SAVE"})  # type: ignore

    @classmethod
    def description(cls, _context, properties):
        return cls.bl_description if properties.hide else "Show all captures of this scene again"

    @classmethod
    def lacks(cls, context):
        return super().lacks(context) or (
            None if len(captures.captures(context.scene)) > 1 else "There are no other captures in this scene"
        )

    def execute(self, context):
        captures.hide_others(context.scene, self.hide)
        return {"FINISHED"}


class MANIENT_OT_remove_capture(PollMixin, bpy.types.Operator):
    bl_idname = "manient.remove_capture"
    bl_label = "Remove Capture"
    bl_description = (
        "Remove this capture from the scene: its hands with their keys, its camera, lights and picture. "
        "Your own objects in its collection stay"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    capture: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})  # type: ignore

    @errors_reported
    def execute(self, context):
        found = [c for c in captures.captures(context.scene) if c.name == self.capture]
        if not found:
            raise OptionError(f"The capture {self.capture} is not in this scene any more")
        captures.remove(context.scene, found[0])
        self.report({"INFO"}, f"{self.capture} was removed")
        return {"FINISHED"}
