"""A layer for changes by hand on top of the motion, and its end."""

from __future__ import annotations

import bpy

from ..scene.actions import strip_below
from ..scene.editable import why_not_editable
from ..scene.layer import add_layer, end_layer
from .mixins import errors_reported
from .simplify_keys import KeysOperator, armature_of


class MANIENT_OT_add_key_layer(KeysOperator, bpy.types.Operator):
    bl_idname = "manient.add_key_layer"
    bl_label = "Layer for Changes"
    bl_description = (
        "Put the motion below, as a strip in the NLA, and key changes in an empty action on top, which is "
        "added to it: the motion's own keys stay as they are"
    )

    @errors_reported
    def execute(self, context):
        """Put the motion below."""
        layer = add_layer(armature_of(context))
        self.report({"INFO"}, f"Keys go into {layer.name} now")
        return {"FINISHED"}


class MANIENT_OT_end_key_layer(KeysOperator, bpy.types.Operator):
    bl_idname = "manient.end_key_layer"
    bl_label = "End Layer"
    bl_description = "Make the motion the active action again"

    merge: bpy.props.BoolProperty(  # type: ignore
        name="Merge", description="Put the layer's changes into the motion's keys", default=True
    )

    @classmethod
    def description(cls, _context, properties):
        if properties.merge:
            return "Put the layer's changes into the motion's keys"
        return "Take the layer and its changes away; the motion is as it was"

    @staticmethod
    def why_not(armature):
        none = None if strip_below(armature) is not None else "This hand has no layer on top of its motion"
        return why_not_editable(armature) or none

    @errors_reported
    def execute(self, context):
        end_layer(armature_of(context), merge=self.merge)
        return {"FINISHED"}
