"""Which bones of a character are its hands: recognised anew, copied to the other side, kept in files."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy_extras.io_utils import ExportHelper, ImportHelper
from mathutils import Vector

from handfit_core.errors import HandModelError
from handfit_core.files import shown, written_whole
from handfit_core.retarget.hand_map import HandMap, read_preset, to_preset
from handfit_core.skeleton import SIDES, other_side

from ..properties import SIDE_ITEMS
from ..scene.characters import active_character, keep_map, recognise_again, table_of, why_not_reachable
from .mixins import PollMixin, errors_reported

_OPPOSITE = 0.02
"""How far from the mirror image of a bone's ends those of the opposite one lie at most, as a share of its
distance from the middle"""


class CharacterOperator(PollMixin):
    """The poll and the options of an operator that works on the selected character."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def lacks(cls, context):
        armature = active_character(context)
        if armature is None:
            return "Select a character first: its armature, or a mesh that it deforms"
        return why_not_reachable(armature)


class MANIENT_OT_recognise_hand(CharacterOperator, bpy.types.Operator):
    bl_idname = "manient.recognise_hand"
    bl_label = "Recognise Again"
    bl_description = "Let go of the table and look for this hand's bones anew"

    side: bpy.props.EnumProperty(items=SIDE_ITEMS, options={"SKIP_SAVE"})  # type: ignore

    @errors_reported
    def execute(self, context):
        armature: Any = active_character(context)
        found = recognise_again(armature, self.side)
        self.report({"INFO"}, f"The {self.side} hand was recognised: {found.hand_map.rig}")
        return {"FINISHED"}


class MANIENT_OT_copy_hand_table(CharacterOperator, bpy.types.Operator):
    bl_idname = "manient.copy_hand_table"
    bl_label = "Copy to Other Side"
    bl_description = "Have the other hand's table name the bones that lie opposite to those of this one"

    side: bpy.props.EnumProperty(  # type: ignore
        items=SIDE_ITEMS, description="The hand whose table is copied", options={"SKIP_SAVE"}
    )

    @errors_reported
    def execute(self, context):
        armature: Any = active_character(context)
        keep_map(armature, opposite(armature, table_of(armature, self.side)))
        self.report({"INFO"}, f"The {other_side(self.side)} hand has the opposite bones now")
        return {"FINISHED"}


class MANIENT_OT_save_hand_preset(CharacterOperator, bpy.types.Operator, ExportHelper):
    bl_idname = "manient.save_hand_preset"
    bl_label = "Save Preset"
    bl_description = "Write which bones are this character's hands to a file, for others of its kind"
    bl_options = {"REGISTER"}  # noqa: RUF012

    filename_ext = ".json"
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})  # type: ignore

    @errors_reported
    def execute(self, context):
        armature: Any = active_character(context)
        tables = [table for side in SIDES if (table := table_of(armature, side)).mapped]
        if not tables:
            raise HandModelError("neither hand has a bone yet: choose some in the table first")
        path = Path(bpy.path.abspath(self.filepath))
        with written_whole(path, read_preset) as beside:
            beside.write_text(to_preset(tables), encoding="utf-8")
        self.report({"INFO"}, f"Wrote the {_hands(tables)} to {path.name}")
        return {"FINISHED"}


class MANIENT_OT_load_hand_preset(CharacterOperator, bpy.types.Operator, ImportHelper):
    bl_idname = "manient.load_hand_preset"
    bl_label = "Load Preset"
    bl_description = "Read which bones are this character's hands from a file that was saved here"

    filename_ext = ".json"
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})  # type: ignore

    @errors_reported
    def execute(self, context):
        armature: Any = active_character(context)
        path = Path(bpy.path.abspath(self.filepath))
        tables = read_preset(path)
        try:
            for table in tables:
                table.check(armature.data.bones)
        except HandModelError as error:
            raise HandModelError(f"{shown(path)}: {error}") from error
        for table in tables:
            keep_map(armature, table)
        self.report({"INFO"}, f"Took over the {_hands(tables)} from {path.name}")
        return {"FINISHED"}


class MANIENT_OT_mark_frame(CharacterOperator, bpy.types.Operator):
    bl_idname = "manient.mark_frame"
    bl_label = "Mark"
    bl_description = (
        "Mark the current frame: the one in which the character's hand stands as it is to stand in the "
        "captured pose of this frame"
    )

    def execute(self, context):
        armature: Any = active_character(context)
        armature.manient.character.reference = context.scene.frame_current
        return {"FINISHED"}


def _hands(tables: Sequence[HandMap]) -> str:
    return " and the ".join(f"{table.side} hand" for table in tables)


def opposite(armature: bpy.types.Object, hand_map: HandMap) -> HandMap:
    """The table of the other hand: of the bones that lie where a mirror at x = 0 shows those of this one, the
    ones whose names are the most alike. Raises HandModelError where a bone has none."""
    bones = armature.data.bones
    hand_map.check(bones)

    def mirrored(name: str) -> str:
        if not name:
            return ""
        ends = [Vector((-end.x, end.y, end.z)) for end in (bones[name].head_local, bones[name].tail_local)]
        within = _OPPOSITE * abs(ends[0].x)
        there = [
            bone.name
            for bone in bones
            if (bone.head_local - ends[0]).length <= within and (bone.tail_local - ends[1]).length <= within
        ]
        if not there:
            raise HandModelError(
                f"no bone lies opposite to {shown(name)!r}: choose those of the {other_side(hand_map.side)} "
                "hand in its table"
            )
        likeness = [difflib.SequenceMatcher(None, name, other).ratio() for other in there]
        return there[int(np.argmax(likeness))]

    return replace(
        hand_map,
        side=other_side(hand_map.side),
        bones=tuple(map(mirrored, hand_map.bones)),
        palm=tuple(map(mirrored, hand_map.palm)),  # type: ignore[arg-type]
        control=mirrored(hand_map.control),
    )
