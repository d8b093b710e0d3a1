"""Clear Corrections: take corrections out of the keys again."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.errors import OptionError, TakeError

from ..scene import corrections
from ..scene.editable import why_not_editable
from ..scene.timing import span_of
from ..wording import counted
from .mixins import HandOperator, errors_reported, polled_hand


class MANIENT_OT_clear_corrections(HandOperator, bpy.types.Operator):
    bl_idname = "manient.clear_corrections"
    bl_label = "Clear Corrections"
    bl_description = "Remove pins and applied poses, and what they did to the animation"
    anywhere = True

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
        item = properties.bl_rna.properties["scope"].enum_items[properties.scope]
        return f"{cls.bl_description}. {item.description}"

    @staticmethod
    def why_not(armature):
        none = None if armature.manient.corrections else "This hand has no corrections"
        return why_not_editable(armature) or none

    @errors_reported
    def execute(self, context):
        armature, scene = polled_hand(context).armature, context.scene
        elsewhere = corrections.why_elsewhere(armature)
        if elsewhere is not None and self.scope == "ALL":
            corrections.forget_corrections(armature)
            self.report({"WARNING"}, "The corrections were in another action: they are gone, its keys stay")
            return {"FINISHED"}
        try:
            field = corrections.corrections_of(armature)
            frames = np.array(field.corrected, dtype=np.float64)
            places = corrections.timing_of(armature).scene_frames(frames)
            if self.scope == "FRAME":
                chosen = np.abs(places - scene.frame_current_final) < 0.5
            elif self.scope == "RANGE":
                first, last = span_of(scene)
                chosen = (places > first - 0.5) & (places < last + 0.5)
            else:
                chosen = np.ones(len(places), dtype=bool)
            lost = set(frames[chosen].tolist()) & set(corrections.displaced(armature))
            count = corrections.clear_corrections(
                armature, None if self.scope == "ALL" else frames[chosen].tolist()
            )
        except TakeError:
            if self.scope != "ALL":
                raise
            # What cannot be read cannot be taken out of the keys: they stay as they are.
            corrections.forget_corrections(armature)
            self.report({"WARNING"}, "The corrections could not be read: they are gone, the keys stay")
            return {"FINISHED"}
        if count == 0 and self.scope != "ALL":
            where = "in this frame" if self.scope == "FRAME" else "in this range"
            raise OptionError(f"There is no correction {where}")
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
        if lost:
            which = ", ".join(f"{f:g}" for f in sorted(lost))
            which = f"The keys of the corrected source frames {which} were moved or replaced"
            self.report({"WARNING"}, f"{which}: these keys stay as they are")
            return {"FINISHED"}
        self.report({"INFO"}, f"{counted(count, 'correction')} cleared")
        return {"FINISHED"}
