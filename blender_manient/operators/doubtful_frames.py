"""Where a captured hand may be wrong: markers, jumps between such frames, and the worst of all."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.errors import OptionError

from ..scene.confidence import (
    doubtful_ranges,
    errors_of,
    filled_ranges,
    is_marked,
    mark_doubtful,
    next_doubtful,
)
from ..scene.store import scene_frames
from .mixins import PollMixin, errors_reported, named_hand


class _NamedHandOperator(PollMixin):
    """What works on the hand that a button names, in a scene that may be changed."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    hand: bpy.props.StringProperty(  # type: ignore
        name="Hand",
        description="The captured hand's armature (empty: the active object's)",
        options={"HIDDEN"},
    )


class MANIENT_OT_mark_doubtful(_NamedHandOperator, bpy.types.Operator):
    bl_idname = "manient.mark_doubtful"
    bl_label = "Mark Doubtful Frames"
    bl_description = "Add timeline markers where the hand may be wrong or was filled in, or remove them"

    @errors_reported
    def execute(self, context):
        hand = named_hand(context, self.hand)
        if is_marked(context.scene, hand):
            mark_doubtful(context.scene, hand, False)
            return {"FINISHED"}
        if not doubtful_ranges(hand) and not filled_ranges(hand):
            self.report({"INFO"}, f"{hand.armature.name} has no doubtful and no filled frames")
            return {"CANCELLED"}
        mark_doubtful(context.scene, hand, True)
        return {"FINISHED"}


class MANIENT_OT_jump_doubtful(_NamedHandOperator, bpy.types.Operator):
    bl_idname = "manient.jump_doubtful"
    bl_label = "Jump to Doubtful Frame"
    bl_description = "Go to where the next or previous frames begin in which the hand may be wrong"

    direction: bpy.props.EnumProperty(  # type: ignore
        name="Direction",
        items=(
            ("PREVIOUS", "Previous", "Go to the doubtful frames before this one"),
            ("NEXT", "Next", "Go to the doubtful frames after this one"),
        ),
        default="NEXT",
    )

    @errors_reported
    def execute(self, context):
        hand = named_hand(context, self.hand)
        frame = next_doubtful(hand, context.scene.frame_current, self.direction)
        if frame is None:
            where = "after" if self.direction == "NEXT" else "before"
            self.report({"INFO"}, f"No doubtful frames of {hand.armature.name} {where} this one")
            return {"CANCELLED"}
        context.scene.frame_set(frame)
        return {"FINISHED"}


class MANIENT_OT_jump_worst(_NamedHandOperator, bpy.types.Operator):
    bl_idname = "manient.jump_worst"
    bl_label = "Jump to Worst Frame"
    bl_description = "Go to the frame in which the hand is likely to be farthest off"

    @classmethod
    def description(cls, context, properties):
        """The tooltip with the hand's figures."""
        try:
            hand = named_hand(context, properties.hand)
        except OptionError:
            return cls.bl_description
        if not hand.track.detected.any():
            return cls.bl_description
        pixels = float(np.mean(hand.track.reprojection_error[hand.track.detected]))
        scale = errors_of(hand).scale
        good, fair = scale.said(scale.good_below), scale.said(scale.fair_below)
        return (
            f"The hand's points lie {pixels:.1f} px from those found in the picture, in the mean. "
            f"{scale.title}: less than {good} is good, {fair} or more is poor. Click to go to the worst frame"
        )

    @errors_reported
    def execute(self, context):
        hand = named_hand(context, self.hand)
        errors = errors_of(hand)
        if errors.mean is None:
            raise OptionError("No captured hand with points in a picture: select one")
        frame = float(scene_frames(hand.collection, hand.take)[np.nanargmax(errors.frames)])
        context.scene.frame_set(int(np.floor(frame)), subframe=frame - np.floor(frame))
        return {"FINISHED"}
