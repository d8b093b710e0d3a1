"""Source: what is captured."""

from __future__ import annotations

import bpy

from handfit_core.media.source import Source

from ..common.section import Section, fitted, sentence, split
from ..session import source_info

_KINDS = {
    "photo": ("Photo", "IMAGE_DATA"),
    "sequence": ("Image Sequence", "RENDERLAYERS"),
    "video": ("Video", "FILE_MOVIE"),
    "data": ("Hands of Another Program", "ARMATURE_DATA"),
}

_PICTURE = 4.0
"""height of the thumbnail, in buttons"""
_FRAME = 8.0
"""height of a frame's picture, in buttons"""


class MANIENT_PT_source(Section, bpy.types.Panel):
    bl_label = "Source"
    bl_order = 1

    def draw(self, context):
        layout, settings = self.layout, context.scene.manient
        row = layout.row(align=True)
        row.prop(settings, "source", text="")
        row.operator("manient.use_background_clip", text="", icon="CAMERA_DATA")
        info = source_info.of(settings)
        if info.files is None:
            missing = not settings.source
            sentence(layout, context, info.problem, "INFO" if missing else "ERROR")
            return
        self._describe(context, info)
        if info.files.left_out:
            sentence(layout, context, info.files.left_out, "INFO")
        if info.unsized:
            sentence(layout, context, "How large are its pictures? The file does not say", "QUESTION")
            size = layout.row(align=True)
            size.alert = source_info.lacks_size(settings, info)
            for index, name in enumerate(("Width", "Height")):
                size.prop(settings, "picture_size", index=index, text=name)
        if info.siblings > 1:
            layout.prop(settings, "as_sequence", text=f"Image Sequence ({info.siblings} Pictures)")
        if info.files.kind != "photo":
            split(layout)
            heading = layout.column(heading="Frame Range")
            heading.prop(settings, "use_frames", text="")
            column = layout.column(align=True)
            if settings.use_frames:
                column.prop(settings, "first_frame")
                column.prop(settings, "last_frame")
            column.prop(settings, "frame_step")
        if info.files.kind != "data":
            layout.prop(settings, "keypoints")
        if source_info.has_views(info):
            layout.prop(settings, "second_view")
            if settings.second_view:
                self._second_view(context)

    def _second_view(self, context) -> None:
        layout, view = self.layout, source_info.of(context.scene.manient, "second_view")
        if view.files is None:
            sentence(layout, context, view.problem, "ERROR")
        else:
            # The field beside its name is too narrow for the file's.
            name = Source(view.files.kind, view.files.files).name
            self._describe(context, view, fitted(context, name, buttons=4))

    def _describe(self, context, info: source_info.SourceInfo, name: str = "") -> None:
        layout = self.layout
        assert info.files is not None
        kind, icon = _KINDS[info.files.kind]
        clip = None if name else source_info.camera_clip(context.scene.manient, info.files)
        if clip is not None:
            kind = "Tracked Clip" if clip.is_solved else "Camera's Clip"
        lines = [name or kind]
        if info.files.kind != "data" and info.width:
            lines.append(f"{info.width} × {info.height} px")
        if info.files.kind != "photo" and info.frames:
            rate = f", {info.fps:.5g} fps" if info.fps and info.files.kind in ("video", "data") else ""
            lines.append(f"Frames {info.first}-{info.last}{rate}")
        if info.problem:
            sentence(layout, context, info.problem, "ERROR")
            return
        picture = source_info.thumbnail(info)
        row = layout.row()
        if picture:
            row.template_icon(icon_value=picture, scale=_PICTURE)
        column = row.column(align=True)
        if picture:
            column.separator(factor=2.0)
        column.scale_y = 0.9 if picture else 0.8
        for number, line in enumerate(lines):
            column.label(
                text=line, icon="NONE" if picture or number else icon, translate=number == 0 and not name
            )


class MANIENT_PT_second_view(Section, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "MANIENT_PT_source"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        """Only where there is a second view to tell of."""
        settings = context.scene.manient
        return bool(settings.second_view) and source_info.has_views(source_info.of(settings))

    def draw(self, context):
        layout, settings = split(self.layout), context.scene.manient
        layout.prop(settings, "use_offset")
        if settings.use_offset:
            layout.prop(settings, "use_pair")
            if settings.use_pair:
                self._pair(settings)
            else:
                layout.prop(settings, "offset", text="Seconds")
        layout.prop(settings, "cameras")
        if settings.cameras:
            return
        layout.prop(settings, "view_lens")
        layout.prop(settings, "use_baseline")
        if settings.use_baseline:
            layout.prop(settings, "baseline", text="Meters")

    def _pair(self, settings) -> None:
        for index, field in enumerate(source_info.VIEWS):
            column, info = self.layout.column(align=True), source_info.of(settings, field)
            picture = source_info.frame_picture(info, settings.pair[index])
            column.template_icon(icon_value=picture, scale=_FRAME)
            column.prop(settings, "pair", index=index, text=settings.bl_rna.properties[field].name)
