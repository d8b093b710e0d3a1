"""Which objects are characters, and what is kept on them: which bones are hands, whose motion they get."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import HandModelError, OptionError
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.retarget.hand_map import HandMap, empty_map
from handfit_core.retarget.recognition import DOUBTFUL, Found, left_out
from handfit_core.retarget.saved_rigs import SavedRig, fitting_rig

from ..rigs import found_hand, troubles
from ..rigs.character import bones_of, driven_bones
from .store import CapturedHand, captured_hands, hand_of, has_properties, is_in_hidden_capture


@dataclass(frozen=True, eq=False)
class CharacterObjects:
    """A whole character, to be written to a file."""

    armature: bpy.types.Object
    meshes: tuple[bpy.types.Object, ...]
    side: None = None
    hand_maps: tuple[HandMap, ...] = ()
    """Tables of its hands that stand before those that are kept or recognised"""
    imported: bool = False
    """True if the open scene is another program's file, which is to be written as a whole"""

    @classmethod
    def of(cls, armature: bpy.types.Object) -> CharacterObjects:
        """Return the character with what it deforms, carries or holds in the open scene and renders show:
        proxies and cages are no part of it."""
        shown = (o for o in bpy.context.scene.objects if o.type == "MESH" and not o.hide_render)
        return cls(armature, tuple(o for o in shown if armature in (*_deforming(o), o.parent, *_holding(o))))


