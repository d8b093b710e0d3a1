"""The tab Hand Capture: what is captured, the buttons, how far it is, and the captures of the scene."""

from __future__ import annotations

import bpy

from ..common.section import Section, note, row_of, split
from ..common.wording import capitalised, counted, shortened
from ..operators.add_hand import MANIENT_OT_add_hand
from ..operators.find_hands import MANIENT_OT_find_hands
from ..scene import captures
from ..scene.camera_clip import camera_clips
from ..scene.matching import is_of_a_capture, is_untouched, scene_sentence
from ..scene.store import active_hand
from ..session import jobs, source_info

_ICONS = {"waiting": "SORTTIME", "done": "CHECKMARK", "failed": "ERROR", "cancelled": "CANCEL"}
_OFFERS = {"find_hands": "Another hand is likely", "add_hand": "A hand was not found"}
_ROWS = 5
"""How many rows of the list are seen at once"""
_NAME = 16
"""How many letters of a source's name stand before what came of it"""


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
        """Draw the capture's name, its hands and how good they are."""
        shown = captures.is_shown(item, context.view_layer)
        parts = layout.split(factor=0.5)
        parts.prop(item, "name", text="", emboss=False, icon="HIDE_OFF" if shown else "HIDE_ON")
        row = parts.row(align=True)
        row.active = shown
        row.label(text=captures.in_words(context.scene, item), translate=False)
        row.operator("manient.remove_capture", text="", icon="X", emboss=False).capture = item.name


