"""Poses: a library of them, for captured hands and characters."""

from __future__ import annotations

import bpy

from ..common.section import Section, sentence, split
from ..scene.poses import posed_by


class MANIENT_PT_poses(Section, bpy.types.Panel):
    bl_label = "Poses"
    bl_order = 8
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, settings = self.layout, context.scene.manient
        if posed_by(context) is None:
            sentence(layout, context, "Select a captured hand or a character to pose it", "INFO")
            return
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


def _button(layout, settings, source: str, text: str, icon: str = "NONE") -> None:
    """One that puts a pose on the frames that the row says."""
    button = layout.operator("manient.apply_pose", text=text, translate=False, icon=icon)
    button.source, button.pose, button.blend = source, settings.pose, settings.pose_blend
    button.scope, button.first, button.last = settings.pose_scope, settings.pose_first, settings.pose_last
