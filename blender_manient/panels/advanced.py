"""The section Advanced: options of a capture that most artists leave alone."""

from __future__ import annotations

import bpy

from handfit_core.capturing.options import OPTIONS
from handfit_core.media.source import Source

from ..common import preferences
from ..common.section import Section, note, props, split
from ..operators import housekeeping, lens
from ..session import shared_worker, source_info
from .capture import has_scene_camera

_FRAME = 8.0
"""The height of a frame's picture, in heights of a button"""


class MANIENT_PT_advanced(Section, bpy.types.Panel):
    bl_label = "Advanced"
    bl_order = 2

    def draw(self, context):
        layout, settings = split(self.layout), context.scene.manient
        info = source_info.of(settings)
        kind = info.files.kind if info.files else None
        layout.prop(settings, "target")
        if kind != "data":
            layout.label(text="Other Tracker's File")
            layout.prop(settings, "keypoints", text="")
        if source_info.has_views(info):
            layout.prop(settings, "second_view")
            if settings.second_view:
                self._second_view(settings)
        if kind not in ("photo", None):
            layout.prop(settings, "frame_step")
        if settings.preset != "PAPER" and kind != "photo":
            layout.prop(settings, "smoothing", slider=True)
        if settings.target == "NEW":
            if source_info.camera_clip(settings, info.files) is None:
                layout.prop(settings, "matching")
            props(layout, settings, "render_setup", "pose_correctives", "add_controls")
        layout.separator()
        layout.prop(settings, "hands")
        self._model(settings)
        row = layout.row(heading="Size")
        row.prop(settings, "use_hand_length", text="")
        sub = row.row()
        sub.active = settings.use_hand_length
        sub.prop(settings, "hand_length", text="cm")
        layout.separator()
        self._camera(context, settings)
        layout.separator()
        self._detection(settings)

    def _second_view(self, settings) -> None:
        layout, view = self.layout, source_info.of(settings, "second_view")
        if view.files is None or view.problem:
            note(layout, view.problem, "ERROR")
        else:
            name = Source(view.files.kind, view.files.files).name
            note(layout, source_info.in_words(settings, view, name), "FILE")
        layout.prop(settings, "use_offset")
        if settings.use_offset:
            layout.prop(settings, "use_pair")
            if not settings.use_pair:
                layout.prop(settings, "offset", text="Seconds")
            for index, field in enumerate(source_info.VIEWS if settings.use_pair else ()):
                column, info = layout.column(align=True), source_info.of(settings, field)
                picture = source_info.frame_picture(info, settings.pair[index])
                column.template_icon(icon_value=picture, scale=_FRAME)
                column.prop(settings, "pair", index=index, text=settings.bl_rna.properties[field].name)
        layout.prop(settings, "cameras")
        if not settings.cameras:
            props(layout, settings, "view_lens", "use_baseline")
            if settings.use_baseline:
                layout.prop(settings, "baseline", text="Meters")

    def _model(self, settings) -> None:
        layout, path = self.layout, settings.model_path or preferences.get().mano_folder
        layout.prop(settings, "model")
        if settings.model != "MANO":
            return
        layout.prop(settings, "model_path", text="Files")
        layout.operator("manient.check_mano", text="Check Files").path = path
        if not path:
            note(layout, "Choose your MANO file or folder", "ERROR")
        for result in housekeeping.results(path):
            note(layout, result.sentence, "CHECKMARK" if result.ok else "ERROR")

    def _camera(self, context, settings) -> None:
        layout = self.layout
        if not has_scene_camera(context.scene):  # which the tab's top asks about
            parts = layout.split(factor=0.4)
            parts.use_property_split = False
            parts.label(text="Camera")
            column = parts.column(align=True)
            for value in ("SOLVE", "FOCAL", "LENS"):
                column.prop_enum(settings, "camera", value)
        if settings.camera == "FOCAL":
            layout.prop(settings, "focal_length", text="Millimeters")
        elif settings.camera == "LENS":
            layout.prop(settings, "measured_lens")
            row = layout.row(align=True)
            row.operator("manient.show_chessboard", text="Chessboard", icon="TEXTURE")
            row.operator("manient.measure_lens", text="Measure", icon="FILE_MOVIE")
            if not settings.measured_lens:
                note(layout, lens.ADVICE, "INFO")

    def _detection(self, settings) -> None:
        layout = self.layout
        if settings.preset == "PAPER":
            layout.prop(settings, "experiment")
        elif len(shared_worker.solvers()) > 1 or settings.solver != OPTIONS["solver"].default:
            layout.prop(settings, "solver")
        if len(shared_worker.detectors()) > 1 or settings.detector != OPTIONS["detector"].default:
            layout.prop(settings, "detector")
        layout.prop(settings, "threshold")
