"""A lens that is measured once, for all captures with that camera: the chessboard, and its film."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy_extras.io_utils import ImportHelper

from handfit_core.common.errors import OptionError
from handfit_core.common.files import written_whole
from handfit_core.media.chessboard import board_png
from handfit_core.media.lenses import checked_name
from handfit_core.media.opening import VIDEO_SUFFIXES

from ..common import screen
from ..common.section import sentence
from ..session import shared_worker
from ..session.cache import cache_folder
from .base import InternalOperator, SceneOperator, StepsOperator

ADVICE = (
    "Film the chessboard for half a minute, with the camera set as for captures and stabilization off: the "
    "whole board, in all corners of the picture, near and far, and up to 45 degrees from each side"
)


class MANIENT_OT_show_chessboard(InternalOperator, bpy.types.Operator):
    """Open a picture of a chessboard, to be shown on the whole screen and filmed."""

    bl_label = "Show Chessboard"

    def run(self, context):
        path = cache_folder() / "chessboard.png"
        with written_whole(path) as beside:
            beside.write_bytes(board_png())
        if not bpy.app.background:
            bpy.ops.wm.path_open(filepath=str(path))
        return f"Film {path} on the whole screen"


class MANIENT_OT_measure_lens(StepsOperator, SceneOperator, bpy.types.Operator, ImportHelper):
    """Measure a camera's lens from a film of the chessboard, and keep it for all captures with that one."""

    bl_label = "Measure Lens"
    bl_options = {"UNDO"}  # adjusting it would measure again
    title = "Measuring"
    undone = "An undo stopped the measuring: begin it again"

    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{suffix}" for suffix in sorted(VIDEO_SUFFIXES)), options={"HIDDEN"}
    )
    lens: bpy.props.StringProperty(
        name="Name", description="What the lens is called from now on, such as: my phone", default="My Camera"
    )

    _browsing = False

    def invoke(self, context, event):
        """Ask for the film and the name, or measure while the window stays free."""
        if self.filepath:
            return self._reported(self._begun, context)
        self._browsing = True
        return ImportHelper.invoke(self, context, event)

    def draw(self, context):
        """Draw the name beside the file browser, and how to film."""
        self.layout.prop(self, "lens")
        sentence(self.layout, context, ADVICE, "INFO")

    def run(self, context):
        """Measure and wait for it. From the file browser, in which no operator can go on running, another one
        of its kind does."""
        if not self._browsing:
            return super().run(context)
        bpy.ops.manient.measure_lens("INVOKE_DEFAULT", filepath=self.filepath, lens=self.lens)
        return {"CANCELLED"}

    def steps(self, context):
        path, name = Path(bpy.path.abspath(self.filepath)), checked_name(self.lens)
        if not path.is_file():
            raise OptionError("Choose the film of the chessboard")
        text = f"Measuring the lens of {path.name}"
        done = yield from shared_worker.ask("lens", text, input=[str(path)], name=name)
        return name, done["said"]

    def finished(self, context, result):
        name, said = result
        context.scene.manient.camera, context.scene.manient.measured_lens = "LENS", name
        screen.redraw_sidebars()
        return f"{name}: {said}"
