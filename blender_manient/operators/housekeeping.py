"""Buttons of the preferences: MANO files, the cache, the folder of plug-ins; and texts for bug reports."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from handfit_core.common.errors import HandfitError, OptionError, OutputError
from handfit_core.common.files import shown, why
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.hand_model import load_model

from ..common import plugins, preferences, screen
from ..session import cache, details, shared_worker
from .base import InternalOperator


@dataclass(frozen=True)
class SideResult:
    """The result of a check of one side's MANO file."""

    side: Side
    ok: bool
    sentence: str


_results: dict[str, tuple[SideResult, ...]] = {}


def results(path: str) -> tuple[SideResult, ...]:
    """Return what the last check of this file or folder found; empty where it was not checked. For
    drawing."""
    return _results.get(path, ())


def check(path: str) -> tuple[SideResult, ...]:
    """Load both sides of a MANO file or folder; return, and keep, what came of each."""
    _results.clear()
    _results[path] = tuple(_check_side(path, side) for side in SIDES)
    return _results[path]


def _check_side(path: str, side: Side) -> SideResult:
    try:
        model = load_model(preferences.full_path(path), side)
    except HandfitError as error:
        return SideResult(side, False, f"{side.capitalize()} hand: {error}")
    count = len(model.v_template)
    return SideResult(side, True, f"{side.capitalize()} hand: {model.name}, {count} vertices")


class MANIENT_OT_check_mano(InternalOperator, bpy.types.Operator):
    """Read the MANO files of both hands and tell what is wrong with them."""

    bl_label = "Check MANO Files"

    path: bpy.props.StringProperty(
        name="Path",
        description="File or folder to check (empty: the scene's, else the one in the preferences)",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def run(self, context):
        path = self.path or context.scene.manient.model_path or preferences.get().mano_folder
        if not path:
            raise OptionError("No MANO files are chosen: choose a MANO file, or the folder with both")
        for result in check(path):
            self.report({"INFO"} if result.ok else {"WARNING"}, result.sentence)
        screen.redraw("PREFERENCES")


class MANIENT_OT_note(InternalOperator, bpy.types.Operator):
    """A message of the sidebar, which has room for its beginning."""

    bl_label = "Message"

    text: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def description(cls, _context, properties):
        return properties.text.removesuffix(".")

    def run(self, context):
        """Report the message, since reports can be copied."""
        return self.text


class MANIENT_OT_clear_cache(InternalOperator, bpy.types.Operator):
    """Remove the add-on's temporary files. Pictures that the open file shows stay; other files that show
    pictures from there lose them."""

    bl_label = "Clear"

    @classmethod
    def poll_reason(cls, context):
        worker = shared_worker.current()
        busy = worker is not None and worker.busy
        return "A capture uses these files: wait for it or cancel it" if busy else None

    def run(self, context):
        freed, left = cache.clear()
        kept = f", {left} files in use were kept" if left else ""
        screen.redraw("PREFERENCES")
        return f"{freed / 1e6:.1f} MB were freed{kept}"


class MANIENT_OT_open_plugins(InternalOperator, bpy.types.Operator):
    """Open the folder for export formats and rigs of your own, one file each. Updates and removal of the
    add-on leave it alone; what is put there is found when the add-on is enabled or Blender starts."""

    bl_label = "Open Plug-in Folder"

    def run(self, context):
        folder = plugins.folder()
        try:
            for kind in plugins.KINDS:
                (folder / kind).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{shown(folder)}: the folder cannot be made ({why(error)})") from error
        if not bpy.app.background:
            bpy.ops.wm.path_open(filepath=str(folder))
        return f"Plug-ins are in {shown(folder)}"


class _TextOperator(InternalOperator):
    """The base of operators on one of the file's text blocks."""

    text: bpy.props.StringProperty(name="Text", default=details.TEXT_NAME, options={"HIDDEN", "SKIP_SAVE"})

    def show(self, context: bpy.types.Context, text: bpy.types.Text) -> str | None:
        """Hand the text over; return what is reported of that."""
        raise NotImplementedError

    def run(self, context):
        text = details.local_text(self.text)
        if text is None:
            raise OptionError(f"This file has no text '{self.text}': nothing was written yet")
        return self.show(context, text)


class MANIENT_OT_copy_details(_TextOperator, bpy.types.Operator):
    """Copy the text with the details to the clipboard, for a bug report."""

    bl_label = "Copy Details"

    @classmethod
    def poll_reason(cls, context):
        return "There is no clipboard without a window" if bpy.app.background else None

    def show(self, context, text):
        context.window_manager.clipboard = text.as_string()
        return "Copied to the clipboard"


class MANIENT_OT_show_details(_TextOperator, bpy.types.Operator):
    """Open the text with the details in a Text Editor."""

    bl_label = "Show Details"

    def show(self, context, text):
        if bpy.app.background:
            return text.as_string()
        area = next(screen.areas("TEXT_EDITOR"), None)
        if area is None:
            bpy.ops.wm.window_new()
            area = context.window_manager.windows[-1].screen.areas[0]
            area.type = "TEXT_EDITOR"
        space = area.spaces.active
        assert isinstance(space, bpy.types.SpaceTextEditor)
        space.text = text
        space.show_word_wrap = True
        space.top = 0
        area.tag_redraw()
        return None


def unregister() -> None:
    """Forget what the checks of MANO files found."""
    _results.clear()
