"""Controls to animate a captured hand with by hand, on top of its keys."""

from __future__ import annotations

import bpy

from ..rigs.controls import in_use
from ..scene.controls import add_controls, bake_controls, remove_controls
from ..scene.editable import why_not_bakeable, why_not_editable
from .mixins import HandOperator, errors_reported, polled_hand


def _why_no_bones(armature: bpy.types.Object) -> str | None:
    """Why its armature can get no bones or lose some: a sentence for a tooltip; None where it can."""
    why = why_not_editable(armature)
    if why is None and armature.data.library is not None:
        return "The bones of this hand are linked from another file: make them local first"
    return why


class MANIENT_OT_add_controls(HandOperator, bpy.types.Operator):
    bl_idname = "manient.add_controls"
    bl_label = "Add Controls"
    bl_description = (
        "Give the hand bones to animate it with on top of its captured keys: one for each finger, one for "
        "all fingers, one for the hand"
    )
    why_not = staticmethod(_why_no_bones)

    @classmethod
    def lacks(cls, context):
        return super().lacks(context) or ("This hand has its controls" if _has_controls(context) else None)

    @errors_reported
    def execute(self, context):
        add_controls(polled_hand(context))
        return {"FINISHED"}


class MANIENT_OT_remove_controls(HandOperator, bpy.types.Operator):
    bl_idname = "manient.remove_controls"
    bl_label = "Remove Controls"
    bl_description = "Take the controls away, with their keys, limits and shapes"
    why_not = staticmethod(_why_no_bones)

    bake: bpy.props.BoolProperty(  # type: ignore
        name="Bake",
        description="Write what the controls do into the keys first; else the hand goes back to its keys",
        default=True,
    )

    @classmethod
    def lacks(cls, context):
        return super().lacks(context) or (None if _has_controls(context) else "This hand has no controls")

    @errors_reported
    def execute(self, context):
        hand = polled_hand(context)
        if self.bake and in_use(hand.armature):
            bake_controls(hand)
        remove_controls(hand)
        return {"FINISHED"}


class MANIENT_OT_bake_controls(HandOperator, bpy.types.Operator):
    bl_idname = "manient.bake_controls"
    bl_label = "Bake Controls"
    bl_description = (
        "Write what the controls do into the hand's keys, and put the controls at rest. Dragged points go "
        "where keys change"
    )

    @staticmethod
    def why_not(armature):
        """The hand's action has to be one that can be changed, and the controls have to do something."""
        why = why_not_bakeable(armature)
        return why or (None if in_use(armature) else "The controls are at rest: there is nothing to bake")

    @errors_reported
    def execute(self, context):
        bake_controls(polled_hand(context))
        return {"FINISHED"}


def _has_controls(context: bpy.types.Context) -> bool:
    return bool(polled_hand(context).rig.controls)
