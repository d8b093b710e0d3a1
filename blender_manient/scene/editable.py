"""Whether a captured hand may be changed here, and its keys, and why not."""

from __future__ import annotations

import bpy

from handfit_core.errors import OptionError

from ..rigs import rig_of
from ..rigs.controls import in_use


def why_not_readable(armature: bpy.types.Object) -> str | None:
    """Why a captured hand's pose cannot be read: a sentence for a tooltip; None where it can."""
    return rig_of(armature, armature.manient.side).lacking


def why_not_editable(armature: bpy.types.Object) -> str | None:
    """Why nothing of a captured hand can be changed: a sentence for a tooltip; None where it can."""
    if armature.library is not None or not armature.is_editable:
        return "This hand is linked from another file: make it local to change it"
    if armature.override_library is not None:
        # What the add-on writes would be gone as soon as the file is loaded again.
        return "This hand is a library override: make it local to change it"
    return why_not_readable(armature)


def why_not_keyable(armature: bpy.types.Object) -> str | None:
    """The same for single keys of its motion: what is shown has to be what they say."""
    why = why_not_bakeable(armature)
    if why is None and in_use(armature):
        return "Controls move this hand on top of its keys: bake them or switch Controls off first"
    return why


def why_not_bakeable(armature: bpy.types.Object) -> str | None:
    """The same for its action, whatever else moves the hand: keys are changed in the active one."""
    why = why_not_editable(armature)
    data = armature.animation_data
    if why is not None or data is None:
        return why
    if is_tweaked(armature):
        return "The motion is in the NLA: leave tweak mode, and make its action the active one to change it"
    action = data.action
    if action is None:
        # A new action with a few keys would hide all strips under it, on all frames.
        if any(len(track.strips) for track in data.nla_tracks):
            return "The motion is in the NLA: make its action the active one, or bake it, to change it"
        return None
    if action.library is not None or action.override_library is not None or not action.is_editable:
        return f"The action {action.name} is linked from another file: make the action local to change it"
    return None


def is_tweaked(armature: bpy.types.Object) -> bool:
    """Whether an NLA strip of it is being edited, whose action has a time of its own."""
    data = armature.animation_data
    return data is not None and data.use_tweak_mode


def check_editable(armature: bpy.types.Object) -> None:
    """Raises OptionError where nothing of the hand can be changed."""
    _check(armature, why_not_editable(armature))


def check_keyable(armature: bpy.types.Object) -> None:
    """Raises OptionError where single keys of the hand cannot be changed."""
    _check(armature, why_not_keyable(armature))


def _check(armature: bpy.types.Object, why: str | None) -> None:
    if why is not None:
        raise OptionError(f"{armature.name!r} cannot be changed: {why[:1].lower()}{why[1:]}")
