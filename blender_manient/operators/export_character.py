"""Write a character, as it moves, to a file for other programs."""

from __future__ import annotations

from typing import Any

import bpy

from ..properties import EXPORT_FORMATS
from ..scene.characters import CharacterObjects, active_character, why_not_written
from .export_hand import ExportOperator
from .mixins import PollMixin


class MANIENT_OT_export_character(ExportOperator, PollMixin, bpy.types.Operator):
    bl_idname = "manient.export_character"
    bl_label = "Export Character"
    bl_description = (
        "Write the active character, as it moves now, to a file: the bones that deform it, without its "
        "controls, or for avatars what its fingers and wrists do"
    )
    character = True

    file_format: bpy.props.EnumProperty(name="Format", items=EXPORT_FORMATS, default="vrma")  # type: ignore
    meshes: bpy.props.BoolProperty(  # type: ignore
        name="Meshes",
        description="Write what the character deforms or carries and renders show",
        default=True,
    )

    @classmethod
    def lacks(cls, context):
        armature = active_character(context)
        if armature is None:
            return "Select a character first: its armature, or a mesh that it deforms"
        return why_not_written(armature, context.scene)

    def _fill_in(self, context):
        if self.properties.is_property_set(
            "file_format"
        ):  # scripts that name none want VRM, as they always did
            super()._fill_in(context)

    def _title(self, context):
        armature: Any = active_character(context)
        return armature.name

    def _draw_own(self, layout):
        if self._exporter.bakes:
            layout.prop(self, "meshes")

    def _chosen(self, context):
        character = CharacterObjects.of(active_character(context))
        return [character if self.meshes else CharacterObjects(character.armature, ())]

    def _keyed(self, chosen):
        animation = chosen[0].armature.animation_data
        if animation is None:
            return []
        strips = [strip for track in animation.nla_tracks for strip in track.strips]
        frames = [frame for strip in strips for frame in (strip.frame_start, strip.frame_end)]
        return [*frames, *(animation.action.frame_range if animation.action is not None else ())]
