"""Motion: the hand's as a whole, fewer keys, and a layer for changes."""

from __future__ import annotations

import bpy

from ..common.section import EditSection, note, split
from ..operators.keys import armature_of
from ..scene.actions import strip_below
from ..scene.editable import why_not_keyable
from ..scene.simplify import PARTS, Thinned, kept_action
from ..scene.store import active_hand
from ..session import key_preview


class MANIENT_PT_motion(EditSection, bpy.types.Panel):
    bl_label = "Motion"
    bl_order = 4
    works_on = staticmethod(armature_of)

    def draw(self, context):
        layout, settings = self.layout, context.scene.manient
        armature, hand = self.works_on(context), active_hand(context)
        if hand is not None:
            row = layout.row(align=True)
            row.operator("manient.mirror_hand", icon="MOD_MIRROR")
            row.operator("manient.apply_take", icon="IMPORT")
        if strip_below(armature) is not None:
            note(layout, "Keys go into a layer on top of the motion", "NLA")
            row = layout.row(align=True)
            row.operator("manient.end_key_layer", text="Merge").merge = True
            row.operator("manient.end_key_layer", text="Remove").merge = False
            return
        why = why_not_keyable(armature)
        if why is not None:
            note(layout, why, "INFO")
            return
        column = split(layout.column(align=True))
        column.prop(settings, "keys_degrees")
        if hand is not None:
            column.prop(settings, "keys_pixels")
        column.prop(settings, "keys_together")
        grid = layout.grid_flow(row_major=True, columns=3, even_columns=True, align=True)
        for part in PARTS:
            grid.prop_enum(settings, "keys_parts", part.upper())
        found = key_preview.preview(context)
        note(layout, _preview_text(found), "ERROR" if isinstance(found, str) else "KEYFRAME")
        layout.operator("manient.simplify_keys", icon="FCURVE")
        if kept_action(armature) is not None:
            layout.operator("manient.restore_keys", icon="LOOP_BACK")
        layout.operator("manient.add_key_layer", icon="NLA_PUSHDOWN")


def _preview_text(found: list[Thinned] | str | None) -> str:
    if found is None:
        return "Looking which keys are needed ..."
    if isinstance(found, str):
        return found
    before, after = sum(one.before for one in found), sum(one.after for one in found)
    off = f"{max(one.result.degrees for one in found):.1f} degrees"
    pixels = [one.result.pixels for one in found if one.result.pixels is not None]
    if pixels:
        off += f", {max(pixels):.1f} pixels"
    return f"{after} of {before} keys stay ({100 * after / before:.0f} %). At most {off} off"
