"""A dropped character's file: imported, and given what the captured hands do."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..exporters.imports import import_in_time, readable
from ..scene.characters import characters_in, only_character
from ..scene.store import captured_hands
from .base import SceneOperator, select_alone
from .character import MANIENT_OT_apply_to_character


class MANIENT_OT_put_on_file(SceneOperator, bpy.types.Operator):
    """Import the dropped character, and key what the captured hands do on its hands."""

    bl_label = "Put Captured Hands On It"
    bl_options = {"UNDO"}  # repeated from the panel of the last operation it would import once more

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"})

    def run(self, context):
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        new = import_in_time(Path(bpy.path.abspath(self.filepath)))
        there = [one for one in characters_in(context.scene) if one in new]
        armature = only_character(there)
        if armature is None:
            names = ", ".join(one.name for one in there[:20])
            why = f"It has several armatures ({names}): select one and press Apply to Character"
        else:
            select_alone(context, armature)
            why = MANIENT_OT_apply_to_character.poll_reason(context)
        if why is not None:
            return self._done(why, kind="WARNING")
        how = "EXEC_DEFAULT" if bpy.app.background else "INVOKE_DEFAULT"
        bpy.ops.manient.apply_to_character(how)
        return None


class MANIENT_FH_character(bpy.types.FileHandler):
    bl_label = "Put Captured Hands On It"
    bl_import_operator = MANIENT_OT_put_on_file.bl_idname
    bl_file_extensions = ";".join(readable())

    @classmethod
    def poll_drop(cls, context):
        """True where characters can appear, and where there is a hand to follow."""
        in_view = context.area is not None and context.area.type == "VIEW_3D"
        return in_view and bool(captured_hands(context.scene))
