"""Hands by the names of their bones."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pytest

from handfit_core.common.skeleton import NUM_JOINTS, SIDES, Side
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import Found, SeveralHands, the_surest
from handfit_core.retarget.names import RIGS, Rig, named_hands, parsed

from .rigs import Built, add_hand, body, character, names_of


def hand_in(bones: Bones, side: Side, driven: Collection[str] = ()) -> Found:
    found = the_surest(named_hands(bones, side), bones, driven)
    assert found is not None
    return found


def rig_of(label: str) -> Rig:
    return next(rig for rig in RIGS if rig.label == label)


@pytest.mark.parametrize(
    ("name", "side", "exact", "left"),
    [
        ("mixamorig1:RightHandThumb1", "right", "mixamorig1handthumb1", "mixamorig1:LeftHandThumb1"),
        ("右親指０", "right", "親指0", "左親指0"),
        ("Bip001 R Finger01", "right", "bip001finger01", "Bip001 L Finger01"),
        ("lThumb1", "left", "thumb1", "lThumb1"),
        ("rMid1", "right", "middle1", "lMid1"),
        ("CC_Base_R_Pinky3", "right", "ccbaselittle3", "CC_Base_L_Pinky3"),
        ("finger1-1.R", "right", "finger1-1", "finger1-1.L"),
        ("Right Little Proximal", "right", "littleproximal", "Left Little Proximal"),
        ("righthandindex2", "right", "handindex2", "lefthandindex2"),
        ("R_HAND_JNT", "right", "hand", "L_HAND_JNT"),
        ("bright_spot", None, "brightspot", "bright_spot"),
        ("hand.L.001", "left", "hand", "hand.L"),
        ("", None, "", ""),
    ],
)
def test_names_are_taken_apart(name, side, exact, left):
    found = parsed(name)
    assert (found.side, found.exact, found.left) == (side, exact, left)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("rig", RIGS, ids=[f"{rig.label}-{rig.hand}-{rig.bones}" for rig in RIGS])
@pytest.mark.parametrize("prefix", [None, "Armature_hero01_"])
def test_every_table_is_recognised(rig, side, prefix):
    bones = character(rig, prefix)
    names = names_of(rig, side, prefix)
    found = hand_in(bones, side)
    assert found.hand_map.bones == tuple(names[joint] for joint in range(NUM_JOINTS))
    if prefix in (None, rig.prefix):
        palm = tuple(names.get(NUM_JOINTS + finger, "") for finger in range(4))
        assert (found.hand_map.rig, found.hand_map.palm) == (rig.label, palm)
        assert found.sure > 0.9


def test_several_characters_are_named():
    built, rng = Built(), np.random.default_rng(3)
    rig = rig_of("Mixamo")
    for number, prefix in enumerate(("mixamorig:", "mixamorig1:")):
        fore, place = body(built, "left", name=f"b{number}")
        add_hand(built, "left", names_of(rig, "left", prefix), rng, parent=fore, place=place + number)
    bones = built.bones()
    with pytest.raises(SeveralHands, match="'mixamorig:LeftHand', 'mixamorig1:LeftHand': choose"):
        the_surest(named_hands(bones, "left"), bones)


def test_prefers_paired_hands():
    built, rng = Built(), np.random.default_rng(3)
    hands: list[tuple[Side, str]] = [("left", "robo_"), ("left", ""), ("right", "")]
    for side, prefix in hands:
        fore, place = body(built, side, name=prefix + side)
        away = 0.5 * len(prefix)
        add_hand(built, side, names_of(RIGS[0], side, prefix), rng, parent=fore, place=place + away)
    bones = built.bones()
    assert hand_in(bones, "left").hand_map.bones[0] == "hand.L"


def test_ignores_driven_bones():
    """As a rig's controls and the deforming bones that copy them."""
    built = Built()
    fore, place = body(built, "right")
    for prefix in ("DEF-", "", "ORG-"):
        names = names_of(RIGS[0], "right", prefix)
        add_hand(built, "right", names, np.random.default_rng(1), parent=fore, place=place)
    bones = built.bones()
    driven = {name for name in bones.names if name[:3] in ("DEF", "ORG")}
    assert hand_in(bones, "right", driven).hand_map.bones[1] == "f_index.01.R"
    driven = {name for name in bones.names if name[:3] != "DEF"}
    assert hand_in(bones, "right", driven).hand_map.bones[1] == "DEF-f_index.01.R"


def test_short_fingers():
    built, rng = Built(), np.random.default_rng(3)
    rig = rig_of("Mixamo")
    fore, place = body(built, "left")
    without = (3, 6, 9, 12, 15)
    add_hand(built, "left", names_of(rig, "left"), rng, parent=fore, place=place, without=without)
    bones = built.bones()
    found = hand_in(bones, "left")
    hand = found.hand_map
    assert hand.bones[1:4] == ("mixamorig:LeftHandIndex1", "", "mixamorig:LeftHandIndex2")
    assert hand.bones[13:] == ("", "mixamorig:LeftHandThumb1", "mixamorig:LeftHandThumb2")


@pytest.mark.parametrize("side", SIDES)
def test_names_without_side(side):
    """WebXR's hands, say, lie in a file each and are called alike."""
    rig = rig_of("SMPL-X")
    names = {slot: name.removeprefix("left_") for slot, name in rig.slots.items()}
    built = Built()
    add_hand(built, side, names, np.random.default_rng(1))
    bones = built.bones()
    for other in SIDES:
        found = the_surest(named_hands(bones, other), bones)
        assert (found is not None) == (other == side)


def test_finds_no_hand():
    names = ["hand.L", "thumb.01.L", "thumb.02.L", "thumb.03.L", "f_index.01.R", "left", "right", "", "01"]
    built = Built()
    for number, name in enumerate(names):
        built.add(name, number - 1, np.array([0.0, number, 0.0]))
    assert named_hands(built.bones(), "left") == []