def characters_in(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the armatures of a scene that are no captured hands, by name."""
    return sorted(filter(_is_character, scene.objects), key=lambda o: o.name)


def only_character(armatures: Sequence[bpy.types.Object]) -> bpy.types.Object | None:
    """Return the only one of some armatures, or the only one that deforms or carries a mesh; None for
    several."""
    if len(armatures) > 1:
        armatures = [one for one in armatures if CharacterObjects.of(one).meshes] or armatures
    return armatures[0] if len(armatures) == 1 else None


def character_of(obj: bpy.types.Object | None) -> bpy.types.Object | None:
    """Return the character's armature that an object is, or that deforms or carries it, or that it shows an
    instance of, as objects do that link a character; None for captured hands and all others."""
    if obj is None:
        return None
    instanced = obj.instance_collection.all_objects if obj.instance_collection is not None else ()
    around = (obj, *_deforming(obj), obj.parent, *instanced)
    return next((one for one in around if one is not None and _is_character(one)), None)


def active_character(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the character that the artist works on: the active object's, else one that is selected."""
    chosen = [context.active_object, *context.selected_objects]
    return next((c for c in map(character_of, chosen) if c is not None), None)


def why_not_reachable(armature: bpy.types.Object) -> str | None:
    """Return a sentence that says why a character cannot get motion at present; None where it can."""
    if armature.library is not None or not armature.is_editable:
        return (
            "This character is linked from another file: make a library override of it "
            "(Object > Relations > Make Library Override)"
        )
    if armature.mode == "EDIT":
        return "This character is in Edit Mode: leave it first"
    if armature.data.pose_position == "REST":
        return "This character shows its rest position: set it to Pose Position (Object Data > Pose)"
    return _why_mirrored(armature)


def why_not_written(armature: bpy.types.Object, scene: bpy.types.Scene) -> str | None:
    """Return why a character cannot be written to a file, a sentence; None where it can, also for one that is
    linked."""
    if armature.name not in scene.objects:
        return (
            "This character is shown as an instance of a collection: make a library override of it (Object > "
            "Relations > Make Library Override), or open its own file"
        )
    return _why_mirrored(armature)


def _why_mirrored(armature: bpy.types.Object) -> str | None:
    size = np.array(armature.matrix_world.to_3x3(), dtype=np.float64)
    if not np.linalg.det(size) > 0.0:
        return (
            "This character has a negative scale, which shows its left hand as a right one: apply the scale "
            "(Ctrl A)"
        )
    return None


def kept_map(armature: bpy.types.Object, side: Side) -> HandMap | None:
    """Return the table that the artist has made, or confirmed, for a hand; None for none, and for a damaged
    one."""
    kept = _read(getattr(armature.manient.character, side).hand_map) if has_properties() else None
    return kept if kept is not None and kept.side == side else None


def is_damaged(armature: bpy.types.Object, side: Side) -> bool:
    """True if the table that is kept for a hand cannot be read."""
    return bool(getattr(armature.manient.character, side).hand_map) and kept_map(armature, side) is None


def keep_map(armature: bpy.types.Object, hand_map: HandMap) -> None:
    """Keep the table of a hand's bones on the armature."""
    getattr(armature.manient.character, hand_map.side).hand_map = hand_map.to_json()


def rig_used(armature: bpy.types.Object, side: Side) -> SavedRig | None:
    """Return the user's saved rig that says which bones a hand is; None where a kept table does, or none
    fits."""
    return None if kept_map(armature, side) is not None else fitting_rig(armature.data.bones.keys(), side)


def hand_map_of(armature: bpy.types.Object, side: Side) -> HandMap:
    """Return the kept table of a hand, else that of a saved rig that fits, else the one that is recognised.
    Raises HandModelError."""
    rig = rig_used(armature, side)
    kept = kept_map(armature, side) if rig is None else rig.of(side)
    if kept is not None:
        return kept
    found = recognised(armature, side).hand_map
    return recognised(armature, side, tuple(troubles(armature, found))).hand_map


def table_of(armature: bpy.types.Object, side: Side) -> HandMap:
    """Return the kept or recognised table of a hand, for display; an empty one where there is neither."""
    try:
        return hand_map_of(armature, side)
    except HandModelError:
        return empty_map(side)


def recognised(armature: bpy.types.Object, side: Side, reported: tuple[str, ...] = ()) -> Found:
    """Return the hand that is recognised by its bones, kept because panels ask at every redraw; recognised
    anew where bones were moved or renamed, and where `reported`, the rig's troubles, are others, as after a
    switch from IK to FK. Raises HandModelError."""
    bones = armature.data.bones
    heads = np.empty((len(bones), 3), dtype=np.float32)
    bones.foreach_get("head_local", heads.ravel())
    found = _recognised(armature.session_uid, side, tuple(bones.keys()), heads.tobytes(), reported)
    if isinstance(found, HandModelError):
        raise HandModelError(str(found))
    return found


@functools.lru_cache(maxsize=32)
def _recognised(uid: int, side: Side, _names: Any, _heads: Any, _reported: Any) -> Found | HandModelError:
    armature = next(obj for obj in bpy.data.objects if obj.session_uid == uid)
    try:
        return found_hand(armature, side)
    except HandModelError as error:
        return error


def sure_map_of(armature: bpy.types.Object, side: Side) -> HandMap:
    """Return what `hand_map_of` does, where nobody is there to be asked. Raises HandModelError for what may
    be no hand."""
    hand_map = hand_map_of(armature, side)
    taught = kept_map(armature, side) is not None or rig_used(armature, side) is not None
    if not taught and recognised(armature, side).sure < DOUBTFUL:
        raise HandModelError(
            f"the bones below {hand_map.bones[0]!r} may be no {side} hand: name its bones with --bones, or "
            "choose them in the panel and save the rig or the character's file"
        )
    return hand_map


def without_keys(armature: bpy.types.Object, hand_map: HandMap) -> dict[str, list[str]]:
    """Return the deforming bones of a hand that get no keys, by the reason; without those that follow
    others."""
    bones = armature.data.bones
    if hand_map.bones[0] not in bones:
        return {}
    found = _left_out(armature.session_uid, hand_map, tuple(bones.keys()))
    own = {bone.name for bone in bones if bone.use_deform} - driven_bones(armature) if found else set()
    return {why: those for why, names in found.items() if (those := [name for name in names if name in own])}


@functools.lru_cache(maxsize=32)
def _left_out(uid: int, hand_map: HandMap, _names: Any) -> dict[str, list[str]]:
    """Return `without_keys` from a cache, because panels ask at every redraw."""
    armature = next(obj for obj in bpy.data.objects if obj.session_uid == uid)
    return left_out(bones_of(armature), hand_map)


def said_without_keys(found: dict[str, list[str]]) -> str:
    """Return the bones that `without_keys` found, as a sentence; empty where it found none."""
    some = {
        why: ", ".join([*names[:3], *(["..."] if len(names) > 3 else [])]) for why, names in found.items()
    }
    return "; ".join(f"no keys for {len(names)} bones {why} ({some[why]})" for why, names in found.items())


def recognise_again(armature: bpy.types.Object, side: Side) -> Found:
    """Look for a hand's bones anew, and let go of the kept table, unless nothing is recognised, which raises
    HandModelError. Where a saved rig fits, what was found is kept instead of it."""
    _recognised.cache_clear()
    found = recognised(armature, side)
    getattr(armature.manient.character, side).hand_map = ""
    if rig_used(armature, side) is not None:
        keep_map(armature, found.hand_map)
    return found


def source_of(armature: bpy.types.Object, side: Side, context: bpy.types.Context) -> CapturedHand | None:
    """Return the captured hand that a character's hand follows: the chosen one, else a selected one of that
    side, else the only one of it that is shown, else the scene's only one; None for none. Raises OptionError
    where there are several, and where the chosen one has lost its take."""
    chosen = getattr(armature.manient.character, side).source
    if chosen is not None:
        hand = hand_of(chosen)
        if hand is None:
            raise OptionError(
                f"{chosen.name!r}, chosen for the {side} hand of {armature.name!r}, has no take any more: "
                "choose another one in the panel"
            )
        return hand
    hands = [hand for hand in map(hand_of, captured_hands(context.scene)) if hand is not None]
    own = [hand for hand in hands if hand.side == side]
    own = [hand for hand in own if not is_in_hidden_capture(hand.armature)] or own
    own = [hand for hand in own if hand.armature.select_get()] or own
    if len(own) > 1:
        names = ", ".join(hand.armature.name for hand in own[:4])
        raise OptionError(
            f"several captured {side} hands could move {armature.name!r} ({names}): choose one in the panel"
        )
    return own[0] if own else None


def sources_of(armature: bpy.types.Object, context: bpy.types.Context) -> dict[Side, CapturedHand]:
    """Return, for each side of a character's hands that gets motion, the captured hand. Raises
    OptionError."""
    found: dict[Side, CapturedHand] = {}
    for side in SIDES:
        hand = source_of(armature, side, context) if getattr(armature.manient.character, side).use else None
        if hand is not None:
            found[side] = hand
    return found


def hands_to_move(
    armature: bpy.types.Object, context: bpy.types.Context
) -> list[tuple[HandMap, CapturedHand]]:
    """Return a character's hands, each with the captured hand that it follows. A hand that the character
    lacks is left out, unless its source was chosen. Raises OptionError and HandModelError where none is
    left."""
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
            "there is no captured hand in this scene that this character could follow: capture one, import a "
            "hand take, or choose one of the other side to have it mirrored"
        )
    return found


def _is_character(obj: bpy.types.Object) -> bool:
    return obj.type == "ARMATURE" and not (has_properties() and obj.manient.is_hand)


def _deforming(obj: bpy.types.Object) -> list[bpy.types.Object | None]:
    return [m.object for m in obj.modifiers if m.type == "ARMATURE"]


def _holding(obj: bpy.types.Object) -> list[bpy.types.Object | None]:
    return [c.target for c in obj.constraints if c.type == "CHILD_OF" and not c.mute]


@functools.lru_cache(maxsize=64)
def _read(text: str) -> HandMap | None:
    try:
        return HandMap.from_json(text) if text else None
    except HandModelError:
        return None
