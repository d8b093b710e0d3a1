"""Pose: a library of poses, for captured hands and characters, and controls for posing a hand."""

from __future__ import annotations

import bpy

from ..common.section import EditSection, split
from ..scene.poses import posed_by
from ..scene.store import CapturedHand, active_hand


class MANIENT_PT_poses(EditSection, bpy.types.Panel):
    bl_label = "Pose"
    bl_order = 3
    works_on = staticmethod(posed_by)

    def draw(self, context):
        layout, settings, hand = self.layout, context.scene.manient, active_hand(context)
        layout.template_icon_view(settings, "pose", show_labels=True, scale=6.0, scale_popup=5.0)
        row = layout.row(align=True)
        row.prop(settings, "pose_scope", text="")
        if settings.pose_scope == "RANGE":
            row.prop(settings, "pose_first", text="")
            row.prop(settings, "pose_last", text="")
        row.prop(settings, "spread", text="±" if settings.pose_scope == "RANGE" else None)
        split(layout.column()).prop(settings, "pose_blend", slider=True)
        _button(layout, settings, "LIBRARY", f"Apply {settings.pose}", "POSE_HLT")
        row = layout.row(align=True)
        _button(row, settings, "OWN", "This Pose")
        _button(row, settings, "OTHER", "Mirrored")
        _button(row, settings, "REST", "Reset")
        layout.operator("manient.save_pose_asset", icon="ASSET_MANAGER")
        if hand is not None:
            _controls(layout.column(align=True), hand)


def _controls(column, hand: CapturedHand) -> None:
    if not hand.rig.controls:
        column.operator("manient.add_controls", icon="POSE_HLT")
        return
    row = column.row(align=True)
    row.prop(hand.armature.manient, "use_controls", toggle=True)
    row.prop(hand.armature.manient, "limits", toggle=True)
    column.operator("manient.bake_controls", icon="ACTION")
    column.operator("manient.remove_controls", icon="X")


def _button(layout, settings, source: str, text: str, icon: str = "NONE") -> None:
    """Draw a button that puts a pose on the frames that the row says."""
    button = layout.operator("manient.apply_pose", text=text, translate=False, icon=icon)
    button.source, button.pose, button.blend = source, settings.pose, settings.pose_blend
    button.scope, button.first, button.last = settings.pose_scope, settings.pose_first, settings.pose_last
