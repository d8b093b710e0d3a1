"""Clear Corrections: take corrections out of the keys again."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.errors import HandfitError, TakeError

from ..scene import corrections
from ..scene.frame_span import span_of
from ..selection import active_hand


class MANIENT_OT_clear_corrections(bpy.types.Operator):
    bl_idname = "manient.clear_corrections"
    bl_label = "Clear Corrections"
    bl_description = "Remove pins and what they did to the animation"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    scope: bpy.props.EnumProperty(  # type: ignore
        name="Scope",
        items=(
            ("FRAME", "This Frame", "Only the correction of the current frame"),
            ("RANGE", "Range", "The preview range where it is used, else the scene's frames"),
            ("ALL", "All", "Every correction of this hand"),
        ),
        default="FRAME",
    )

    @classmethod
    def description(cls, _context, properties):
        """The tooltip."""
        item = properties.bl_rna.properties["scope"].enum_items[properties.scope]
        return f"{cls.bl_description}. {item.description}"

    @classmethod
    def poll(cls, context):
        """Whether there is anything to clear."""
        hand = active_hand(context)
        if hand is None:
            cls.poll_message_set("Select a captured hand: its armature or its mesh")
            return False
        if not hand.armature.is_editable or hand.armature.library is not None:
            cls.poll_message_set("This hand is linked from another file: make it local to change it")
            return False
        if not hand.armature.manient.corrections:
            cls.poll_message_set("This hand has no corrections")
            return False
        return True

    def execute(self, context):
        """Clear them."""
        hand = active_hand(context)
        assert hand is not None
        armature, scene = hand.armature, context.scene
        try:
            field = corrections.corrections_of(armature)
            places = corrections.timing_of(armature).scene_frames(field.frames)
            if self.scope == "FRAME":
                chosen = np.abs(places - scene.frame_current_final) < 0.5
            elif self.scope == "RANGE":
                first, last = span_of(scene)
                chosen = (places > first - 0.5) & (places < last + 0.5)
            else:
                chosen = np.ones(len(places), dtype=bool)
            count = corrections.clear_corrections(armature, [int(f) for f in field.frames[chosen]])
        except TakeError as error:
            if self.scope != "ALL":
                self.report({"ERROR"}, str(error))
                return {"CANCELLED"}
            # What cannot be read cannot be taken out of the keys: they stay as they are.
            armature.manient.corrections = ""
            self.report({"WARNING"}, "The corrections could not be read: they are gone, the keys stay")
            return {"FINISHED"}
        except HandfitError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if count == 0:
            where = "in this frame" if self.scope == "FRAME" else "in this range"
            self.report({"ERROR"}, f"There is no correction {where}")
            return {"CANCELLED"}
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
        self.report({"INFO"}, "1 correction cleared" if count == 1 else f"{count} corrections cleared")
        return {"FINISHED"}


def register() -> None:
    """Add the operator."""
    bpy.utils.register_class(MANIENT_OT_clear_corrections)


def unregister() -> None:
    """Take it away again."""
    bpy.utils.unregister_class(MANIENT_OT_clear_corrections)
