"""The keys of a captured hand, or of a character's: fewer of them, all of them again, a layer on top."""

from __future__ import annotations

import bpy

from ..scene.actions import strip_below
from ..scene.editable import why_not_editable, why_not_keyable
from ..scene.layer import add_layer, end_layer
from ..scene.simplify import hands_to_simplify, kept_action, restore, write
from ..session import key_preview
from .base import ManientOperator


class _KeysOperator(ManientOperator):
    """The base of operators on the keys of the active captured hand, or of the active character's hands."""

    @classmethod
    def poll_reason(cls, context):
        armature = armature_of(context)
        if armature is None:
            return "Select a captured hand, or a character whose hands are known"
        if context.mode not in {"OBJECT", "POSE"}:
            return "Go to Object or Pose Mode first"
        return cls.why_not(armature)

    @staticmethod
    def why_not(armature: bpy.types.Object) -> str | None:
        return why_not_keyable(armature)


def armature_of(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the armature whose keys these operators change; None where there is none."""
    hands = hands_to_simplify(context)
    return hands[0].rig.armature if hands else None


class MANIENT_OT_simplify_keys(_KeysOperator, bpy.types.Operator):
    """Leave the few keys that the motion needs within these bounds, on curves that are pleasant to edit. The
    action with all keys is kept: All Keys brings it back."""

    bl_label = "Simplify"

    def run(self, context):
        found = key_preview.found_now(context)
        write(found[0].hand.rig.armature, found)
        before, after = sum(one.before for one in found), sum(one.after for one in found)
        share, worst = 100 * after / before, max(one.result.degrees for one in found)
        return f"{after} of {before} keys left ({share:.0f} %), at most {worst:.1f} degrees off"


class MANIENT_OT_restore_keys(_KeysOperator, bpy.types.Operator):
    """Give this hand the action with all keys back, as it was before Simplify. What was changed since stays
    in an action of its own."""

    bl_label = "All Keys"

    @staticmethod
    def why_not(armature):
        none = None if kept_action(armature) is not None else "This hand has all its keys"
        return why_not_keyable(armature) or none

    def run(self, context):
        changed = restore(hands_to_simplify(context)[0].rig.armature)
        return changed and f"All keys are back; the changes since are kept in {changed.name}"


class MANIENT_OT_add_key_layer(_KeysOperator, bpy.types.Operator):
    """Put the motion below, as a strip in the NLA, and key changes in an empty action on top, which is added
    to it: the motion's own keys stay as they are."""

    bl_label = "Layer for Changes"

    def run(self, context):
        return f"Keys go into {add_layer(armature_of(context)).name} now"


class MANIENT_OT_end_key_layer(_KeysOperator, bpy.types.Operator):
    """Make the motion the active action again."""

    bl_label = "End Layer"

    merge: bpy.props.BoolProperty(
        name="Merge", description="Put the layer's changes into the motion's keys", default=True
    )

    @classmethod
    def description(cls, _context, properties):
        if properties.merge:
            return "Put the layer's changes into the motion's keys"
        return "Take the layer and its changes away; the motion is as it was"

    @staticmethod
    def why_not(armature):
        none = None if strip_below(armature) is not None else "This hand has no layer on top of its motion"
        return why_not_editable(armature) or none

    def run(self, context):
        end_layer(armature_of(context), merge=self.merge)
