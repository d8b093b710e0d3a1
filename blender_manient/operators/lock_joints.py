"""Lock Joints: which joints refining leaves as they are."""

from __future__ import annotations

import bpy

from handfit_core.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS

from ..rigs.controls import with_moved
from ..scene.store import CapturedHand
from .mixins import HandOperator, polled_hand

_FINGER_ITEMS = tuple(
    (f.upper(), f.capitalize(), f"The joints of the {f} finger") for f in FINGERS if f != "thumb"
)


class MANIENT_OT_lock_joints(HandOperator, bpy.types.Operator):
    bl_idname = "manient.lock_joints"
    bl_label = "Lock Joints"
    bl_description = "Keep joints as they are when the hand is fitted again"
    anywhere = True

    lock: bpy.props.BoolProperty(name="Lock", default=True)  # type: ignore
    joints: bpy.props.EnumProperty(  # type: ignore
        name="Joints",
        items=(
            ("SELECTED", "Selected Bones", "The bones selected in Pose mode; in other modes all joints"),
            ("ALL", "All", "All 16 joints"),
            ("WRIST", "Wrist", "Where the hand is and how it is turned"),
            ("THUMB", "Thumb", "The joints of the thumb"),
            *_FINGER_ITEMS,
        ),
        default="SELECTED",
    )

    @classmethod
    def description(cls, _context, properties):
        if properties.lock:
            return cls.bl_description + ": the bones selected in Pose mode, else all"
        return "Let refining move joints again: the bones selected in Pose mode, else all"

    def execute(self, context):
        hand = polled_hand(context)
        chosen = self._chosen(context, hand)
        if not chosen:
            self.report({"ERROR"}, "No bone of this hand is selected: select some in Pose mode")
            return {"CANCELLED"}
        locked = list(hand.armature.manient.locked)
        for joint in chosen:
            locked[joint] = self.lock
        hand.armature.manient.locked = locked
        return {"FINISHED"}

    def _chosen(self, context, hand: CapturedHand) -> list[int]:
        if self.joints == "WRIST":
            return [0]
        finger = self.joints.lower()
        if finger in FINGER_JOINTS:
            return list(FINGER_JOINTS[finger])
        if self.joints == "ALL" or context.mode != "POSE":
            return list(range(NUM_JOINTS))
        selected = {bone.name for bone in context.selected_pose_bones or () if bone.id_data == hand.armature}
        bones = hand.rig.bones
        meant = with_moved(hand.armature, bones, selected)
        return [joint for joint, name in enumerate(bones) if name in meant]
