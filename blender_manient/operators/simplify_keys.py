"""Simplify: fewer keys within the panel's bounds, and all of them back."""

from __future__ import annotations

import bpy

from .. import key_preview
from ..scene.editable import why_not_keyable
from ..scene.simplify import hands_to_simplify, kept_action, restore, write
from .mixins import PollMixin, errors_reported


class KeysOperator(PollMixin):
    """An operator on the keys of the active captured hand, or of the active character's hands."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def lacks(cls, context):
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
    """Whose keys these operators change."""
    hands = hands_to_simplify(context)
    return hands[0].rig.armature if hands else None


class MANIENT_OT_simplify_keys(KeysOperator, bpy.types.Operator):
    bl_idname = "manient.simplify_keys"
    bl_label = "Simplify"
    bl_description = (
        "Leave the few keys that the motion needs within these bounds, on curves that are pleasant to edit. "
        "The action with all keys is kept: All Keys brings it back"
    )

    @errors_reported
    def execute(self, context):
        found = key_preview.found_now(context)
        armature = found[0].hand.rig.armature
        write(armature, found)
        before, after = sum(one.before for one in found), sum(one.after for one in found)
        share, worst = 100 * after / before, max(one.result.degrees for one in found)
        self.report(
            {"INFO"},
            f"{after} of {before} keys left ({share:.0f} %), at most {worst:.1f} degrees off",
        )
        return {"FINISHED"}


class MANIENT_OT_restore_keys(KeysOperator, bpy.types.Operator):
    bl_idname = "manient.restore_keys"
    bl_label = "All Keys"
    bl_description = (
        "Give this hand the action with all keys back, as it was before Simplify. What was changed since "
        "stays in an action of its own"
    )

    @staticmethod
    def why_not(armature):
        none = None if kept_action(armature) is not None else "This hand has all its keys"
        return why_not_keyable(armature) or none

    @errors_reported
    def execute(self, context):
        """Exchange the actions."""
        changed = restore(hands_to_simplify(context)[0].rig.armature)
        if changed is not None:
            self.report({"INFO"}, f"All keys are back; the changes since are kept in {changed.name}")
        return {"FINISHED"}
