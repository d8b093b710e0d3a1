"""Which objects are characters, and what is kept on them: which bones are hands, whose motion they get."""

from __future__ import annotations

import functools

import bpy
import numpy as np

from handfit_core.errors import HandModelError, OptionError
from handfit_core.retarget.hand_map import HandMap
from handfit_core.skeleton import SIDES, Side

from ..rigs import found_hand
from ..rigs.character import Found
from .store import CapturedHand, captured_hands, hand_of


def character_of(obj: bpy.types.Object | None) -> bpy.types.Object | None:
    """The character's armature that an object is, or that deforms or carries it; None for captured hands and
    all others."""
    if obj is None:
        return None
    deforming = [m.object for m in obj.modifiers if m.type == "ARMATURE"]
    for one in (obj, *deforming, obj.parent):
        if one is not None and one.type == "ARMATURE" and not one.manient.is_hand:
            return one
    return None


def active_character(context: bpy.types.Context) -> bpy.types.Object | None:
    """The character that the artist works on: the active object's, else one that is selected."""
    chosen = [context.active_object, *context.selected_objects]
    return next((c for c in map(character_of, chosen) if c is not None), None)


def why_not_reachable(armature: bpy.types.Object) -> str | None:
    """Why a character cannot get motion at all: a sentence; None where it can."""
    if armature.library is not None or not armature.is_editable:
        return (
            "This character is linked from another file: make a library override of it "
            "(Object > Relations > Make Library Override)"
        )
    if armature.mode == "EDIT":
        return "This character is in Edit Mode: leave it first"
    if armature.data.pose_position == "REST":
        return "This character shows its rest position: set it to Pose Position (Object Data > Pose)"
    size = np.array(armature.matrix_world.to_3x3(), dtype=np.float64)
    if not np.linalg.det(size) > 0.0:
        return (
            "This character has a negative scale, which shows its left hand as a right one: apply the scale "
            "(Ctrl A)"
        )
    return None


def kept_map(armature: bpy.types.Object, side: Side) -> HandMap | None:
    """The table that the artist has made, or confirmed, for a hand; None for none, and for a damaged one."""
    return _read(getattr(armature.manient.character, side).hand_map)


def keep_map(armature: bpy.types.Object, hand_map: HandMap) -> None:
    """Keep a table on the armature."""
    getattr(armature.manient.character, hand_map.side).hand_map = hand_map.to_json()


def hand_map_of(armature: bpy.types.Object, side: Side) -> HandMap:
    """The kept table of a hand, else the one that is recognised now. Raises HandModelError."""
    return kept_map(armature, side) or found_hand(armature, side).hand_map


def recognised(armature: bpy.types.Object, side: Side) -> Found:
    """The hand that is recognised by its bones, looked for once: for panels. Raises HandModelError."""
    found = _recognised(armature.name, side, _fingerprint(armature))
    if isinstance(found, HandModelError):
        raise HandModelError(str(found))
    return found


def sources_of(armature: bpy.types.Object, context: bpy.types.Context) -> dict[Side, CapturedHand]:
    """Which captured hand each of a character's hands follows: the chosen one, else a selected one of that
    side, else the scene's only one of it. Raises OptionError where there are several."""
    found: dict[Side, CapturedHand] = {}
    hands = [hand for hand in map(hand_of, captured_hands(context.scene)) if hand is not None]
    for side in SIDES:
        settings = getattr(armature.manient.character, side)
        if not settings.use:
            continue
        chosen = hand_of(settings.source) if settings.source is not None else None
        if chosen is None:
            own = [hand for hand in hands if hand.side == side]
            selected = [hand for hand in own if hand.armature.select_get()]
            own = selected or own
            if len(own) > 1:
                names = ", ".join(hand.armature.name for hand in own[:4])
                raise OptionError(
                    f"several captured {side} hands could move {armature.name!r} ({names}): choose one"
                )
            chosen = own[0] if own else None
        if chosen is not None:
            found[side] = chosen
    return found


def hands_to_move(
    armature: bpy.types.Object, context: bpy.types.Context
) -> list[tuple[HandMap, CapturedHand]]:
    """A character's hands, and the captured hand that each of them follows. A hand that it lacks is
    left out, unless its source was chosen. Raises OptionError and HandModelError where none is left."""
    found, lacking = [], None
    for side, hand in sources_of(armature, context).items():
        try:
            found.append((hand_map_of(armature, side), hand))
        except HandModelError as error:
            if getattr(armature.manient.character, side).source is not None:
                raise
            lacking = lacking or error
    if not found:
        raise lacking or OptionError(
            "there is no captured hand in this scene that this character could follow"
        )
    return found


@functools.lru_cache(maxsize=64)
def _read(text: str) -> HandMap | None:
    try:
        return HandMap.from_json(text) if text else None
    except HandModelError:
        return None


@functools.lru_cache(maxsize=16)
def _recognised(name: str, side: Side, _bones: int) -> Found | HandModelError:
    try:
        return found_hand(bpy.data.objects[name], side)
    except HandModelError as error:
        return error


def _fingerprint(armature: bpy.types.Object) -> int:
    """Changes with the bones' names and number; panels ask at every redraw."""
    return hash((armature.session_uid, tuple(armature.data.bones.keys())))
