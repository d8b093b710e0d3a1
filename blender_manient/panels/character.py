"""Character: the motion of captured hands on the hands of any character."""

from __future__ import annotations

import bpy

from handfit_core.common.errors import HandfitError
from handfit_core.common.skeleton import FINGERS, SIDES, Side
from handfit_core.retarget.hand_map import PALM_FINGERS
from handfit_core.retarget.saved_rigs import saved_rigs

from ..common.section import EditSection, note, row_of, split
from ..common.wording import capitalised
from ..scene.characters import (
    CharacterObjects,
    active_character,
    rig_used,
    said_without_keys,
    source_of,
    sources_of,
    table_of,
    why_not_reachable,
    without_keys,
)
from ..scene.onto_character import hand_messages
from ..scene.store import CapturedHand
from ..session import hand_adjusting, live_link


class MANIENT_PT_character(EditSection, bpy.types.Panel):
    bl_label = "Character"
    bl_order = 6
    works_on = staticmethod(active_character)

    def draw(self, context):
        layout, armature = self.layout, self.works_on(context)
        layout.label(text=armature.name, icon="OUTLINER_OB_ARMATURE", translate=False)
        why = why_not_reachable(armature)
        if why is not None:
            note(layout, why, "ERROR")
        column = layout.column()
        column.enabled = why is None
        for side in SIDES:
            self._hand(context, column, armature, side)
        self._how(context, column, armature)

    def _hand(self, context, layout, armature: bpy.types.Object, side: Side) -> None:
        settings = getattr(armature.manient.character, side)
        box = layout.box().column(align=True)
        box.prop(settings, "use", text=f"{side.capitalize()} Hand")
        if not settings.use:
            return
        box.prop(settings, "source", text="", icon="VIEW_PAN")
        wanted = True
        try:
            source = source_of(armature, side, context)
            wanted = source is not None
        except HandfitError as error:
            note(box, capitalised(str(error)), "ERROR")
        else:
            text = f"No captured {side} hand is here: choose one of the other side to have it mirrored"
            if source is not None:
                text = f"Moves as {source.armature.name}" + ("" if source.side == side else ", mirrored")
            note(box, text, "BLANK1" if source else "INFO")
        for text, icon in hand_messages(armature, side, wanted):
            note(box, text, icon)

    def _how(self, context, layout, armature: bpy.types.Object) -> None:
        character = armature.manient.character
        column = split(layout.column())
        column.prop(character, "into")
        arms = [source.track.arm is not None for source in _sources(context, armature)]
        by_arms = character.arms and bool(arms) and all(arms)
        if not by_arms:
            column.prop(character, "wrist")
        if character.wrist != "FINGERS" and not by_arms:
            row = column.row(align=True)
            row.prop(character, "reference")
            row.operator("manient.mark_frame", text="", icon="MARKER_HLT")
            text = "Pose the character's hand as it is to be in this frame"
            note(column, text, "INFO")
            if character.wrist == "PLACED":
                column.prop(character, "travel", slider=True)
            column.prop(character, "smoothing")
            if character.wrist == "PLACED":
                self._offsets(column, character)
            told = hand_adjusting.message(armature)
            if told is not None:
                text, alert = told
                note(column, capitalised(text), "ERROR" if alert else "INFO")
        data = armature.animation_data
        if character.time_offset or (data is not None and (data.action is not None or len(data.nla_tracks))):
            column.prop(character, "time_offset")
            column.operator("manient.find_offset", icon="VIEWZOOM")
        column.prop(character, "contacts")
        if any(arms):
            self._arms(column, armature)
        row = row_of(layout, scale=1.3)
        row.operator("manient.apply_to_character", icon="ARMATURE_DATA").mode = "ANIMATION"
        layout.operator("manient.apply_to_character", text="Apply Pose", icon="POSE_HLT").mode = "POSE"
        done = live_link.keying_progress(armature)
        text = "Live Link" if done is None else f"Live Link: Keys {done:.0%}"
        layout.prop(character, "live", text=text, icon="LINKED", toggle=True)
        trouble = live_link.trouble(armature) if character.live else None
        if trouble is not None:
            note(layout, capitalised(trouble), "ERROR")

    def _arms(self, layout, armature: bpy.types.Object) -> None:
        character = armature.manient.character
        layout.prop(character, "arms")
        if not character.arms:
            return
        layout.prop(character, "arms_influence", slider=True)
        layout.prop(character, "arms_ease")
        layout.prop(character, "arms_turn")
        if CharacterObjects.of(armature).meshes:
            layout.prop(character, "arms_outside")

    def _offsets(self, layout, character) -> None:
        row = layout.row(align=True)
        for side in SIDES:
            if getattr(character, side).use:
                row.operator(
                    "manient.add_hand_offset", text=f"{side.capitalize()} Offset", icon="EMPTY_ARROWS"
                ).side = side


class MANIENT_PT_character_bones(EditSection, bpy.types.Panel):
    bl_label = "Bones"
    bl_parent_id = "MANIENT_PT_character"
    works_on = staticmethod(active_character)

    def draw(self, context):
        layout, armature = self.layout, self.works_on(context)
        table = context.scene.manient.hand_table
        layout.row().prop(table, "side", expand=True)
        column = layout.column()
        column.enabled = why_not_reachable(armature) is None
        rows = {"Hand": ("hand",), "Moved By": ("control",)}
        rows |= {finger.capitalize(): [f"{finger}_{joint}" for joint in (1, 2, 3)] for finger in FINGERS}
        for text, names in rows.items():  # names of bones are long: they get all of the width
            block = column.column(align=True)
            block.label(text=text)
            for name in names:
                block.prop_search(table, name, armature.data, "bones", text="")
        split(column)
        column.prop(table, "thumb_roll")
        column.prop(table, "keep_rest")
        block = column.column(align=True)
        for finger in PALM_FINGERS:
            text = "Metacarpals" if finger == PALM_FINGERS[0] else finger.capitalize()
            block.prop_search(table, f"{finger}_palm", armature.data, "bones", text=text)
        block.prop(table, "fold", slider=True)
        keyless = said_without_keys(without_keys(armature, table_of(armature, table.side)))
        if keyless:
            note(layout, capitalised(keyless), "INFO")
        column = layout.column(align=True)
        column.operator("manient.recognise_hand", icon="VIEWZOOM").side = table.side
        column.operator("manient.copy_hand_table", icon="MOD_MIRROR").side = table.side
        row = column.row(align=True)
        row.operator("manient.save_rig", icon="FILE_TICK")
        used = rig_used(armature, table.side)
        if used is not None:
            row.operator("manient.forget_rig", text="", icon="X").rig_name = used.name
        row = layout.row(align=True)
        row.operator("manient.import_rig", icon="IMPORT")
        row.operator("manient.export_rig", icon="EXPORT")
        for trouble in saved_rigs()[1]:
            note(layout, capitalised(trouble), "ERROR")


def _sources(context: bpy.types.Context, armature: bpy.types.Object) -> list[CapturedHand]:
    """Return the captured hands that a character follows; none where that is not settled."""
    try:
        return [*sources_of(armature, context).values()]
    except HandfitError:
        return []
