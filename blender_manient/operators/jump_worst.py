"""Jump to Worst Frame: where a captured hand misses the detected points most. Its tooltip has the figures."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.fit_quality import FAIR_BELOW, GOOD_BELOW, relative_errors

from ..scene.store import scene_frames
from .needs_hand import named_hand, scene_is_editable


class MANIENT_OT_jump_worst(bpy.types.Operator):
    bl_idname = "manient.jump_worst"
    bl_label = "Jump to Worst Frame"
    bl_description = "Go to the frame in which the hand lies farthest from the points found in the picture"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    hand: bpy.props.StringProperty(  # type: ignore
        name="Hand",
        description="The captured hand's armature (empty: the active object's)",
        options={"HIDDEN"},
    )

    @classmethod
    def description(cls, context, properties):
        """The tooltip."""
        hand = named_hand(context, properties.hand)
        if hand is None or not hand.track.detected.any():
            return cls.bl_description
        pixels = float(np.mean(hand.track.reprojection_error[hand.track.detected]))
        return (
            f"The hand's points lie {pixels:.1f} px from those found in the picture, in the mean. Of the "
            f"hand's length, less than {100 * GOOD_BELOW:g} % is good and {100 * FAIR_BELOW:g} % or more is "
            "poor. Click to go to the worst frame"
        )

    @classmethod
    def poll(cls, context):
        return scene_is_editable(cls, context)

    def execute(self, context):
        hand = named_hand(context, self.hand)
        if hand is None or not hand.track.detected.any():
            self.report({"ERROR"}, "No captured hand with points in a picture: select one")
            return {"CANCELLED"}
        errors = relative_errors(hand.track, hand.take.intrinsics)
        frame = float(scene_frames(hand.collection, hand.take)[np.nanargmax(errors)])
        context.scene.frame_set(int(np.floor(frame)), subframe=frame - np.floor(frame))
        return {"FINISHED"}


def register() -> None:
    """Add the operator."""
    bpy.utils.register_class(MANIENT_OT_jump_worst)


def unregister() -> None:
    """Take it away again."""
    bpy.utils.unregister_class(MANIENT_OT_jump_worst)
