"""Save a hand's pose for Blender's pose library."""

from __future__ import annotations

import bpy
import numpy as np

from ..blender_versions import channels, new_slot
from ..scene.controls import rotations_now
from ..scene.editable import why_not_readable
from ..scene.keys import PoseKeys, write_pose_keys
from .needs_hand import OnHand, hand_in


class MANIENT_OT_save_pose_asset(OnHand, bpy.types.Operator):
    bl_idname = "manient.save_pose_asset"
    bl_label = "Save Pose Asset"
    bl_description = (
        "Keep the fingers' pose of the current frame in the pose library of this file, for any captured hand"
    )
    why_not = staticmethod(why_not_readable)  # the hand stays as it is
    anywhere = True

    asset_name: bpy.props.StringProperty(  # type: ignore
        name="Name", description="Name of the asset", default="Hand Pose"
    )
    wrist: bpy.props.BoolProperty(  # type: ignore
        name="Wrist Rotation",
        description="Keep how the wrist is turned too; its place is never kept",
        default=False,
    )

    def invoke(self, context, event):
        """Ask for the name."""
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context):
        """Make an action with one key per bone, and mark it as an asset."""
        hand = hand_in(context)
        armature, side, rig = hand.armature, hand.side, hand.rig
        action = bpy.data.actions.new(self.asset_name.strip() or "Hand Pose")
        slot = new_slot(action, armature.name)
        chosen = np.ones((1, 16), dtype=bool)
        chosen[0, 0] = self.wrist
        keys = PoseKeys(
            np.array([1.0]), rotations_now(rig)[None], np.zeros((1, 3)), chosen, np.zeros(1, dtype=bool)
        )
        write_pose_keys(rig, keys, holder=channels(action, slot, make=True))
        action.asset_mark()
        action.asset_data.description = f"Captured pose of a {side} hand"
        for tag in ("hand", side):
            action.asset_data.tags.new(tag, skip_if_exists=True)
        if not bpy.app.background:  # rendered by the graphics card
            action.asset_generate_preview()
        self.report({"INFO"}, f"Saved {action.name} with {len(rig.bones) - (not self.wrist)} bones")
        return {"FINISHED"}
