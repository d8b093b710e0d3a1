"""Mark Doubtful Frames: timeline markers where a captured hand may be wrong, or take them away."""

from __future__ import annotations

import bpy

from ..scene.markers import doubtful_ranges, filled_ranges, is_marked, mark_doubtful
from .needs_hand import named_hand, scene_is_editable


class MANIENT_OT_mark_doubtful(bpy.types.Operator):
    bl_idname = "manient.mark_doubtful"
    bl_label = "Mark Doubtful Frames"
    bl_description = "Add timeline markers where the hand may be wrong or was filled in, or remove them"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

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
        if is_marked(context.scene, hand):
            mark_doubtful(context.scene, hand, False)
            return {"FINISHED"}
        if not doubtful_ranges(hand) and not filled_ranges(hand):
            self.report({"INFO"}, f"{hand.armature.name} has no doubtful and no filled frames")
            return {"CANCELLED"}
        mark_doubtful(context.scene, hand, True)
        return {"FINISHED"}


def register() -> None:
    """Add the operator."""
    bpy.utils.register_class(MANIENT_OT_mark_doubtful)


def unregister() -> None:
    """Take it away again."""
    bpy.utils.unregister_class(MANIENT_OT_mark_doubtful)
