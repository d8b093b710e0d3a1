"""What captured hands do, on the hands of a character; and which of its bones these are."""

from __future__ import annotations

import difflib
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from bpy_extras.io_utils import ExportHelper, ImportHelper
from mathutils import Matrix, Vector

from handfit_core.common.errors import HandfitError, HandModelError, OptionError
from handfit_core.common.files import shown
from handfit_core.common.skeleton import SIDES, other_side
from handfit_core.common.slices import map_yields
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.saved_rigs import forget_rig, read_rig, save_rig, saved_rigs, write_rig
from handfit_core.retarget.time_offset import FoundOffset

from ..common.block_reference import BlockReference
from ..common.wording import capitalised, counted
from ..scene.characters import hand_map_of, hands_to_move, keep_map, recognise_again, rig_used, table_of
from ..scene.finding_offset import finding_offset
from ..scene.onto_character import TransferOptions, putting, reading_motion, shortcomings
from ..session.properties import SIDE_ITEMS
from .base import CharacterOperator, StepsOperator, polled_character, select_alone, show_frame_again

_OPPOSITE = 0.02
"""The distance of a bone's ends from the mirror image of the opposite bone's, at most, as a share of their
distance from the middle"""
_LENGTH = 0.5
"""The length of an offset's arrows, as a share of the hand's own bone"""


class MANIENT_OT_apply_to_character(StepsOperator, CharacterOperator, bpy.types.Operator):
    """Key what the captured hands do on the hands of the selected character, whatever its bones are called
    and however they lie."""

    bl_label = "Apply to Character"
    title = "Apply to Character"
    undone = "an undo or a deletion stopped Apply to Character"

    mode: bpy.props.EnumProperty(
        name="Apply",
        items=(
            ("ANIMATION", "Animation", "All that the captured hands do"),
            ("POSE", "Pose", "Their pose in the current frame, into the present action"),
        ),
        default="ANIMATION",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll_reason(cls, context):
        if cls.bl_idname in cls.running:
            return "Motion is being applied already"
        why = super().poll_reason(context)
        if why is not None:
            return why
        try:
            hands_to_move(polled_character(context), context)
        except HandfitError as error:
            return capitalised(str(error))
        return None

    def steps(self, context) -> Generator[str, None, list]:
        armature, scene = polled_character(context), context.scene
        reference, posing = BlockReference.of("objects", armature), self.mode == "POSE"
        as_pose = {"into": "ACTION", "wrist": "FINGERS", "time_offset": 0} if posing else {}
        onto = TransferOptions.of(armature, **as_pose)
        frames = [scene.frame_current_final] if posing else None
        working = putting(armature, hands_to_move(armature, context), onto, frames)
        while True:
            try:
                done = next(working)
            except StopIteration as stop:
                return stop.value
            except ReferenceError as error:
                gone = "a hand was deleted while its motion was being applied: nothing was changed"
                raise OptionError(gone) from error
            yield f"Applying to {reference.name}  {done:.0%}"
            if reference.find() is None:
                raise OptionError(self.undone)

    def finished(self, context, result):
        show_frame_again(context)
        for sentence in shortcomings(result):
            self.report({"WARNING"}, sentence[:1].upper() + sentence[1:])
        bones, frames = sum(one.bones for one in result), max(one.frames for one in result)
        return f"Keyed {counted(bones, 'bone')} in {counted(frames, 'frame')}"


class MANIENT_OT_find_offset(StepsOperator, CharacterOperator, bpy.types.Operator):
    """Find the Time Offset at which the captured wrists move as the hands of this character, which moves
    already."""

    bl_label = "Find Offset"
    title = "Find Offset"
    undone = "an undo or a deletion stopped Find Offset"

    @classmethod
    def poll_reason(cls, context):
        return MANIENT_OT_apply_to_character.poll_reason(context)

    def steps(self, context) -> Generator[str, None, FoundOffset]:
        armature, motions = polled_character(context), []
        for hand_map, hand in hands_to_move(armature, context):
            motion = yield from map_yields(reading_motion(hand), lambda: "Reading the captured hands")
            motions.append((hand_map, motion))
        return (yield from map_yields(finding_offset(armature, motions), lambda: "Looking for the offset"))

    def finished(self, context, result):
        polled_character(context).manient.character.time_offset = result.frames
        return f"Time Offset: {result.said}"


class MANIENT_OT_recognise_hand(CharacterOperator, bpy.types.Operator):
    """Let go of the table and look for this hand's bones anew."""

    bl_label = "Recognise Again"

    side: bpy.props.EnumProperty(items=SIDE_ITEMS, options={"SKIP_SAVE"})

    def run(self, context):
        armature = polled_character(context)
        found = recognise_again(armature, self.side)
        return f"The {self.side} hand was recognised: {found.hand_map.rig}"


class MANIENT_OT_copy_hand_table(CharacterOperator, bpy.types.Operator):
    """Have the other hand's table name the bones that lie opposite to those of this one."""

    bl_label = "Copy to Other Side"

    side: bpy.props.EnumProperty(
        items=SIDE_ITEMS, description="The hand whose table is copied", options={"SKIP_SAVE"}
    )

    def run(self, context):
        armature = polled_character(context)
        keep_map(armature, opposite(armature, table_of(armature, self.side)))
        return f"The {other_side(self.side)} hand has the opposite bones now"


class MANIENT_OT_save_rig(CharacterOperator, bpy.types.Operator):
    """Keep which bones are this character's hands under a name, for every later file and batch whose
    character has bones of the same names."""

    bl_label = "Save Rig"
    bl_options = {"REGISTER"}

    rig_name: bpy.props.StringProperty(
        name="Name", description="What the rig is called; one of this name is replaced"
    )

    def invoke(self, context, event):
        armature = polled_character(context)
        used = next(filter(None, (rig_used(armature, side) for side in SIDES)), None)
        self.rig_name = armature.name if used is None else used.name
        return context.window_manager.invoke_props_dialog(self)

    def run(self, context):
        tables = _shown_tables(polled_character(context))
        name = save_rig(self.rig_name, tables).stem
        return f"Saved {name}, which is used for every character with these bones: the {_hands(tables)}"


class MANIENT_OT_forget_rig(CharacterOperator, bpy.types.Operator):
    """Remove this saved rig: bones are recognised again."""

    bl_label = "Forget Rig"
    bl_options = {"REGISTER"}

    rig_name: bpy.props.StringProperty(options={"SKIP_SAVE"})

    def invoke(self, context, event):
        return context.window_manager.invoke_confirm(self, event)

    def run(self, context):
        forget_rig(self.rig_name)
        return f"Forgot {self.rig_name}"


class MANIENT_OT_export_rig(CharacterOperator, bpy.types.Operator, ExportHelper):
    """Write which bones are this character's hands to a file, for other machines and --bones."""

    bl_label = "Export Rig"
    bl_options = {"REGISTER"}

    filename_ext = ".json"
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})

    def run(self, context):
        tables = _shown_tables(polled_character(context))
        path = Path(bpy.path.abspath(self.filepath))
        write_rig(path, tables)
        return f"Wrote the {_hands(tables)} to {path.name}"


