"""A handle in the viewport that moves the whole motion of a character's hand."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ..properties import SIDE_ITEMS
from ..scene.characters import active_character, hand_map_of
from .character_hands import CharacterOperator
from .mixins import errors_reported, select_alone

_LENGTH = 0.5
"""of the handle's arrows, as a share of the hand's own bone"""


class MANIENT_OT_add_hand_offset(CharacterOperator, bpy.types.Operator):
    bl_idname = "manient.add_hand_offset"
    bl_label = "Offset"
    bl_description = (
        "Select the empty that moves this hand's whole motion, or add it where the hand is now: drag it, and "
        "the hand is so much farther there in every frame. Delete it to have the hand back"
    )

    side: bpy.props.EnumProperty(items=SIDE_ITEMS, options={"SKIP_SAVE"})  # type: ignore

    @errors_reported
    def execute(self, context):
        armature: Any = active_character(context)
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
        return {"FINISHED"}


def _handle(armature: bpy.types.Object, bone: str, side: str) -> bpy.types.Object:
    """An empty that begins where a bone is shown, and whose location counts from there in the armature's
    space."""
    shown = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones[bone]
    handle = bpy.data.objects.new(f"{armature.name} {side} hand offset", None)
    handle.empty_display_type = "ARROWS"
    handle.empty_display_size = _LENGTH * float(np.linalg.norm(shown.vector))
    handle.show_in_front = handle.show_name = True
    handle.parent, handle.matrix_parent_inverse = armature, Matrix.Translation(shown.head)
    handle.lock_rotation = handle.lock_scale = (True, True, True)
    return handle
