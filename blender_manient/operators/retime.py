"""Repair of a capture whose scene has another rate by now."""

from __future__ import annotations

import bpy

from ..scene.retime import other_rate, put_rate_back, retime
from ..wording import counted
from . import edit_keypoints
from .mixins import PollMixin, errors_reported, named_hand


class MANIENT_OT_retime(PollMixin, bpy.types.Operator):
    bl_idname = "manient.retime"
    bl_label = "Retime Hand"
    bl_description = (
        "Give the hands of this capture keys for the scene's present rate, corrections included, and have "
        "the clip play in step with them"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    hand: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})  # type: ignore
    back: bpy.props.BoolProperty(  # type: ignore
        name="Rate Back",
        description="Give the scene the rate back that the hand was built for, instead",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, _context, properties):
        if properties.back:
            return "Give the scene the frame rate back that this hand was built for"
        return cls.bl_description

    @classmethod
    def lacks(cls, context):
        """A scene that may be changed, and no mode that holds on to keys."""
        return "Leave Edit Keypoints first" if edit_keypoints.running() else super().lacks(context)

    @errors_reported
    def execute(self, context):
        """Put either right."""
        collection = named_hand(context, self.hand).collection
        if not other_rate(context.scene, collection):
            self.report({"INFO"}, "The hand was built for the scene's rate: nothing was changed")
            return {"CANCELLED"}
        if self.back:
            put_rate_back(context.scene, collection)
            return {"FINISHED"}
        hands = retime(context.scene, collection)
        self.report({"INFO"}, f"{counted(len(hands), 'hand')} retimed to the scene's rate, with all keys")
        return {"FINISHED"}
