"""Check MANO Files: whether the user's model can be read, and if not, what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from handfit_core.errors import HandfitError
from handfit_core.hand_model import load_model
from handfit_core.skeleton import SIDES, Side

from .. import preferences, screen


@dataclass(frozen=True)
class SideResult:
    """What became of one side."""

    side: Side
    ok: bool
    sentence: str


_results: dict[str, tuple[SideResult, ...]] = {}


def results(path: str) -> tuple[SideResult, ...]:
    """What the last check of this file or folder found; empty where it was not checked. For drawing."""
    return _results.get(path, ())


def check(path: str) -> tuple[SideResult, ...]:
    """Load both sides of a MANO file or folder and keep what came of it."""
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


class MANIENT_OT_check_mano(bpy.types.Operator):
    bl_idname = "manient.check_mano"
    bl_label = "Check MANO Files"
    bl_description = "Read the MANO files of both hands and tell what is wrong with them"
    bl_options = {"INTERNAL"}  # noqa: RUF012

    path: bpy.props.StringProperty(  # type: ignore
        name="Path",
        description="File or folder to check (empty: the scene's, else the one in the preferences)",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def execute(self, context):
        path = self.path or context.scene.manient.model_path or preferences.get().mano_folder
        if not path:
            self.report({"ERROR"}, "No MANO files are chosen: choose a MANO file, or the folder with both")
            return {"CANCELLED"}
        for result in check(path):
            self.report({"INFO"} if result.ok else {"WARNING"}, result.sentence)
        screen.redraw("PREFERENCES")
        return {"FINISHED"}


def unregister() -> None:
    """Forget what was found."""
    _results.clear()
