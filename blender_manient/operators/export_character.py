"""Write what a character's hands do to a file for avatars."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy_extras.io_utils import ExportHelper

from ..exporters import find_exporter
from ..scene.characters import CharacterObjects, active_character
from ..scene.export import Stage, export_hands
from .needs_hand import Refuses, errors_reported

_FORMAT = "vrma"


class MANIENT_OT_export_character(Refuses, bpy.types.Operator, ExportHelper):
    bl_idname = "manient.export_character"
    bl_label = "Export VRM Animation"
    bl_description = "Write what this character's fingers and wrists do, for avatars in VRM's format"
    bl_options = {"REGISTER"}  # noqa: RUF012
    filename_ext = find_exporter(_FORMAT).suffix

    filter_glob: bpy.props.StringProperty(default=f"*{filename_ext}", options={"HIDDEN"})  # type: ignore

    @classmethod
    def lacks(cls, context):
        """A character."""
        if active_character(context) is None:
            return "Select a character first: its armature, or a mesh that it deforms"
        return None

    @errors_reported
    def execute(self, context):
        """Write the scene's frame range."""
        character = CharacterObjects.of(active_character(context))
        path: Any = Path(bpy.path.abspath(self.filepath))
        name = path.name.removesuffix(self.filename_ext)
        (file,) = export_hands([character], Stage.of_scene(context.scene), path.parent, name, _FORMAT)
        self.report({"INFO"}, f"Wrote {file.name} to {path.parent}")
        return {"FINISHED"}
