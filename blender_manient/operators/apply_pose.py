"""Put a pose of the library on the selected hand."""

from __future__ import annotations

import bpy

from handfit_core.hand_model.poses import Pose

from ..blender_versions import property_group
from ..properties import BLEND
from ..scene.poses import (
    PROPERTY,
    forget_previews,
    kept_pose,
    posable_hands,
    pose_named,
    why_not_posable,
)
from .needs_hand import Refuses, errors_reported


class _PutsPose(Refuses):
    """An operator, in its first part, that puts a pose on the active captured hand or character."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def lacks(cls, context):
        """A hand."""
        return why_not_posable(context)

    def _put(self, context: bpy.types.Context, pose: Pose, blend: float) -> set[str]:
        hands = posable_hands(context)
        poses = [hand.towards(context, pose, blend) for hand in hands]  # all of them, before one is changed
        for hand, quats in zip(hands, poses, strict=True):
            hand.put(context, quats)
        return {"FINISHED"}


class MANIENT_OT_apply_pose(_PutsPose, bpy.types.Operator):
    bl_idname = "manient.apply_pose"
    bl_label = "Apply Pose"
    bl_description = (
        "Put the chosen pose on the fingers at the current frame: those with selected bones, else all; the "
        "wrist stays. On a captured hand this fades out over Spread, and Clear takes it back; bones that are "
        "animated get a key, others only with Auto Keying. A character's bones get a key"
    )

    pose: bpy.props.StringProperty(  # type: ignore
        name="Pose", description="A ready pose, or a pose asset of this file", options={"SKIP_SAVE"}
    )
    blend: bpy.props.FloatProperty(**BLEND)  # type: ignore

    @errors_reported
    def execute(self, context):
        """Do it."""
        return self._put(context, pose_named(self.pose or context.scene.manient.pose), self.blend)


class MANIENT_OT_apply_pose_asset(_PutsPose, bpy.types.Operator):
    bl_idname = "manient.apply_pose_asset"
    bl_label = "Apply to Hand"
    bl_description = (
        "Put this pose, which Hand Capture saved, on the selected captured hand or character, whatever its "
        "bones are called; the other side's is mirrored"
    )

    blend: bpy.props.FloatProperty(**BLEND)  # type: ignore

    @classmethod
    def lacks(cls, context):
        """An asset that is a pose, too."""
        asset = getattr(context, "asset", None)
        if asset is None or not property_group(asset.metadata, PROPERTY):
            return "Choose a pose asset that Save Pose Asset made"
        return super().lacks(context)

    @errors_reported
    def execute(self, context):
        """Do it."""
        return self._put(context, kept_pose(context.asset.metadata), self.blend)


def _in_menu(menu, context) -> None:
    if MANIENT_OT_apply_pose_asset.poll(context):
        menu.layout.operator(MANIENT_OT_apply_pose_asset.bl_idname)
        menu.layout.separator()


def register() -> None:
    """Add it to the asset browser's menu."""
    bpy.types.ASSETBROWSER_MT_context_menu.prepend(_in_menu)


def unregister() -> None:
    """Take it away, and the pictures."""
    bpy.types.ASSETBROWSER_MT_context_menu.remove(_in_menu)
    forget_previews()
