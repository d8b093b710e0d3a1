"""Capture: how, the buttons, and how far it is."""

from __future__ import annotations

import bpy

from handfit_core.options import OPTIONS

from .. import jobs, shared_worker, source_info
from ..find_mode import mode as find_mode
from ..scene.matching import said
from ..scene.store import active_hand
from ..section import Section, fitted, sentence, split
from ..wording import counted

_ICONS = {"waiting": "SORTTIME", "done": "CHECKMARK", "failed": "ERROR", "cancelled": "CANCEL"}


class MANIENT_PT_capture(Section, bpy.types.Panel):
    bl_idname = "MANIENT_PT_capture"
    bl_label = "Capture"
    bl_order = 3

    def draw(self, context):
        """Settings, buttons, progress."""
        layout, settings = self.layout, context.scene.manient
        column = split(layout.column())
        column.prop(settings, "preset")
        if settings.preset != "PAPER":
            column.prop(settings, "smoothing", slider=True)
        column.prop(settings, "target")
        hand = active_hand(context)
        if settings.target != "NEW" and hand is None:
            sentence(layout, context, "Select the captured hand that is to be animated", "INFO")

        info = source_info.of(settings)
        text = ""
        if settings.target == "NEW":
            column.prop(settings, "matching")
            text = _becomes(context.scene, info)
            sentence(layout, context, text, "SCENE_DATA")
        searched = info.files is None or (info.files.kind != "data" and not settings.keypoints)
        buttons = layout.column(align=True)
        told = info.files is not None and not source_info.lacks_size(settings, info)
        buttons.enabled = told and (settings.target == "NEW" or hand is not None)
        row = buttons.row(align=True)
        row.scale_y = 1.5
        choosing = find_mode.current
        if choosing is not None:
            count = counted(len(choosing.choice.chosen), "Hand")
            row.operator("manient.capture_found", text=f"Capture {count}", icon="VIEW_PAN")
        else:
            row.operator("manient.capture", text="Capture", icon="VIEW_PAN")
            if searched:
                buttons.operator("manient.find_hands", icon="VIEWZOOM")
        if info.files is not None and info.files.kind != "photo" and choosing is None:
            # Only what is not said above.
            shown = source_info.shown_frame(context, info.files)
            if text and not text.startswith(own := _becomes(context.scene, info, only=shown)):
                sentence(buttons, context, own, "SCENE_DATA")
            frame = buttons.operator("manient.capture", text=f"Capture Frame {shown}")
            frame.only_frame = True
        if choosing is None and searched:
            row = layout.row(align=True)
            row.operator("manient.add_hand", icon="ADD")
            row.prop(settings, "added_side", expand=True)
        self._queue(context)

    def _queue(self, context) -> None:
        layout = self.layout
        queue = jobs.jobs()
        for index, job in enumerate(queue):
            box = layout.column(align=True)
            if job.running:
                row = box.row(align=True)
                row.progress(factor=job.fraction, text=job.doing())
                row.operator("manient.cancel_capture", text="", icon="X").index = index
                pace = f"  {job.pace()}" if job.pace() else ""
                box.label(text=fitted(context, job.name, pace) + pace, translate=False)
            elif job.state == "waiting":
                row = box.row(align=True)
                name = fitted(context, job.name, ": Waiting", buttons=1)
                row.label(text=f"{name}: Waiting", icon=_ICONS["waiting"], translate=False)
                row.operator("manient.cancel_capture", text="", icon="X").index = index
            elif job.undone:
                sentence(box, context, f"{fitted(context, job.name, ': Undone')}: Undone", "LOOP_BACK")
            else:
                text = f"{fitted(context, job.name, ':')}: {job.message}"
                sentence(box, context, text, _ICONS[job.state], alert=job.state == "failed")
                if job.scene_said:
                    sentence(box, context, job.scene_said, "SCENE_DATA")
                for warning in job.warnings[:3]:
                    sentence(box, context, warning, "INFO")
                if job.state == "failed":
                    box.operator("manient.show_details", text="Details", icon="TEXT")
        if queue and not jobs.busy():
            layout.operator("manient.clear_captures", text="Clear List")


def _becomes(scene: bpy.types.Scene, info: source_info.SourceInfo, *, only: int | None = None) -> str:
    """What becomes of the scene when the source, or `only` one frame of it, is captured."""
    settings = scene.manient
    footage = source_info.footage(settings, info, only=only)
    pictures = info.files is not None and info.files.kind != "data"
    ready = settings.render_setup and settings.camera != "ACTIVE" and pictures and only is None
    return said(scene, settings.matching, footage, scene.frame_current, render_setup=ready)


class MANIENT_PT_capture_advanced(Section, bpy.types.Panel):
    bl_idname = "MANIENT_PT_capture_advanced"
    bl_label = "Advanced"
    bl_parent_id = "MANIENT_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012

    def draw(self, context):
        """What few change."""
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
            sentence(layout, context, "The scene has no active camera", "ERROR", alert=True)
        column = layout.column(heading="New Hands")
        column.active = settings.target == "NEW"
        column.prop(settings, "render_setup")
        column.prop(settings, "pose_correctives")
        column.prop(settings, "add_controls")
