"""Poses: a library of them, for captured hands and characters."""

from __future__ import annotations

import bpy

from ..scene.poses import posed_by
from ..section import Section, sentence, split


class MANIENT_PT_poses(Section, bpy.types.Panel):
    bl_idname = "MANIENT_PT_poses"
    bl_label = "Poses"
    bl_order = 8
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context):
        """The pictures, and what is done with the chosen one."""
        layout, settings = self.layout, context.scene.manient
        if posed_by(context) is None:
            sentence(layout, context, "Select a captured hand or a character to pose it", "INFO")
            return
        layout.template_icon_view(settings, "pose", show_labels=True, scale=6.0, scale_popup=5.0)
        split(layout)
        layout.prop(settings, "pose_blend", slider=True)
        chosen = layout.operator(
            "manient.apply_pose", text=f"Apply {settings.pose}", translate=False, icon="POSE_HLT"
        )
        chosen.pose, chosen.blend = settings.pose, settings.pose_blend
        layout.operator("manient.save_pose_asset", icon="ASSET_MANAGER")
