"""Keys: fewer of them, and a layer for changes."""

from __future__ import annotations

import bpy

from ..common.section import Section, sentence, split
from ..operators.keys import armature_of
from ..scene.actions import strip_below
from ..scene.editable import why_not_keyable
from ..scene.simplify import PARTS, Thinned, kept_action
from ..scene.store import active_hand
from ..session import key_preview


class MANIENT_PT_keys(Section, bpy.types.Panel):
    bl_label = "Keys"
    bl_parent_id = "MANIENT_PT_shape"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return armature_of(context) is not None

    def draw(self, context):
        layout, settings = self.layout, context.scene.manient
        armature = armature_of(context)
        assert armature is not None
        if strip_below(armature) is not None:
            sentence(layout, context, "Keys go into a layer on top of the motion", "NLA")
            row = layout.row(align=True)
            row.operator("manient.end_key_layer", text="Merge").merge = True
            row.operator("manient.end_key_layer", text="Remove").merge = False
            return
        why = why_not_keyable(armature)
        if why is not None:
            sentence(layout, context, why, "INFO")
            return
        column = split(layout).column(align=True)
        column.prop(settings, "keys_degrees")
        if active_hand(context) is not None:
            column.prop(settings, "keys_pixels")
        layout.prop(settings, "keys_together")
        grid = layout.grid_flow(row_major=True, columns=3, even_columns=True, align=True)
        grid.use_property_split = False
        for part in PARTS:
            grid.prop_enum(settings, "keys_parts", part.upper())
        found = key_preview.preview(context)
        sentence(layout, context, _preview_text(found), "ERROR" if isinstance(found, str) else "KEYFRAME")
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
    return f"{after} of {before} keys stay ({100 * after / before:.0f} %), at most {off} off"
