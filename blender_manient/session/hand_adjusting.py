"""Changes of how a character's hand itself moves, carried at once into keys that are there.

Settings and dragged offsets count after a short rest. With Live Link on the link writes its keys itself.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy

from handfit_core.common.errors import HandfitError
from handfit_core.common.skeleton import SIDES

from ..common.block_reference import BlockReference
from ..common.wording import counted
from ..scene.characters import hands_to_move
from ..scene.onto_character import adjusting, is_adjusted
from ..scene.transfer_options import offsets_of
from . import live_link
from .followers import Follower, Followers

_QUIET_SECONDS = 0.1
"""Seconds without a change after which keys are written"""

_offsets: dict[int, tuple[BlockReference, dict]] = {}
"""Characters with an offset in the scene, by their session_uid, each with where the offset was seen last"""
_messages: dict[int, tuple[str, bool]] = {}
"""The message about the last change, and whether it is an error, by the armatures' session_uid"""


def message(armature: bpy.types.Object) -> tuple[str, bool] | None:
    """Return the message about a character's last change, and whether it is an error; None where there is
    none."""
    return _messages.get(armature.session_uid)


def _go_on(change: Follower, armature: bpy.types.Object, is_over: Callable[[], bool]) -> None:
    uid = armature.session_uid
    if change.steps is None and not change.has_rested(_QUIET_SECONDS):
        return
    try:
        if change.steps is None:
            change.steps = adjusting(armature, hands_to_move(armature, bpy.context))
        while not is_over():
            next(change.steps)
    except StopIteration as stop:
        _changes.pop(uid, None)
        _messages.pop(uid, None)
        if stop.value:
            stay = f"{counted(stop.value, 'frame')} with keys of your own stay as they are"
            _messages[uid] = f"{stay}: Apply to Character replaces them", False


def _fail(armature: bpy.types.Object, error: HandfitError | ReferenceError) -> None:
    gone = "the captured hand that this character follows was deleted"
    _messages[armature.session_uid] = (gone if isinstance(error, ReferenceError) else str(error)), True
    _changes.pop(armature.session_uid, None)


_changes = Followers(_go_on, _fail)
"""Characters whose keys are to be written anew"""
step = _changes.step


def on_settings_changed(group: bpy.types.PropertyGroup) -> None:
    """Have keys be written anew after a setting of how a character's hand moves has changed."""
    armature = group.id_data
    _remember_offsets(armature)
    if armature.manient.character.live:
        live_link.on_settings_changed(armature.manient.character)
    else:
        _schedule(armature)


def _schedule(armature: bpy.types.Object) -> None:
    if not is_adjusted(armature):
        _changes[armature.session_uid] = Follower(armature)
        _changes.wake()


def _remember_offsets(armature: bpy.types.Object) -> None:
    """Remember where a character's offsets are."""
    character = armature.manient.character
    if any(getattr(character, side).offset is not None for side in SIDES):
        _offsets[armature.session_uid] = BlockReference.of("objects", armature), _places(armature)
    else:
        _offsets.pop(armature.session_uid, None)


def _places(armature: bpy.types.Object) -> dict:
    return {side: tuple(place) for side, place in offsets_of(armature).items()}


def _on_update(*_args) -> None:
    """Follow a change of something in the scene: perhaps an offset was dragged, or deleted."""
    for uid, (reference, places) in list(_offsets.items()):
        armature = reference.find()
        if armature is None:
            del _offsets[uid]
        elif _places(armature) != places:
            on_settings_changed(armature.manient.character)


def _on_file(*_args) -> None:
    """Begin anew with another open file."""
    _changes.clear()
    _offsets.clear()
    _messages.clear()
    for armature in bpy.data.objects:
        if armature.type == "ARMATURE":
            _remember_offsets(armature)


def _on_time_travel(*_args) -> None:
    """Have keys be written anew after an undo or a redo: they need not be those of the settings that are
    back."""
    _on_file()
    for armature in bpy.data.objects:
        if armature.type == "ARMATURE" and not armature.manient.character.live:
            _schedule(armature)


HANDLERS = {
    "depsgraph_update_post": _on_update,
    "load_post": _on_file,
    "undo_post": _on_time_travel,
    "redo_post": _on_time_travel,
}
LISTENERS = {"hand_motion": on_settings_changed}
TIMERS = (step,)


def unregister() -> None:
    """Stop following changes."""
    _changes.clear()
    _offsets.clear()
    _messages.clear()
