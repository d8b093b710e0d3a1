"""Correct: keypoints by hand."""

from __future__ import annotations

import bpy

from ..common import preferences
from ..common.section import EditSection, note, row_of
from ..common.wording import capitalised, counted
from ..operators.base import ModalOperator
from ..scene import corrections
from ..scene.store import CapturedHand, active_hand
from ..session.refiner import why_not_refinable, why_not_smoothable


class MANIENT_PT_refine(EditSection, bpy.types.Panel):
    bl_label = "Correct"
    bl_order = 2
    bl_options = set()
    works_on = staticmethod(active_hand)

    def draw(self, context):
        layout, hand = self.layout, self.works_on(context)
        why = why_not_refinable(hand.track)
        if why is not None:
            note(layout, capitalised(why), "INFO")
        else:
            self._by_points(context, hand)
        layout.prop(context.scene.manient, "spread", text="Spread (Frames)")
        corrected = corrections.corrected_frames(hand.armature)
        if corrected:
            shown = ", ".join(str(f) for f in corrected[:8]) + (" ..." if len(corrected) > 8 else "")
            note(layout, f"Corrected frames: {shown}", "KEYFRAME_HLT")
            row = layout.row(align=True)
            row.label(text="Clear")
            for scope, text in (("FRAME", "Frame"), ("RANGE", "Range"), ("ALL", "All")):
                row.operator("manient.clear_corrections", text=text).scope = scope
        if why is None:
            self._locks(hand.armature)

    def _by_points(self, context, hand: CapturedHand) -> None:
        """Draw the buttons that need the points that were detected."""
        layout = self.layout
        row_of(layout, scale=1.3).operator("manient.edit_keypoints", icon="EDITMODE_HLT")
        kept = preferences.get()
        if isinstance(kept, bpy.types.AddonPreferences):
            layout.prop(kept, "hand_opacity", slider=True)
        self._fitting(layout.row(), "manient.refit_range", "FILE_REFRESH")
        why = why_not_smoothable(hand)
        if why is not None and len(hand.take.frame_numbers) > 1:
            note(layout, f"No smoothing: {why}", "INFO")
        elif why is None:
            row = layout.row(align=True)
            row.prop(context.window_manager, "manient_smoothing", slider=True)
            self._fitting(row.row(align=True), "manient.smooth_motion", "PREVIEW_RANGE", text="", stop="")
        row = layout.row(align=True)
        self._fitting(row.row(align=True), "manient.touch", "SNAP_ON")
        self._fitting(row.row(align=True), "manient.press_together", "AUTOMERGE_ON")
        self._fitting(layout.row(), "manient.grip", "VIEW_PAN")

    def _fitting(self, row, operator: str, icon: str, *, stop: str = "Stop", **shown: str) -> None:
        """Draw the button that begins to fit a range, or in its place the one that stops that."""
        work = ModalOperator.running.get(operator)
        if work is not None:
            row.enabled = work.can_stop
            row.operator("manient.leave", text=stop, icon="CANCEL").what = "FIT"
        else:
            row.operator(operator, icon=icon, **shown)

    def _locks(self, armature: bpy.types.Object) -> None:
        locked = sum(armature.manient.locked)
        row = self.layout.row(align=True)
        text = f"{counted(locked, 'joint')} locked" if locked else "No joints locked"
        row.label(text=text, translate=False)
        row.operator("manient.lock_joints", text="", icon="LOCKED").lock = True
        row.operator("manient.lock_joints", text="", icon="UNLOCKED").lock = False
