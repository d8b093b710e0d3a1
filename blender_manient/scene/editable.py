"""Decides whether a hand and its keys may be changed here, and says why not."""

from __future__ import annotations

import bpy

from handfit_core.common.errors import OptionError

from ..rigs import rig_of
from ..rigs.controls import in_use
from .actions import is_layered, is_tweaked, strips_of


def why_not_readable(armature: bpy.types.Object) -> str | None:
    """Return why a captured hand's pose cannot be read, a sentence for a tooltip; None where it can, and for
    characters, whose bones are asked for by name."""
    if _is_character(armature):
        return None
    return rig_of(armature, armature.manient.side).lacking


def why_not_editable(armature: bpy.types.Object) -> str | None:
    """Return why nothing of a captured hand can be changed, a sentence for a tooltip; None where it can."""
    if armature.library is not None or not armature.is_editable:
        return "This hand is linked from another file: make it local to change it"
    if armature.override_library is not None and not _is_character(armature):
        # What the add-on writes would be gone as soon as the file is loaded again.
        return "This hand is a library override: make it local to change it"
    return why_not_readable(armature)


def why_not_keyable(armature: bpy.types.Object) -> str | None:
    """Return why single keys of a captured hand cannot be changed, a sentence for a tooltip; None where they
    can. What is shown has to be what the keys say."""
    why = why_not_bakeable(armature)
    if why is None and in_use(armature):
        return "Controls move this hand on top of its keys: bake them or switch Controls off first"
    return why


def why_not_bakeable(armature: bpy.types.Object) -> str | None:
    """Return why keys of a captured hand's active action cannot be changed, whatever else moves the hand, a
    sentence for a tooltip; None where they can."""
    why = why_not_editable(armature)
    data = armature.animation_data
    if why is not None or data is None:
        return why
    if is_tweaked(armature):
        return "The motion is in the NLA: leave tweak mode, and make its action the active one to change it"
    action = data.action
    if is_layered(armature):
        return (
            "The active action is a layer on top of the motion: merge or remove it (Motion), "
            "or set the action's blending to Replace, to change it here"
        )
    if action is None:
        # A new action with a few keys would hide all strips under it, on all frames.
        if strips_of(armature):
            return "The motion is in the NLA: make its action the active one, or bake it, to change it"
        return None
    if action.library is not None or action.override_library is not None or not action.is_editable:
        return f"The action {action.name} is linked from another file: make the action local to change it"
    return None


def _is_character(armature: bpy.types.Object) -> bool:
    noted = getattr(armature, "manient", None)  # not there where the add-on is not registered
    return noted is not None and not noted.is_hand


def check_unlayered(armature: bpy.types.Object) -> None:
    """Raise OptionError where the keys are not all of the motion, since a layer lies on top."""
    if is_layered(armature):
        raise OptionError(
            f"{armature.name!r} has a layer on top of its motion: merge or remove it first (Motion)"
        )


def check_editable(armature: bpy.types.Object) -> None:
    """Raise OptionError where nothing of the hand can be changed."""
    check(armature, why_not_editable(armature), " cannot be changed")


def check_keyable(armature: bpy.types.Object) -> None:
    """Raise OptionError where single keys of the hand cannot be changed."""
    check(armature, why_not_keyable(armature), " cannot be changed")


def check(armature: bpy.types.Object, why: str | None, what: str = "") -> None:
    """Raise OptionError, which names the armature, where the sentence `why` says that something cannot be
    done."""
    if why is not None:
        raise OptionError(f"{armature.name!r}{what}: {why[:1].lower()}{why[1:]}")
