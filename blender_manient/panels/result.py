"""Result: the hands of the scene, how good the active one is, and where to look."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.take.fit_quality import NOT_KNOWN

from ..common.section import EditSection, note, row_of
from ..common.wording import capitalised, counted
from ..operators.base import ModalOperator
from ..rigs.arm import has_arm
from ..scene import captures, corrections
from ..scene.background import missing_picture
from ..scene.confidence import errors_by_view, errors_of, is_marked
from ..scene.retime import other_rate
from ..scene.store import CapturedHand, active_hand, captured_hands
from ..scene.timing import frame_rate


class MANIENT_PT_result(EditSection, bpy.types.Panel):
    bl_label = "Result"
    bl_order = 1
    bl_options = set()
    works_on = staticmethod(lambda context: context.scene)

    def draw(self, context):
        layout, hand = self.layout, active_hand(context)
        armatures = captured_hands(context.scene, shown=True)
        if not armatures:
            note(layout, "No hands captured in this scene yet", "INFO")
        column = layout.column(align=True)
        for armature in armatures:
            active = hand is not None and hand.armature == armature
            how = {"text": armature.name, "icon": "VIEW_PAN", "depress": active, "translate": False}
            column.operator("manient.select_hand", **how).hand = armature.name
        self._views(context)
        if hand is not None:
            self._hand(context, layout.column(align=True), hand)

    def _views(self, context) -> None:
        """Draw how well the active capture's views fit together, and the button to the other one."""
        layout, capture = self.layout, captures.active_capture(context.scene)
        if capture is None:
            return
        verdict = captures.verdict(capture)
        if verdict is not None:
            note(layout, verdict.text, "VIEW_CAMERA" if verdict.agreement == "good" else "ERROR")
        if len(captures.cameras_of(capture)) > 1:
            text = f"View: {captures.other_camera(context.scene, capture).name}"
            layout.operator("manient.switch_view", text=text, icon="VIEW_CAMERA", translate=False)

    def _hand(self, context, box: bpy.types.UILayout, hand: CapturedHand) -> None:
        self._other_rate(context, box, hand)
        if hand.is_of_other_model():
            text = "Captured with another version of the hand model: what is fitted anew may not match it"
            note(box, text, "ERROR")
        track = hand.track
        if track.added:
            held = corrections.corrections_of(hand.armature).corrections.values()
            frames, placed = len(held), sum(len(one.pins) for one in held)
            text = f"Added by hand: {counted(placed, 'point')} placed"
            note(box, text + (f" in {frames} frames" if frames > 1 else ""), "MOUSE_LMB")
        elif not track.detected.any():
            note(box, "Mirrored: it is not in the picture itself", "MOD_MIRROR")
        else:
            self._quality(context, box, hand)
            self._arm(box, hand)
        missing = missing_picture(hand.camera)
        if missing:
            text = f"{missing} was moved: use File > External Data > Find Missing Files to see it again"
            note(box, text, "ERROR")

    def _quality(self, context, box: bpy.types.UILayout, hand: CapturedHand) -> None:
        """Draw in how many frames the hand was found, how far off it is likely to be, and the doubtful
        frames."""
        armature, track, errors = hand.armature, hand.track, errors_of(hand)
        count = len(track.detected)
        filled = 0 if track.filled is None else int(track.filled.sum())
        more = f", {filled} filled" if filled else ""
        if count > 1:
            box.label(text=f"Found in {int(track.detected.sum())} of {count} frames{more}", translate=False)
        if errors.mean is not None:
            row, scale = box.row(align=True), errors.scale
            said = f"{scale.title} {scale.said(errors.mean)}: {scale.quality(errors.mean)}"
            row.label(text=said, translate=False)
            row.operator("manient.jump_worst", text="", icon="INFO").hand = armature.name
        if track.seen_by:
            views = errors_by_view(hand.take, track)
            said = ", ".join("not seen" if np.isnan(view) else f"{view:.1f} px" for view in views)
            box.label(text=f"Error by view: {said}", translate=False)
        doubtful = int(errors.doubtful.sum())
        if not errors.known:
            box.label(text=capitalised(NOT_KNOWN), translate=False)
        elif count > 1:  # of one frame the word above says it
            row = box.row(align=True)
            row.label(
                text=f"{counted(doubtful, 'doubtful frame')}" if doubtful else "No doubtful frames",
                translate=False,
            )
            for direction, icon in (("PREVIOUS", "TRIA_LEFT"), ("NEXT", "TRIA_RIGHT")) if doubtful else ():
                jump = row.operator("manient.jump_doubtful", text="", icon=icon)
                jump.direction, jump.hand = direction, armature.name
        row = box.row(align=True)
        if count > 1:
            marked = is_marked(context.scene, hand)
            markable = row_of(row, marked or doubtful + filled > 0)
            mark = markable.operator("manient.mark_doubtful", text="Markers", depress=marked)
            mark.hand = armature.name
        row.prop(armature.manient, "show_confidence", text="Colors", toggle=True)

    def _other_rate(self, context, box: bpy.types.UILayout, hand: CapturedHand) -> None:
        """Draw a warning where the scene's rate is not the hand's, with both ways to mend it."""
        built, rate = other_rate(context.scene, hand.collection), frame_rate(context.scene)
        if not built:
            return
        text = f"Built for {built:.5g} fps, and the scene has {rate:.5g}: it plays at another speed"
        note(box, text, "ERROR")
        row = box.row(align=True)
        row.operator("manient.retime", text=f"Retime to {rate:.5g}").hand = hand.armature.name
        back = row.operator("manient.retime", text=f"Back to {built:.5g} fps")
        back.hand, back.back = hand.armature.name, True

    def _arm(self, box: bpy.types.UILayout, hand: CapturedHand) -> None:
        """Draw the button that looks for the hand's arm, until it has one, or why there is none."""
        if hand.track.no_arm:
            note(box, capitalised(hand.track.no_arm), "INFO")
        elif has_arm(hand.armature) and hand.track.arm is not None:
            there, found = int(hand.track.arm.present.sum()), int(hand.track.present.sum())
            said = "found" if there == found else f"in {there} of {found} frames"
            box.label(text=f"Arm {said}", translate=False)
        else:
            row = row_of(box, "manient.add_arms" not in ModalOperator.running)
            row.operator("manient.add_arms", icon="CON_KINEMATIC").hand = hand.armature.name
