"""Capture: how, the buttons, and how far it is."""

from __future__ import annotations

import bpy

from handfit_core.capturing.options import OPTIONS

from ..common.section import Section, fitted, props, sentence, split
from ..common.wording import counted
from ..operators import add_hand, lens
from ..operators.modes import find_hands as find_mode
from ..scene.matching import scene_sentence
from ..scene.store import active_hand
from ..session import jobs, shared_worker, source_info

_ICONS = {"waiting": "SORTTIME", "done": "CHECKMARK", "failed": "ERROR", "cancelled": "CANCEL"}


class MANIENT_PT_capture(Section, bpy.types.Panel):
    bl_label = "Capture"
    bl_order = 3

    def draw(self, context):
        layout, settings = self.layout, context.scene.manient
        column = split(layout.column())
        column.prop(settings, "preset")
        if settings.preset != "PAPER":
            column.prop(settings, "smoothing", slider=True)
        column.prop(settings, "target")
        if settings.target == "NEW":
            column.prop(settings, "arms")
        hand = active_hand(context)
        if settings.target != "NEW" and hand is None:
            sentence(layout, context, "Select the captured hand that is to be animated", "INFO")

        info = source_info.of(settings)
        own = ""
        if settings.target == "NEW":
            if source_info.camera_clip(settings, info.files) is None:
                column.prop(settings, "matching")
            text, own = _scene_messages(context, info)
            sentence(layout, context, text, "SCENE_DATA")
        searched = info.files is None or (info.files.kind != "data" and not settings.keypoints)
        told = info.files is not None and not source_info.lacks_size(settings, info)
        ready = told and (settings.target == "NEW" or hand is not None)
        choosing = find_mode.current
        buttons = layout.column(align=True)
        job = jobs.current_or_next()
        row = _row(buttons, ready if job is None else job.stop_button[1], 1.5)
        if job is not None:
            stop = row.operator("manient.cancel_capture", text=job.stop_button[0], icon="CANCEL")
            stop.index = jobs.jobs().index(job)
        elif choosing is not None:
            count = counted(len(choosing.choice.chosen), "Hand")
            row.operator("manient.capture_found", text=f"Capture {count}", icon="VIEW_PAN")
        else:
            row.operator("manient.capture", text="Capture", icon="VIEW_PAN")
        if searched:
            row = _row(buttons, ready)
            if choosing is not None:
                row.operator("manient.leave", text="Leave Find Hands", icon="CANCEL").what = "FIND"
            else:
                row.operator("manient.find_hands", icon="VIEWZOOM")
        if info.files is not None and info.files.kind != "photo":
            if own:
                sentence(buttons, context, own, "SCENE_DATA")
            row = _row(buttons, ready and choosing is None)
            shown = source_info.shown_frame(context, info.files)
            row.operator("manient.capture", text=f"Capture Frame {shown}").only_frame = True
        if searched:
            parts = layout.split(factor=0.36, align=True)
            row = _row(parts, choosing is None)
            if add_hand.running():
                row.operator("manient.leave", icon="CANCEL").what = "ADD"
            else:
                row.operator("manient.add_hand", icon="ADD")
            _row(parts, choosing is None).prop(settings, "added_side", expand=True)
        self._queue(context, ready)

    def _queue(self, context, ready: bool) -> None:
        layout = self.layout
        queue = jobs.jobs()
        for index, job in enumerate(queue):
            box = layout.column(align=True)
            if job.running:
                row = box.row(align=True)
                row.progress(factor=job.fraction, text=job.activity())
                row.operator("manient.cancel_capture", text="", icon="X").index = index
                speed = f"  {job.speed_text()}" if job.speed_text() else ""
                box.label(text=fitted(context, job.name, speed) + speed, translate=False)
            elif job.state == "waiting":
                row = box.row(align=True)
                name = fitted(context, job.name, ": Waiting", buttons=1)
                row.label(text=f"{name}: Waiting", icon=_ICONS["waiting"], translate=False)
                row.operator("manient.cancel_capture", text="", icon="X").index = index
            elif job.gone:
                said = f": {job.gone}"
                sentence(box, context, fitted(context, job.name, said) + said, "LOOP_BACK")
            else:
                text = f"{fitted(context, job.name, ':')}: {job.message}"
                sentence(box, context, text, _ICONS[job.state])
                if job.views_message:
                    sentence(box, context, job.views_message, "VIEW_CAMERA")
                if job.scene_message:
                    sentence(box, context, job.scene_message, "SCENE_DATA")
                for warning in job.warnings[:3]:
                    sentence(box, context, warning, "INFO")
                if job.offer:
                    box.operator(f"manient.{job.offer}")
                if job.state == "failed":
                    box.operator("manient.show_details", text="Details", icon="TEXT")
        if queue:
            row = _row(layout, ready or not jobs.busy())
            if jobs.busy():
                row.operator("manient.capture", text="Add to Queue", icon="ADD")
            else:
                row.operator("manient.clear_captures", text="Clear List")


def _row(layout, enabled: bool, scale: float = 1.0):
    row = layout.row(align=True)
    row.scale_y = scale
    row.enabled = enabled
    return row


def _scene_messages(context: bpy.types.Context, info: source_info.SourceInfo) -> tuple[str, str]:
    """What capturing the source does to the scene, and what else capturing its current frame alone does."""
    text = _scene_message(context.scene, info)
    placed = source_info.camera_clip(context.scene.manient, info.files) is not None
    if info.files is None or info.files.kind == "photo" or placed:
        return text, ""
    own = _scene_message(context.scene, info, only=source_info.shown_frame(context, info.files))
    return text, "" if text.startswith(own) else own


def _scene_message(scene: bpy.types.Scene, info: source_info.SourceInfo, *, only: int | None = None) -> str:
    """What capturing the source, or `only` one frame of it, does to the scene."""
    settings = scene.manient
    footage = source_info.footage(settings, info, only=only)
    pictures = info.files is not None and info.files.kind != "data"
    ready = settings.render_setup and settings.camera != "ACTIVE" and pictures and only is None
    return scene_sentence(scene, settings.matching, footage, scene.frame_current, render_setup=ready)


class MANIENT_PT_capture_advanced(Section, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "MANIENT_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, settings = self.layout, context.scene.manient
        split(layout)
        if settings.preset == "PAPER":
            layout.prop(settings, "experiment")
        elif len(shared_worker.solvers()) > 1 or settings.solver != OPTIONS["solver"].default:
            layout.prop(settings, "solver")
        if len(shared_worker.detectors()) > 1 or settings.detector != OPTIONS["detector"].default:
            layout.prop(settings, "detector")
        layout.prop(settings, "threshold", text="Threshold")
        layout.prop(settings, "camera")
        if settings.camera == "FOCAL":
            layout.prop(settings, "focal_length", text="Millimeters")
        elif settings.camera == "ACTIVE" and context.scene.camera is None:
            sentence(layout, context, "The scene has no active camera", "ERROR")
        elif settings.camera == "LENS":
            layout.prop(settings, "measured_lens")
            row = layout.row(align=True)
            row.operator("manient.show_chessboard", text="Chessboard", icon="TEXTURE")
            row.operator("manient.measure_lens", text="Measure", icon="FILE_MOVIE")
            if not settings.measured_lens:
                sentence(layout, context, lens.ADVICE, "INFO")
        column = layout.column(heading="New Hands")
        column.active = settings.target == "NEW"
        props(column, settings, "render_setup", "pose_correctives", "add_controls")