class MANIENT_PT_capture(Section, bpy.types.Panel):
    bl_label = "Capture"
    bl_order = 1
    bl_options = {"HIDE_HEADER"}

    def draw(self, context):
        settings = context.scene.manient
        info = source_info.of(settings)
        self._source(context, info)
        column = split(self.layout.column())
        new = settings.target == "NEW"
        if new and (info.files is None or info.files.kind != "data"):
            column.prop(settings, "arms")
        column.prop(settings, "preset")
        if has_scene_camera(context.scene):
            column.prop(settings, "camera")
        if info.files is not None:
            self._result(context, info)
        ready = info.files is not None and not source_info.lacks_size(settings, info)
        ready = ready and (new or active_hand(context) is not None)
        self._buttons(context, info, ready)
        self._jobs()
        found = captures.captures(context.scene)
        if found:
            rows, listed = min(len(found), _ROWS), (bpy.data, "collections", context.scene, "manient_capture")
            how = {"rows": rows, "maxrows": max(rows, 2), "sort_lock": True}
            self.layout.template_list(MANIENT_UL_captures.__name__, "", *listed, **how)
        if len(found) > 1:
            hide = captures.others_shown(context.scene)
            button = self.layout.operator("manient.hide_captures", text="Hide Others" if hide else "Show All")
            button.hide = hide

    def _source(self, context, info: source_info.SourceInfo) -> None:
        layout, settings = self.layout, context.scene.manient
        row = layout.row(align=True)
        row.prop(settings, "source", text="")
        if camera_clips(context.scene):
            row.operator("manient.use_background_clip", text="", icon="CAMERA_DATA")
        if info.files is None or info.problem:
            note(layout, info.problem, "ERROR" if settings.source else "INFO")
            return
        note(layout, source_info.in_words(settings, info), "FILE")
        if info.unsized:
            note(layout, "How large are its pictures? The file does not say", "QUESTION")
            size = layout.row(align=True)
            size.alert = source_info.lacks_size(settings, info)
            for index, name in enumerate(("Width", "Height")):
                size.prop(settings, "picture_size", index=index, text=name)
        if info.siblings > 1:
            layout.prop(settings, "as_sequence", text=f"Image Sequence ({info.siblings} Pictures)")
        if info.files.kind != "photo":
            row = layout.row(align=True)
            row.prop(settings, "use_frames", text="Range")
            part = row.row(align=True)
            part.active = settings.use_frames
            part.prop(settings, "first_frame", text="")
            part.prop(settings, "last_frame", text="")

    def _result(self, context, info: source_info.SourceInfo) -> None:
        """Draw one line about what the capture does: to the scene, or to which hand."""
        layout, scene, hand = self.layout, context.scene, active_hand(context)
        settings = scene.manient
        if settings.camera == "ACTIVE" and scene.camera is None:
            note(layout, "The scene has no active camera", "ERROR")
        elif settings.target == "NEW":
            footage = source_info.footage(settings, info)
            text = scene_sentence(scene, settings.matching, footage, scene.frame_current)
            note(layout, text, "SCENE_DATA")
        elif hand is None:
            note(layout, "Select the captured hand that is to be animated", "ERROR")
        else:
            note(layout, f"Onto {hand.armature.name}", "ARMATURE_DATA")

    def _buttons(self, context, info: source_info.SourceInfo, ready: bool) -> None:
        settings, choosing = context.scene.manient, MANIENT_OT_find_hands.current
        buttons = self.layout.column(align=True)
        job = jobs.current_or_next()
        if job is not None:
            row_of(buttons, True, 1.5).progress(factor=job.fraction, text=job.activity())
            row = buttons.row(align=True)
            text, can = job.stop_button
            stop = row_of(row, can).operator("manient.cancel_capture", text=text, icon="CANCEL")
            stop.index = jobs.jobs().index(job)
            row_of(row, ready).operator("manient.queue_capture", icon="ADD")
            buttons.label(text=f"{shortened_here(job.request.name)}  {job.speed_text()}", translate=False)
            return
        row = row_of(buttons, ready, 1.5)
        if choosing is not None:
            count = counted(len(choosing.choice.chosen), "Hand")
            row.operator("manient.capture_found", text=f"Capture {count}", icon="VIEW_PAN")
        else:
            row.operator("manient.capture", text="Capture", icon="VIEW_PAN")
        if info.files is None:
            return
        searched = info.files.kind != "data" and not settings.keypoints
        if choosing is not None:
            buttons.operator("manient.leave", text="Leave Find Hands", icon="CANCEL").what = "FIND"
        elif searched:
            row_of(buttons, ready).operator("manient.find_hands", icon="VIEWZOOM")
        if info.files.kind != "photo":
            shown = source_info.shown_frame(context, info.files)
            inside = info.has_frame(shown)
            row = row_of(buttons, ready and choosing is None and inside)
            text = f"Capture Frame {shown}" if inside else "Capture Frame"
            row.operator("manient.capture", text=text).only_frame = True
        if searched:
            parts = self.layout.split(factor=0.36, align=True)
            row = row_of(parts, choosing is None)
            if MANIENT_OT_add_hand.current is not None:
                row.operator("manient.leave", icon="CANCEL").what = "ADD"
            else:
                row.operator("manient.add_hand", icon="ADD")
            row_of(parts, choosing is None).prop(settings, "added_side", expand=True)

    def _jobs(self) -> None:
        """Draw a line for each capture that waits or is over."""
        layout, queue = self.layout.column(align=True), jobs.jobs()
        for index, job in enumerate(queue):
            row, name, result = layout.row(align=True), shortened_here(job.request.name), job.result
            if job.state == "waiting":
                note(row, f"{name}: Waiting", _ICONS["waiting"])
                row.operator("manient.cancel_capture", text="", icon="X").index = index
            elif job.finished and not job.is_gone:
                note(row, f"{name}: {result.summary()}", "INFO" if result.warnings else _ICONS[job.state])
                if job.state == "failed":
                    row.operator("manient.show_details", text="Details", icon="TEXT")
                elif result.offer:
                    row = layout.split(factor=0.66, align=True)
                    note(row, capitalised(result.warnings[0]), "QUESTION", _OFFERS.get(result.offer, ""))
                    row.operator(f"manient.{result.offer}")
        if any(job.finished for job in queue):
            layout.operator("manient.clear_captures")


def shortened_here(name: str) -> str:
    """Return a source's name, shortened so that a few words have room beside it."""
    return shortened(name, lambda text: len(text) <= _NAME)


def has_scene_camera(scene: bpy.types.Scene) -> bool:
    """True if hands may be captured before the scene's camera, which is one of the artist's."""
    camera = scene.camera
    own = camera is not None and not is_untouched(camera) and not is_of_a_capture(camera)
    return own or scene.manient.camera == "ACTIVE"
