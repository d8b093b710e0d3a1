"""A character that moves already, by its own keys or another tool's: when, and what lies beside that."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import SIDES

from ..rigs.rig import bone_path
from .actions import channels_of, curves_in
from .character_arms import unapplied_users
from .characters import table_of
from .hand_motion import written_keys
from .timing import LAST_FRAME


def moving_range(armature: bpy.types.Object) -> tuple[float, float] | None:
    """Return the first and last scene frame on which anything but its fingers, and what was applied to its
    hands and arms, moves a character; None where nothing does."""
    names = {name for side in SIDES for name in table_of(armature, side).keyed}
    names |= {one.bone for side in SIDES if (one := written_keys(armature, side)) is not None}
    starts, spans = tuple(f"{bone_path(name)}." for name in names), []
    for user in unapplied_users(armature):
        curves = [c for c in curves_in(channels_of(user)) if not c.data_path.startswith(starts)]
        moving = [c.range() for c in curves if c.range()[1] > c.range()[0]]
        if moving and isinstance(user, bpy.types.NlaStrip):
            spans.append((user.frame_start, user.frame_end))
        elif moving:
            spans += moving
        if moving and any(len(c.modifiers) for c in curves):  # which go on beyond their keys
            spans.append((bpy.context.scene.frame_start, bpy.context.scene.frame_end))
    return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None


def check_moved_in_time(armature: bpy.types.Object, frames: Sequence[np.ndarray], offset: int) -> None:
    """Raise OptionError where motions on scene frames (N,), when they come `offset` frames later, would lie
    beside the timeline or beside what the character does."""
    first, last = (end + offset for end in (min(f[0] for f in frames), max(f[-1] for f in frames)))
    would = f"with an offset of {offset} frames the hands would move in frames {first:.0f} to {last:.0f}"
    if max(abs(first), abs(last)) > LAST_FRAME:
        raise OptionError(f"{would}, and Blender's timeline ends at {LAST_FRAME}: choose a smaller one")
    span = moving_range(armature)
    if span is not None and (last < span[0] or first > span[1]):
        moves = f"{armature.name!r} moves in {span[0]:.0f} to {span[1]:.0f}"
        raise OptionError(f"{would}, and {moves}: choose another one")
