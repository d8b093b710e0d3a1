"""The list of captures and their hands: which are shown, where they may be wrong, at which rate they play."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.common.errors import OptionError

from ..common import screen
from ..common.wording import counted
from ..scene import captures
from ..scene.confidence import (
    doubtful_ranges,
    errors_of,
    filled_ranges,
    is_marked,
    mark_doubtful,
    next_doubtful,
)
from ..scene.retime import other_rate, put_rate_back, retime
from ..scene.store import hand_of, scene_frames
from .base import ManientOperator, ModalOperator, SceneOperator, named_hand, select_alone


class MANIENT_OT_hide_captures(SceneOperator, bpy.types.Operator):
    """Hide all captures but the active one, in viewports and in renders."""

    bl_label = "Hide Others"

    hide: bpy.props.BoolProperty(name="Hide", default=True, options={"SKIP_SAVE"})

    @classmethod
    def description(cls, _context, properties):
        return cls.bl_description if properties.hide else "Show all captures of this scene again"

    @classmethod
    def poll_reason(cls, context):
        return super().poll_reason(context) or (
            None if len(captures.captures(context.scene)) > 1 else "There are no other captures in this scene"
        )

    def run(self, context):
        captures.hide_others(context.scene, self.hide)


class MANIENT_OT_switch_view(SceneOperator, bpy.types.Operator):
    """Look through the active capture's other camera, at its own picture."""

    bl_label = "Switch View"

    @classmethod
    def poll_reason(cls, context):
        lacking = super().poll_reason(context)
        if lacking:
            return lacking
        capture = captures.active_capture(context.scene)
        two = capture is not None and len(captures.cameras_of(capture)) > 1
        return None if two else "The active capture has one camera: capture it with a Second View"

    def run(self, context):
        capture = captures.active_capture(context.scene)
        assert capture is not None
        captures.switch_view(context.scene, capture)
        screen.look_through_camera(context)


class MANIENT_OT_remove_capture(SceneOperator, bpy.types.Operator):
    """Remove this capture from the scene: its hands with their keys, its camera, lights and picture. Your own
    objects in its collection stay."""

    bl_label = "Remove Capture"

    capture: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})

    def run(self, context):
        found = [c for c in captures.captures(context.scene) if c.name == self.capture]
        if not found:
            raise OptionError(f"The capture {self.capture} is not in this scene any more")
        captures.remove(context.scene, found[0])
        return f"{self.capture} was removed"


class MANIENT_OT_select_hand(ManientOperator, bpy.types.Operator):
    """Make this hand the active object."""

    bl_label = "Select Hand"

    hand: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})

    def run(self, context):
        armature = context.scene.objects.get(self.hand)
        if armature is None or hand_of(armature) is None:
            raise OptionError(f"The hand {self.hand} is not in this scene any more")
        if not armature.visible_get():
            raise OptionError(f"The hand {self.hand} is hidden: show it first")
        if context.mode != "OBJECT" and context.active_object is not armature:
            bpy.ops.object.mode_set(mode="OBJECT")
        select_alone(context, armature)


class _NamedHandOperator(SceneOperator):
    """The base of operators on the hand that a button names, in a scene that may be changed."""

    hand: bpy.props.StringProperty(
        name="Hand",
        description="The captured hand's armature (empty: the active object's)",
        options={"HIDDEN"},
    )


class MANIENT_OT_mark_doubtful(_NamedHandOperator, bpy.types.Operator):
    """Add timeline markers where the hand may be wrong or was filled in, or remove them."""

    bl_label = "Mark Doubtful Frames"

    def run(self, context):
        hand = named_hand(context, self.hand)
        marked = is_marked(context.scene, hand)
        if not marked and not doubtful_ranges(hand) and not filled_ranges(hand):
            return self._nothing_done(f"{hand.armature.name} has no doubtful and no filled frames")
        mark_doubtful(context.scene, hand, not marked)


class MANIENT_OT_jump_doubtful(_NamedHandOperator, bpy.types.Operator):
    """Go to where the next or previous frames begin in which the hand may be wrong."""

    bl_label = "Jump to Doubtful Frame"

    direction: bpy.props.EnumProperty(
        name="Direction",
        items=(
            ("PREVIOUS", "Previous", "Go to the doubtful frames before this one"),
            ("NEXT", "Next", "Go to the doubtful frames after this one"),
        ),
        default="NEXT",
    )

    def run(self, context):
        hand = named_hand(context, self.hand)
        frame = next_doubtful(hand, context.scene.frame_current, self.direction)
        if frame is None:
            where = "after" if self.direction == "NEXT" else "before"
            return self._nothing_done(f"No doubtful frames of {hand.armature.name} {where} this one")
        context.scene.frame_set(frame)


class MANIENT_OT_jump_worst(_NamedHandOperator, bpy.types.Operator):
    """Go to the frame in which the hand is likely to be farthest off."""

    bl_label = "Jump to Worst Frame"

    @classmethod
    def description(cls, context, properties):
        """Return the tooltip with the hand's figures."""
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

    def run(self, context):
        hand = named_hand(context, self.hand)
        errors = errors_of(hand)
        if errors.mean is None:
            raise OptionError("No captured hand with points in a picture: select one")
        frame = float(scene_frames(hand.collection, hand.take)[np.nanargmax(errors.frames)])
        context.scene.frame_set(int(np.floor(frame)), subframe=frame - np.floor(frame))


class MANIENT_OT_retime(SceneOperator, bpy.types.Operator):
    """Give the hands of this capture keys for the scene's present rate, corrections included, and have the
    clip play in step with them."""

    bl_label = "Retime Hand"

    hand: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})
    back: bpy.props.BoolProperty(
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
    def poll_reason(cls, context):
        return (
            "Leave Edit Keypoints first"
            if "manient.edit_keypoints" in ModalOperator.running
            else super().poll_reason(context)
        )

    def run(self, context):
        collection = named_hand(context, self.hand).collection
        if not other_rate(context.scene, collection):
            return self._nothing_done("The hand was built for the scene's rate: nothing was changed")
        if self.back:
            return put_rate_back(context.scene, collection)
        hands = retime(context.scene, collection)
        return f"{counted(len(hands), 'hand')} retimed to the scene's rate, with all keys"
