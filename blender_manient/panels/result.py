"""Result: the captures of the scene, how good their hands are, and where to look."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.take.fit_quality import NOT_KNOWN

from ..common.section import Section, fitted, sentence
from ..common.wording import capitalised, counted
from ..operators.base import ModalOperator
from ..rigs.arm import has_arm
from ..scene import captures, corrections
from ..scene.background import missing_picture
from ..scene.confidence import errors_by_view, errors_of, is_marked
from ..scene.retime import other_rate
from ..scene.store import CapturedHand, captured_hands, hand_of
from ..scene.timing import frame_rate

_ROWS = 5
"""of the list that are seen at once"""


class MANIENT_UL_captures(bpy.types.UIList):
    """The captures among all collections of the file."""

    def filter_items(self, context, data, propname):
        """Show the captures of the scene whose name has what is typed."""
        items = getattr(data, propname)
        here = {capture.session_uid for capture in captures.captures(context.scene)}
        flags = bpy.types.UI_UL_list.filter_items_by_name(
            self.filter_name, self.bitflag_filter_item, items, "name"
        ) or [self.bitflag_filter_item] * len(items)
        return [flag if item.session_uid in here else 0 for flag, item in zip(flags, items, strict=True)], []

    def draw_item(self, context, layout, _data, item, _icon, _active_data, _active_property, _index):
        """The source's name, frames and rate, and how many hands were built."""
        shown = captures.is_shown(item, context.view_layer)
        split = layout.split(factor=0.36)
        split.prop(item, "name", text="", emboss=False, icon="HIDE_OFF" if shown else "HIDE_ON")
        row = split.row(align=True)
        row.active, row.alignment = shown, "RIGHT"
        row.label(text=captures.facts(item), translate=False)
        hands = sum(hand.manient.capture == item for hand in captured_hands(context.scene))
        row.label(text=str(hands), icon="VIEW_PAN", translate=False)
        row.operator("manient.remove_capture", text="", icon="X", emboss=False).capture = item.name


