"""Characters out of other programs' files, in the open scene. Which endings can be read, and by which of
Blender's operators, the formats say (`Exporter.reads`)."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import InputError
from handfit_core.common.files import shown

from ..common.blender_versions import action_slot, channels, has_operator, slots_of, used_actions
from ..rigs.rig import bone_path
from ..scene.actions import curves_in, present_curves
from ..scene.keys import change_places
from ..scene.timing import frame_rate
from . import EXPORTERS
from .clean_rig import NEAR, unconnect
from .exporter import APART, Exporter, why_missing


def readable() -> dict[str, Exporter]:
    """Return the formats of other programs' files, by the endings of those that Blender can import."""
    return {ending: exporter for exporter in EXPORTERS.values() for ending in exporter.reads}


def import_file(path: Path) -> set[bpy.types.ID]:
    """Import a file with a character into the open scene, which gets the file's rate where it has one.

    Bones are unconnected, as Blender would leave out where connected ones go. Returns the new data-blocks.
    Raises InputError, with nothing new left, where it cannot be read or has no armature.
    """
    exporter = readable()[path.suffix.lower()]
    operators = exporter.reads[path.suffix.lower()]
    problem = f"what imports {path.suffix} files is {why_missing(operators[0])}"
    before = set(bpy.data.user_map())
    for operator in filter(has_operator, operators):
        try:
            with contextlib.redirect_stderr(io.StringIO()):  # some importers print tracebacks there
                done = exporter.read(path.absolute(), operator)
        except RuntimeError as error:
            done, problem = set(), _reason(str(error).replace(str(path.absolute()), path.name))
        new = set(bpy.data.user_map()) - before
        if "FINISHED" in done:
            if any(isinstance(block, bpy.types.Armature) for block in new):
                _settle(new)
                return new
            problem = "there is no armature in it"
        bpy.data.batch_remove(new)
    raise InputError(f"{shown(path)}: {problem}")


def import_in_time(path: Path) -> set[bpy.types.ID]:
    """Import a file as `import_file` does into a scene that keeps its rate and range: keys lie at the same
    seconds."""
    scene = bpy.context.scene
    rate, render = frame_rate(scene), scene.render
    kept = render.fps, render.fps_base, scene.frame_start, scene.frame_end
    try:
        new = import_file(path)
        factor = rate / frame_rate(scene)
    finally:
        render.fps, render.fps_base, scene.frame_start, scene.frame_end = kept
    if abs(factor - 1.0) > 1e-6:
        for action in (block for block in new if isinstance(block, bpy.types.Action)):
            for slot in slots_of(action):
                for curve in curves_in(channels(action, slot)):
                    change_places(curve, (factor, 1.0), (0.0, 0.0))
    return new


def animations() -> tuple[set[bpy.types.Action], set[bpy.types.Action]]:
    """Return the actions of the open file that are used now, and the others in which something moves."""
    blocks = [block for block in bpy.data.user_map() if getattr(block, "animation_data", None) is not None]
    acting = {action for block in blocks for action, _ in used_actions(block, acting=True)}  # type: ignore
    others = set(bpy.data.actions) - acting
    return acting, {action for action in others if any(_moving(action, slot) for slot in slots_of(action))}


def _moving(action: bpy.types.Action, slot: Any) -> int:
    """Return how many curves of an action's slot do not keep their value."""
    count = 0
    for curve in curves_in(channels(action, slot)):
        keys = np.empty((len(curve.keyframe_points), 2), dtype=np.float32)
        curve.keyframe_points.foreach_get("co", keys.ravel())
        count += bool(np.ptp(keys[:, 1]) > 1e-4) if len(keys) else 0
    return count


def _reason(said: str) -> str:
    """Return Blender's words on a failure, without the lines of a traceback."""
    words = " ".join(said.replace("Error: ", "").partition("Python: Traceback")[0].split())
    advice = "it may be damaged or cut off, as Blender could not import it: export it again"
    return f"{advice} ({words})" if words else advice


def _settle(new: set[bpy.types.ID]) -> None:
    """Give each block, of several animations, the one that moves most of it, where importers take the first:
    Blender's own FBX files also have those of others for it, in which it stands still."""
    actions = [block for block in new if isinstance(block, bpy.types.Action)]
    for block in new:
        if (data := getattr(block, "animation_data", None)) is None:
            continue
        users = [data, *(strip for track in data.nla_tracks for strip in track.strips)]
        choices = [(user.action, action_slot(user)) for user in users if user.action is not None]
        named = [action for action in actions if action.name.startswith(f"{block.name}|")]
        choices += [(action, slot) for action in named for slot in slots_of(action)]
        if choices:
            data.action, slot = max(choices, key=lambda choice: _moving(*choice))
            if slot is not None:
                data.action_slot = slot
    for armature in (block for block in new if isinstance(block, bpy.types.Object)):
        if armature.type == "ARMATURE" and armature.visible_get():
            size = max(armature.matrix_world.median_scale, 1e-9)
            unconnect(armature, _with_locations(armature, NEAR / size), APART / size)
    for image in (block for block in new if isinstance(block, bpy.types.Image)):
        if not image.filepath:  # as out of glTF; exporters tell pictures by their paths
            image.filepath_raw = f"//{image.name}.{image.file_format.lower()}"


def _with_locations(armature: bpy.types.Object, still: float) -> set[str]:
    """Return the bones whose keys move them farther than `still` from their rest."""
    places = [curve for curve in present_curves(armature) if curve.data_path.endswith(".location")]
    moving = {c.data_path for c in places if any(abs(key.co.y) > still for key in c.keyframe_points)}
    return {bone.name for bone in armature.pose.bones if f"{bone_path(bone.name)}.location" in moving}
