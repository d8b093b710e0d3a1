"""Save a hand's pose for Blender's pose library, and for every other rig."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.errors import OptionError

from ..blender_versions import channels, new_slot
from ..scene.controls import rotations_now
from ..scene.keys import PoseKeys, write_pose_keys
from ..scene.poses import keep_pose, posable_hands, why_not_posable
from .mixins import PollMixin, errors_reported


class MANIENT_OT_save_pose_asset(PollMixin, bpy.types.Operator):
    bl_idname = "manient.save_pose_asset"
    bl_label = "Save Pose Asset"
    bl_description = (
        "Keep the fingers' pose of the current frame in the pose library of this file: for every captured "
        "hand and every character, left or right"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    asset_name: bpy.props.StringProperty(  # type: ignore
        name="Name", description="Name of the asset", default="Hand Pose"
    )
    wrist: bpy.props.BoolProperty(  # type: ignore
        name="Wrist Rotation",
        description="Keep how a captured hand's wrist is turned too, for Blender's own way of applying "
        "poses; its place is never kept",
        default=False,
    )

    @classmethod
    def lacks(cls, context):
        return why_not_posable(context, reading=True)

    def invoke(self, context, event):
        return context.window_manager.invoke_props_dialog(self)

    @errors_reported
    def execute(self, context):
        """Make an action with one key per bone, and mark it as an asset."""
        hands = posable_hands(context)
        if len(hands) > 1:
            raise OptionError(
                "this character has two hands: select a bone of the one whose pose is to be kept"
            )
        rig, pose = hands[0].rig, hands[0].read()
        name = self.asset_name.strip() or "Hand Pose"
        action = bpy.data.actions.new(name)
        slot = new_slot(action, rig.armature.name)
        chosen = np.ones((1, len(rig.bones)), dtype=bool)
        if rig.armature.manient.is_hand:
            chosen[0, 0] = self.wrist
        keys = PoseKeys(
            np.array([1.0]), rotations_now(rig)[None], np.zeros((1, 3)), chosen, np.zeros(1, dtype=bool)
        )
        write_pose_keys(rig, keys, holder=channels(action, slot, make=True))
        action.asset_mark()
        action.asset_data.description = f"Pose of a {pose.side} hand"
        for tag in ("hand", pose.side):
            action.asset_data.tags.new(tag, skip_if_exists=True)
        keep_pose(action, pose)
        self.report({"INFO"}, f"Saved {action.name} with {chosen.sum()} bones")
        return {"FINISHED"}
