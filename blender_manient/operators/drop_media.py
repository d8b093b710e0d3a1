"""Pictures, videos and takes dropped onto the 3D viewport."""

from __future__ import annotations

from pathlib import Path

import bpy

from handfit_core.errors import HandfitError
from handfit_core.media.opening import PHOTO_SUFFIXES, VIDEO_SUFFIXES, sequence_numbers

from .. import jobs, preferences, source_info
from ..scene.matching import Footage, scene_sentence
from ..section import sentence
from . import import_take
from .capture import new_job

_WIDTH = 340
"""pixels of the dialog, at a user interface scale of 1"""


class MANIENT_OT_drop_media(bpy.types.Operator):
    bl_idname = "manient.drop_media"
    bl_label = "Capture Hands"
    bl_description = "Capture the hands in the dropped pictures or video"
    bl_options = {"REGISTER"}  # noqa: RUF012

    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})  # type: ignore
    files: bpy.props.CollectionProperty(  # type: ignore
        type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"}
    )
    as_sequence: bpy.props.BoolProperty(  # type: ignore
        name="Image Sequence",
        description="The numbered pictures are the frames of one clip",
        default=False,
        options={"SKIP_SAVE"},
    )

    _footage: Footage | None = None
    """What is known of the first file before it is captured"""

    def invoke(self, context, _event):
        """Ask before anything starts: a drop may be meant for something else."""
        self.as_sequence = len(self.files) > 1 and sequence_numbers(self._paths()) is not None
        self._footage = source_info.dropped_footage(context.scene.manient, self._paths()[0])
        return context.window_manager.invoke_props_dialog(
            self, width=_WIDTH, title="Capture Hands", confirm_text="Capture"
        )

    def draw(self, context):
        """What was dropped, and which hands are wanted."""
        layout = self.layout
        paths = self._paths()
        text = paths[0].name if len(paths) == 1 else f"{paths[0].name} and {len(paths) - 1} more"
        layout.label(text=text, icon="FILE_MOVIE" if _is_video(paths[0]) else "FILE_IMAGE", translate=False)
        if len(paths) > 1:
            layout.prop(self, "as_sequence")
        settings, scene = context.scene.manient, context.scene
        layout.prop(settings, "hands")
        if settings.target == "NEW":
            layout.prop(settings, "matching")
            ready = settings.render_setup and settings.camera != "ACTIVE"
            text = scene_sentence(
                scene, settings.matching, self._footage, scene.frame_current, render_setup=ready
            )
            sentence(layout, context, text, "SCENE_DATA", width=_WIDTH)

    def execute(self, context):
        """Start a capture for the clip, or one for each picture."""
        paths = self._paths()
        started = 0
        for path in paths[:1] if self.as_sequence else paths:
            self._choose(context.scene.manient, path, paths)
            try:
                jobs.submit(new_job(context, only_frame=False))
                started += 1
            except HandfitError as error:
                self.report({"ERROR"}, str(error))
        if not started:
            return {"CANCELLED"}
        # The chosen source is a step of its own, as if it had been chosen in the panel: undoing the capture
        # leaves it. As this operator's own step it would offer to be adjusted, which would capture again.
        bpy.ops.ed.undo_push(message="Choose Source")
        return bpy.ops.manient.capture(
            "EXEC_DEFAULT" if bpy.app.background else "INVOKE_DEFAULT", queued=True
        )

    def _choose(self, settings, path: Path, dropped: list[Path]) -> None:
        """Put a file into the panel; of a sequence of which only some pictures were dropped, their range."""
        settings.source = str(path)
        settings.as_sequence = self.as_sequence
        numbers = sequence_numbers(dropped) if self.as_sequence else None
        settings.use_frames = numbers is not None and len(source_info.numbered_siblings(path)) > len(dropped)
        if numbers is not None and settings.use_frames:
            settings.first_frame, settings.last_frame, settings.frame_step = min(numbers), max(numbers), 1

    def _paths(self) -> list[Path]:
        return [Path(self.directory) / file.name for file in self.files if file.name]


class MANIENT_FH_media(bpy.types.FileHandler):
    bl_idname = "MANIENT_FH_media"
    bl_label = "Capture Hands"
    bl_import_operator = MANIENT_OT_drop_media.bl_idname
    bl_file_extensions = ";".join(sorted(PHOTO_SUFFIXES | VIDEO_SUFFIXES))

    @classmethod
    def poll_drop(cls, context):
        """Only where hands can appear, and where the user wants it."""
        return context.area is not None and context.area.type == "VIEW_3D" and preferences.get().drop_captures


class MANIENT_FH_take(bpy.types.FileHandler):
    bl_idname = "MANIENT_FH_take"
    bl_label = "Hand Take"
    bl_import_operator = import_take.MANIENT_OT_import_take.bl_idname
    bl_file_extensions = ".npz"

    @classmethod
    def poll_drop(cls, context):
        """Only where hands can appear."""
        return context.area is not None and context.area.type == "VIEW_3D"


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_SUFFIXES
