"""Which bones of an armature are a hand, and what a pose is to them, one file per kind of rig. A line here
runs in Blender and knows bones by name; it knows of no take and no scene.

A `Rig` has all of MANO's joints, as the hands that captures build; a `Character` is any other armature, whose
bones a `HandMap` names.
"""

from __future__ import annotations

from typing import cast

import bpy

from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.recognition import SeveralHands

from ..common.plugins import failure_sentence, find_plugins, print_once
from .character import ArmControls, Character, Found, bones_of
from .rig import Rig

KINDS: list[type[Rig]] = find_plugins(__name__, Rig, first=("captured_hand",))
"""Every kind of rig that is known; of those that are equally sure of a hand the first is taken"""


CHARACTERS: list[type[Character]] = find_plugins(__name__, Character, needed=("label",))
"""Every kind of character rig that is known; of those that are equally sure of a hand the first is taken"""


def found_hand(armature: bpy.types.Object, side: Side) -> Found:
    """Return a character's hand of one side, of the kind that is surest of it. Raises HandModelError where no
    kind recognises one, or where a kind cannot tell which of several it is."""
    bones = bones_of(armature)
    contenders: list[Found | SeveralHands] = []
    for kind in CHARACTERS:
        try:
            found = kind.find(armature, bones, side)
        except SeveralHands as several:
            found = several
        except Exception as error:
            print_once(failure_sentence(kind, error))
            continue
        contenders += [found] if found is not None else []
    surest = max(contenders, key=lambda one: one.sure, default=None)
    if isinstance(surest, Found):
        return surest
    raise surest or HandModelError(
        f"no {side} hand was found among the {len(bones.names)} bones of {armature.name!r}: choose its bones "
        "in the table, or select another armature"
    )


def troubles(armature: bpy.types.Object, hand_map: HandMap) -> list[str]:
    """Return what would make keys on a character's hand useless, a sentence each."""
    kind = next((kind for kind in CHARACTERS if kind.label == hand_map.rig), None)
    try:
        return kind.troubles(armature, hand_map) if kind is not None else []
    except Exception as error:  # panels ask at every redraw
        print_once(failure_sentence(cast(type, kind), error))
        return []


def arm_controls(armature: bpy.types.Object, hand_map: HandMap, bones: tuple[str, str]) -> ArmControls:
    """Return the bones that get the keys of an arm whose upper arm and forearm are `bones`. Raises
    HandModelError where the kind of character fails."""
    kind = next((kind for kind in CHARACTERS if kind.label == hand_map.rig), Character)
    try:
        return kind.arm_controls(armature, hand_map, bones)
    except Exception as error:
        raise HandModelError(failure_sentence(kind, error)) from error


def rig_of(armature: bpy.types.Object, side: Side | None = None) -> Rig:
    """Return the hand of an armature, of the kind that is surest of it; `side` None: of the surer side.
    Raises HandModelError where no kind recognises a hand."""
    surest, found = 0.0, None
    for kind in KINDS:
        for one in SIDES if side is None else (side,):
            try:
                sure = kind.recognises(armature, one)
                if sure > surest:
                    surest, found = sure, kind(armature, one)
            except Exception as error:  # polls ask at every redraw
                print_once(failure_sentence(kind, error))
    if found is None:
        raise HandModelError(f"{armature.name!r} has no hand that is known here: select a captured hand")
    return found
