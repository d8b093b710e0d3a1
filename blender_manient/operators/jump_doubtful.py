"""Jump to Doubtful Frame: the next or previous range of frames in which a captured hand may be wrong."""

from __future__ import annotations

import bpy

from ..scene.markers import next_doubtful
from .needs_hand import named_hand, scene_is_editable


class MANIENT_OT_jump_doubtful(bpy.types.Operator):
    bl_idname = "manient.jump_doubtful"
    bl_label = "Jump to Doubtful Frame"
    bl_description = "Go to where the next or previous frames begin in which the hand may be wrong"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    direction: bpy.props.EnumProperty(  # type: ignore
        name="Direction",
        items=(
            ("PREVIOUS", "Previous", "Go to the doubtful frames before this one"),
            ("NEXT", "Next", "Go to the doubtful frames after this one"),
        ),
        default="NEXT",
    )
    hand: bpy.props.StringProperty(  # type: ignore
        name="Hand",
        description="The captured hand's armature (empty: the active object's)",
        options={"HIDDEN"},
    )

    @classmethod
    def poll(cls, context):
        return scene_is_editable(cls, context)

    def execute(self, context):
        hand = named_hand(context, self.hand)
        if hand is None:
            self.report({"ERROR"}, "No captured hand: select a hand that keeps its take")
            return {"CANCELLED"}
        frame = next_doubtful(hand, context.scene.frame_current, self.direction)
        if frame is None:
            where = "after" if self.direction == "NEXT" else "before"
            self.report({"INFO"}, f"No doubtful frames of {hand.armature.name} {where} this one")
            return {"CANCELLED"}
        context.scene.frame_set(frame)
        return {"FINISHED"}


def register() -> None:
    """Add the operator."""
    bpy.utils.register_class(MANIENT_OT_jump_doubtful)


def unregister() -> None:
    """Take it away again."""
    bpy.utils.unregister_class(MANIENT_OT_jump_doubtful)