class MANIENT_OT_import_rig(CharacterOperator, bpy.types.Operator, ImportHelper):
    """Save the rig of a file that was exported here, under the file's name, and use it for this character
    where it fits."""

    bl_label = "Import Rig"

    filename_ext = ".json"
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})

    def run(self, context):
        armature, path = polled_character(context), Path(bpy.path.abspath(self.filepath))
        tables = read_rig(path)
        there = saved_rigs()[0].get(path.stem)
        if there is not None and there.tables != tuple(tables):
            raise OptionError(
                f"there is a saved rig {shown(path.stem)} with other bones: forget it first, or rename the "
                "file"
            )
        name = save_rig(path.stem, tables).stem
        try:
            for table in tables:
                table.check(armature.data.bones)
        except HandModelError as error:
            self.report({"WARNING"}, f"{name} is saved, and does not fit {armature.name!r}: {error}")
            return {"FINISHED"}
        for table in tables:
            keep_map(armature, table)
        return f"Saved {name}, and took over the {_hands(tables)}"


class MANIENT_OT_mark_frame(CharacterOperator, bpy.types.Operator):
    """Mark the current frame: the one in which the character's hand stands as it is to stand in the captured
    pose of this frame."""

    bl_label = "Mark"

    def run(self, context):
        armature = polled_character(context)
        armature.manient.character.reference = context.scene.frame_current


def _shown_tables(armature: bpy.types.Object) -> list[HandMap]:
    """Return the tables of an armature's hands, of bones that are there. Raises HandModelError for none."""
    tables = [table for side in SIDES if (table := table_of(armature, side)).mapped]
    if not tables:
        raise HandModelError("neither hand has a bone yet: choose some in the table first")
    for table in tables:
        table.check(armature.data.bones)
    return tables


def _hands(tables: Sequence[HandMap]) -> str:
    return " and the ".join(f"{table.side} hand" for table in tables)


def opposite(armature: bpy.types.Object, hand_map: HandMap) -> HandMap:
    """Return the table of the other hand: of the bones that lie where a mirror at x = 0 shows those of this
    one, the ones whose names are the most alike. Raises HandModelError where a bone has none."""
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


class MANIENT_OT_add_hand_offset(CharacterOperator, bpy.types.Operator):
    """Select the empty that moves this hand's whole motion, or add it where the hand is now: drag it, and the
    hand is so much farther there in every frame. Delete it to have the hand back."""

    bl_label = "Offset"

    side: bpy.props.EnumProperty(items=SIDE_ITEMS, options={"SKIP_SAVE"})

    def run(self, context):
        armature = polled_character(context)
        own = getattr(armature.manient.character, self.side)
        handle = own.offset
        if handle is None or not handle.users_collection:
            handle = _handle(armature, hand_map_of(armature, self.side).bones[0], self.side)
            for collection in armature.users_collection:
                collection.objects.link(handle)
            own.offset = handle
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        select_alone(context, handle)


def _handle(armature: bpy.types.Object, bone: str, side: str) -> bpy.types.Object:
    """Return an empty that begins where a bone is shown, and whose location counts from there in the
    armature's space."""
    shown = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones[bone]
    handle = bpy.data.objects.new(f"{armature.name} {side} hand offset", None)
    handle.empty_display_type = "ARROWS"
    handle.empty_display_size = _LENGTH * float(np.linalg.norm(shown.vector))
    handle.show_in_front = handle.show_name = True
    handle.parent, handle.matrix_parent_inverse = armature, Matrix.Translation(shown.head)
    handle.lock_rotation = handle.lock_scale = (True, True, True)
    return handle
