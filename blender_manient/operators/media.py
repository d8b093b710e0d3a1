"""What is captured or imported: takes, dropped pictures and clips, and the camera's background clip."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy_extras.io_utils import ImportHelper

from handfit_core.common.errors import HandfitError, InputError
from handfit_core.media.opening import PHOTO_SUFFIXES, VIDEO_SUFFIXES, sequence_numbers
from handfit_core.take import Take

from ..common import preferences, screen
from ..common.section import props, sentence
from ..scene.build import build_take
from ..scene.camera_clip import camera_clips
from ..scene.captures import becomes_active
from ..scene.matching import Footage, clear_view, matches, scene_sentence
from ..session import jobs, source_info
from ..session.properties import MATCHING, POSE_CORRECTIVES
from .base import ManientOperator, SceneOperator
from .capture import new_request

_WIDTH = 340
"""The width of the dialog in pixels, at a user interface scale of 1"""


class MANIENT_OT_import_take(SceneOperator, bpy.types.Operator, ImportHelper):
    """Build the rigged, animated hands and the camera of a captured take."""

    bl_label = "Import Hand Take"

    filename_ext = ".npz"
    filter_glob: bpy.props.StringProperty(default="*.npz", options={"HIDDEN"})
    pose_correctives: bpy.props.BoolProperty(**POSE_CORRECTIVES)
    picture: bpy.props.BoolProperty(
        name="Picture Behind",
        description="Show the photo or video that was captured behind the hands",
        default=True,
    )
    matching: bpy.props.EnumProperty(**MATCHING, options={"SKIP_SAVE"})
    render_setup: bpy.props.BoolProperty(
        name="Ready to Render",
        description="Lights, and the picture in renders, where the scene is matched",
        default=True,
        options={"SKIP_SAVE"},
    )

    def invoke(self, context, event):
        """Begin with the choices that the sidebar has."""
        for name in ("matching", "render_setup"):
            if not self.properties.is_property_set(name):
                setattr(self, name, getattr(context.scene.manient, name))
        return super().invoke(context, event)

    def draw(self, context):
        """Draw the choices beside the file browser, and what they mean for this scene."""
        layout, scene = self.layout, context.scene
        props(layout, self, "pose_correctives", "picture", "render_setup", "matching")
        # After the import the scene is another one, which the choice is not about.
        if context.space_data is not None and context.space_data.type == "FILE_BROWSER":
            text = scene_sentence(scene, self.matching, None, scene.frame_current)
            sentence(layout, context, text, "SCENE_DATA")

    def run(self, context):
        take = Take.load(self.filepath)
        footage, frame = Footage.of_take(take), context.scene.frame_current
        matched = matches(context.scene, self.matching, footage)
        in_front = becomes_active(context.scene, self.matching, matched)
        built = build_take(
            take,
            pose_correctives=self.pose_correctives,
            picture=self.picture,
            match_scene=matched,
            in_front=in_front,
            render_setup=self.render_setup,
        )
        warnings = list(built.warnings)
        if matched or in_front:
            warnings += clear_view(built.camera, built.collection, context.view_layer)
            screen.look_through_camera(context)
        for warning in warnings:
            self.report({"WARNING"}, warning)
        return scene_sentence(context.scene, self.matching, footage, frame, done=matched)


def _menu_entry(self, _context):
    self.layout.operator(MANIENT_OT_import_take.bl_idname, text="Hand Take (.npz)")


class MANIENT_OT_drop_media(ManientOperator, bpy.types.Operator):
    """Capture the hands in the dropped pictures or video."""

    bl_label = "Capture Hands"
    bl_options = {"REGISTER"}

    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    files: bpy.props.CollectionProperty(
        type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"}
    )
    as_sequence: bpy.props.BoolProperty(
        name="Image Sequence",
        description="The numbered pictures are the frames of one clip",
        options={"SKIP_SAVE"},
    )

    _footage: Footage | None = None
    """The rate and size of the first file, as far as they are known before it is captured; else None"""

    def invoke(self, context, _event):
        """Ask before anything starts: a drop may be meant for something else."""
        self.as_sequence = len(self.files) > 1 and sequence_numbers(self._paths()) is not None
        self._footage = source_info.dropped_footage(context.scene.manient, self._paths()[0])
        return context.window_manager.invoke_props_dialog(
            self, width=_WIDTH, title="Capture Hands", confirm_text="Capture"
        )

    def draw(self, context):
        """Draw what was dropped, and the choice of the hands that are wanted."""
        layout = self.layout
        paths = self._paths()
        icon = "FILE_MOVIE" if paths[0].suffix.lower() in VIDEO_SUFFIXES else "FILE_IMAGE"
        text = paths[0].name if len(paths) == 1 else f"{paths[0].name} and {len(paths) - 1} more"
        layout.label(text=text, icon=icon, translate=False)
        if len(paths) > 1:
            layout.prop(self, "as_sequence")
        settings, scene = context.scene.manient, context.scene
        layout.prop(settings, "hands")
        if settings.target == "NEW":
            layout.prop(settings, "matching")
            text = scene_sentence(scene, settings.matching, self._footage, scene.frame_current)
            sentence(layout, context, text, "SCENE_DATA", width=_WIDTH)

    def run(self, context):
        paths = self._paths()
        started = 0
        for path in paths[:1] if self.as_sequence else paths:
            self._choose(context.scene.manient, path, paths)
            try:
                jobs.submit(new_request(context, only_frame=False))
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
    bl_label = "Capture Hands"
    bl_import_operator = MANIENT_OT_drop_media.bl_idname
    bl_file_extensions = ";".join(sorted(PHOTO_SUFFIXES | VIDEO_SUFFIXES))

    @classmethod
    def poll_drop(cls, context):
        """True where hands can appear, and where the user wants it."""
        return context.area is not None and context.area.type == "VIEW_3D" and preferences.get().drop_captures


class MANIENT_FH_take(bpy.types.FileHandler):
    bl_label = "Hand Take"
    bl_import_operator = MANIENT_OT_import_take.bl_idname
    bl_file_extensions = ".npz"

    @classmethod
    def poll_drop(cls, context):
        """True where hands can appear."""
        return context.area is not None and context.area.type == "VIEW_3D"


class MANIENT_OT_use_background_clip(ManientOperator, bpy.types.Operator):
    """Capture the hands in the clip behind the scene's camera, or in the tracked one that moves it."""

    bl_label = "Camera's Clip"

    @classmethod
    def poll_reason(cls, context):
        none = "The scene's camera has no background clip, and no tracked clip moves it"
        return None if camera_clips(context.scene) else none

    def run(self, context):
        clips, settings = camera_clips(context.scene), context.scene.manient
        shown = [clip for clip in clips if clip.is_shown]
        chosen = [clip for clip in shown if clip.is_solved] or shown or clips
        if len(chosen) > 1:
            name, count = context.scene.camera.name, len(chosen)
            raise InputError(f"{name} has {count} clips: hide all but one in its Background Images")
        if not chosen[0].path.exists():
            raise InputError(f"{chosen[0].path}: the clip's file is not there any more; find it again")
        settings.source, settings.as_sequence = str(chosen[0].path), chosen[0].is_sequence
        settings.camera = "ACTIVE"


MENUS = {("TOPBAR_MT_file_import", "append"): _menu_entry}
