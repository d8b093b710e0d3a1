"""File > Import > Hand Take: build the hands of a saved take."""

from __future__ import annotations

import bpy
from bpy_extras.io_utils import ImportHelper

from handfit_core.take import Take

from .. import screen
from ..properties import MATCHING, POSE_CORRECTIVES
from ..scene.build import build_take
from ..scene.captures import comes_in_front
from ..scene.matching import Footage, clear_view, matches, scene_sentence
from ..section import sentence
from .mixins import PollMixin, errors_reported


class MANIENT_OT_import_take(PollMixin, bpy.types.Operator, ImportHelper):
    bl_idname = "manient.import_take"
    bl_label = "Import Hand Take"
    bl_description = "Build the rigged, animated hands and the camera of a captured take"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    filename_ext = ".npz"
    filter_glob: bpy.props.StringProperty(default="*.npz", options={"HIDDEN"})  # type: ignore
    pose_correctives: bpy.props.BoolProperty(**POSE_CORRECTIVES)  # type: ignore
    picture: bpy.props.BoolProperty(  # type: ignore
        name="Picture Behind",
        description="Show the photo or video that was captured behind the hands",
        default=True,
    )
    matching: bpy.props.EnumProperty(**MATCHING, options={"SKIP_SAVE"})  # type: ignore
    render_setup: bpy.props.BoolProperty(  # type: ignore
        name="Ready to Render",
        description="Lights, and the picture in renders, where the scene is matched",
        default=True,
        options={"SKIP_SAVE"},
    )

    def invoke(self, context, event):
        """Begin with what the sidebar has."""
        for name in ("matching", "render_setup"):
            if not self.properties.is_property_set(name):
                setattr(self, name, getattr(context.scene.manient, name))
        return super().invoke(context, event)

    def draw(self, context):
        """The choices beside the file browser, and what they mean for this scene."""
        layout, scene = self.layout, context.scene
        layout.prop(self, "pose_correctives")
        layout.prop(self, "picture")
        layout.prop(self, "render_setup")
        layout.prop(self, "matching")
        # After the import the scene is another one, which the choice is not about.
        if context.space_data is not None and context.space_data.type == "FILE_BROWSER":
            text = scene_sentence(
                scene, self.matching, None, scene.frame_current, render_setup=self.render_setup
            )
            sentence(layout, context, text, "SCENE_DATA")

    @errors_reported
    def execute(self, context):
        take = Take.load(self.filepath)
        footage, frame = Footage.of_take(take), context.scene.frame_current
        matched = matches(context.scene, self.matching, footage)
        in_front = comes_in_front(context.scene, self.matching, matched)
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
        self.report({"INFO"}, scene_sentence(context.scene, self.matching, footage, frame, done=matched))
        return {"FINISHED"}


def _menu_entry(self, _context):
    self.layout.operator(MANIENT_OT_import_take.bl_idname, text="Hand Take (.npz)")


def register() -> None:
    """Add the menu entry."""
    bpy.types.TOPBAR_MT_file_import.append(_menu_entry)


def unregister() -> None:
    """Take it away again."""
    bpy.types.TOPBAR_MT_file_import.remove(_menu_entry)