class MANIENT_PT_result(Section, bpy.types.Panel):
    bl_label = "Result"
    bl_order = 4

    def draw(self, context):
        layout = self.layout
        self._captures(context)
        armatures = captured_hands(context.scene, shown=True)
        if not armatures:
            sentence(layout, context, "No hands captured in this scene yet", "INFO")
        for armature in armatures:
            self._hand(context, armature)

    def _captures(self, context) -> None:
        layout, found = self.layout, captures.captures(context.scene)
        if not found:
            return
        rows = min(len(found), _ROWS)
        names = MANIENT_UL_captures.__name__, "", bpy.data, "collections", context.scene, "manient_capture"
        layout.template_list(*names, rows=rows, maxrows=max(rows, 2), sort_lock=True)
        if len(found) > 1:
            hide = captures.others_shown(context.scene)
            button = layout.operator("manient.hide_captures", text="Hide Others" if hide else "Show All")
            button.hide = hide
        self._views(context)

    def _views(self, context) -> None:
        """How well the active capture's views fit together, and the button to the other one."""
        layout, capture = self.layout, captures.active_capture(context.scene)
        verdict = captures.verdict(capture)
        if verdict is not None:
            good = verdict.agreement == "good"
            sentence(layout, context, verdict.text, "VIEW_CAMERA" if good else "ERROR")
        cameras = captures.cameras_of(capture)
        if len(cameras) > 1:
            other = captures.other_camera(context.scene, capture)
            text = fitted(context, f"View: {other.name}", buttons=1)
            layout.operator("manient.switch_view", text=text, icon="VIEW_CAMERA")

    def _other_rate(self, context, box: bpy.types.UILayout, hand: CapturedHand) -> None:
        """What a change of the scene's rate has done to the hand, and both ways to put it right."""
        built, rate = other_rate(context.scene, hand.collection), frame_rate(context.scene)
        if not built:
            return
        text = f"Built for {built:.5g} fps, and the scene has {rate:.5g}: it plays at another speed"
        sentence(box, context, text, "ERROR")
        row = box.row(align=True)
        row.operator("manient.retime", text=f"Retime to {rate:.5g}").hand = hand.armature.name
        back = row.operator("manient.retime", text=f"Back to {built:.5g} fps")
        back.hand, back.back = hand.armature.name, True

    def _arm(self, context, box: bpy.types.UILayout, hand: CapturedHand) -> None:
        """The button that looks for the hand's arm, until it has one, or why there is none."""
        if hand.track.no_arm:
            sentence(box, context, capitalised(hand.track.no_arm), "INFO")
        elif has_arm(hand.armature) and hand.track.arm is not None:
            there, found = int(hand.track.arm.present.sum()), int(hand.track.present.sum())
            said = "found" if there == found else f"in {there} of {found} frames"
            box.label(text=f"Arm {said}", translate=False)
        else:
            row = box.row(align=True)
            row.enabled = "manient.add_arms" not in ModalOperator.running
            row.operator("manient.add_arms", icon="CON_KINEMATIC").hand = hand.armature.name

    def _hand(self, context, armature: bpy.types.Object) -> None:
        hand = hand_of(armature)
        if hand is None:
            return
        box = self.layout.box().column(align=True)
        self._other_rate(context, box, hand)
        row = box.row(align=True)
        name = fitted(context, armature.name, buttons=1)
        row.label(text=name, icon="OUTLINER_OB_ARMATURE", translate=False)
        select = row.operator("manient.select_hand", text="", icon="RESTRICT_SELECT_OFF")
        select.hand = armature.name
        if hand.is_of_other_model():
            text = "Captured with another version of the hand model: what is fitted anew may not match it"
            sentence(box, context, text, "ERROR")
        track = hand.track
        found, count = int(track.detected.sum()), len(track.detected)
        if track.added:
            frames = corrections.corrected_frames(armature)
            held = corrections.corrections_of(armature).corrections.values()
            placed = sum(len(one.pins) for one in held)
            text = f"Added by hand: {counted(placed, 'point')} placed"
            sentence(
                box, context, text + (f" in {len(frames)} frames" if len(frames) > 1 else ""), "MOUSE_LMB"
            )
            return
        if not found:
            sentence(box, context, "Mirrored: it is not in the picture itself", "MOD_MIRROR")
            return
        lines = box.column(align=True)
        lines.scale_y = 0.85
        filled = 0 if track.filled is None else int(track.filled.sum())
        more = f", {filled} filled" if filled else ""
        lines.label(text=f"Found in {found} of {count} frames{more}", translate=False)
        errors = errors_of(hand)
        if errors.mean is not None:
            row, scale = box.row(align=True), errors.scale
            said = f"{scale.title} {scale.said(errors.mean)}: {scale.quality(errors.mean)}"
            row.label(text=said, translate=False)
            row.operator("manient.jump_worst", text="", icon="INFO").hand = armature.name
        if track.seen_by:
            views = errors_by_view(hand.take, track)
            said = ", ".join("not seen" if np.isnan(view) else f"{view:.1f} px" for view in views)
            lines.label(text=f"Error by view: {said}", translate=False)
        doubtful = int(errors.doubtful.sum())
        if not errors.known:
            box.label(text=capitalised(NOT_KNOWN), translate=False)
        elif count > 1:  # of one frame the word above says it
            row = box.row(align=True)
            frames = "frame" if doubtful == 1 else "frames"
            row.label(text=f"{doubtful or 'No'} doubtful {frames}", translate=False)
            for direction, icon in (("PREVIOUS", "TRIA_LEFT"), ("NEXT", "TRIA_RIGHT")) if doubtful else ():
                jump = row.operator("manient.jump_doubtful", text="", icon=icon)
                jump.direction, jump.hand = direction, armature.name
        row = box.row(align=True)
        if count > 1:
            marked = is_marked(context.scene, hand)
            markable = row.row(align=True)
            markable.enabled = marked or doubtful + filled > 0
            mark = markable.operator("manient.mark_doubtful", text="Markers", depress=marked)
            mark.hand = armature.name
        row.prop(armature.manient, "show_confidence", text="Colors", toggle=True)
        if armature.manient.show_confidence and context.mode != "POSE":
            sentence(box, context, "Blender shows bone colors in Pose Mode", "INFO")
        self._arm(context, box, hand)
        missing = missing_picture(hand.camera)
        if missing:
            text = f"{missing} was moved: use File > External Data > Find Missing Files to see it again"
            sentence(box, context, text, "ERROR")
