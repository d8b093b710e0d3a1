"""Hands of skeletons: by how their bones branch and lie, and by what they are called."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, SIDES, Side
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.recognition import (
    DOUBTFUL,
    Found,
    SeveralHands,
    hands_in,
    left_out,
    parsed,
    the_surest,
)

from .rigs import OTHERS, RIGS, Built, Rig, add_hand, body, character, names_of

PALM = range(NUM_JOINTS, NUM_JOINTS + 4)


def hand_in(bones: Bones, side: Side, driven: Collection[str] = ()) -> Found:
    found = the_surest(hands_in(bones, side), bones, driven)
    assert found is not None
    return found


def rig_of(label: str) -> Rig:
    return next(rig for rig in RIGS if rig.label == label)


def rebuilt(bones: Bones, order: Sequence[int], parents: np.ndarray) -> Bones:
    """The bones in another order, with other parents."""
    place = {bone: number for number, bone in enumerate(order)}
    above = np.array([place.get(int(parents[bone]), -1) for bone in order])
    arrays = (array[list(order)] for array in (bones.heads, bones.tails, bones.frames))
    return Bones(tuple(bones.names[bone] for bone in order), above, *arrays)


def numbered(side, palm=False):
    """Names that say nothing, not even their order."""
    order = np.random.default_rng(9).permutation(NUM_JOINTS + 4)
    return {
        slot: f"x{order[slot]:02d}{'ab'[side == 'left']}" for slot in range(NUM_JOINTS + (4 if palm else 0))
    }


def two_hands(rng, *, palm=False, names=numbered, **options):
    built = Built()
    for side in SIDES:
        fore, place = body(built, side)
        add_hand(built, side, names(side, palm), rng, parent=fore, place=place, **options)
    return built.bones()


def turned(bones: Bones, turn: np.ndarray, scale: float) -> Bones:
    heads = scale * bones.heads @ turn.T + 3.0
    return replace(bones, heads=heads, tails=heads + scale)


@pytest.mark.parametrize("tips", [False, True], ids=["", "tips"])
@pytest.mark.parametrize("palm", [False, True], ids=["", "palm"])
@pytest.mark.parametrize("seed", range(4))
def test_finds_bones_by_place(seed, palm, tips):
    rng = np.random.default_rng(seed)
    bones = two_hands(rng, palm=palm, tips=tips, bend=np.radians(25.0), stretch=0.2)
    bones = turned(bones, rotvec_to_rotmat(rng.normal(size=3)), float(np.exp(rng.uniform(-4.0, 4.0))))
    for side in SIDES:
        names = numbered(side, palm)
        found = hand_in(bones, side).hand_map
        assert found.bones == tuple(names[joint] for joint in range(NUM_JOINTS))
        assert found.palm == tuple(names[slot] if palm else "" for slot in PALM)


@pytest.mark.parametrize("palm", [False, True], ids=["", "palm"])
@pytest.mark.parametrize("tips", [False, True], ids=["", "tips"])
@pytest.mark.parametrize("curl", [-1.0, 0.0, 3.0, 5.5])
def test_finds_bones_of_fists(curl, palm, tips):
    """And of fingers that are bent backwards."""
    bones = two_hands(np.random.default_rng(1), palm=palm, tips=tips, curl=curl)
    for side in SIDES:
        names = numbered(side, palm)
        assert hand_in(bones, side).hand_map.bones == tuple(names[joint] for joint in range(NUM_JOINTS))
        assert hand_in(bones, side).sure > DOUBTFUL


@pytest.mark.parametrize("more", [1, 2])
@pytest.mark.parametrize("palm", [False, True], ids=["", "palm"])
@pytest.mark.parametrize("where", ["tip", "root", "twist"])
def test_bones_of_which_some_fingers_have_more(where, palm, more):
    """Tips of the thumb alone, a bone before its metacarpal as Oculus' hands have, twists beside bones."""
    names = numbered("left", palm)
    built, whole = Built(), Built()
    add_hand(built, "left", names, np.random.default_rng(1), place=np.array([0.6, 0.0, 1.4]))
    place: dict[int, int] = {}
    for bone, (name, above, head) in enumerate(zip(built.names, built.parents, built.heads, strict=True)):
        parent = place.get(above, -1)
        if where == "root" and name == names[13]:
            parent = whole.add("more", parent, 0.7 * built.heads[0] + 0.3 * head)
        place[bone] = last = whole.add(name, parent, head)
        if where == "twist" or (where == "tip" and name == names[15]):
            for part in range(more):
                on = head - built.heads[above]
                last = whole.add(f"{where}_{name}_{part}", last, head + 0.3 * (part + 1) * on)
    found = hand_in(whole.bones(), "left").hand_map
    assert found.bones == tuple(names[joint] for joint in range(NUM_JOINTS))


def test_thumb_on_metacarpal():
    """As Rigify's first one does."""
    bones = two_hands(np.random.default_rng(2), palm=True)
    parents = bones.parents.copy()
    for side in SIDES:
        names = numbered(side, palm=True)
        parents[bones.index[names[13]]] = bones.index[names[NUM_JOINTS]]
    order: list[int] = []
    while len(order) < len(parents):
        order += [
            b for b in range(len(parents)) if b not in order and (parents[b] < 0 or parents[b] in order)
        ]
    bones = rebuilt(bones, order, parents)
    for side in SIDES:
        names, found = numbered(side, palm=True), hand_in(bones, side).hand_map
        assert found.bones == tuple(names[joint] for joint in range(NUM_JOINTS))
        assert found.palm == tuple(names[slot] for slot in PALM)


@pytest.mark.parametrize("fingers", [3, 4])
@pytest.mark.parametrize("bones_each", [2, 3])
def test_hands_of_toons(fingers, bones_each):
    """With fewer fingers, and two bones in each."""
    gone = {3: ("middle", "ring"), 4: ("ring",)}[fingers]
    without = [joint for finger in gone for joint in FINGER_JOINTS[finger]]
    if bones_each == 2:
        without += [FINGER_JOINTS[finger][2 if finger == "thumb" else 1] for finger in FINGERS]
    bones = two_hands(np.random.default_rng(4), without=tuple(without))
    for side in SIDES:
        names = numbered(side)
        found = hand_in(bones, side).hand_map.bones
        for finger in set(FINGERS) - set(gone):
            joints = FINGER_JOINTS[finger]
            wanted = tuple(names[j] if j not in without else "" for j in joints)
            if finger == "thumb" and bones_each == 2:  # short ones bend as ours do from the knuckle on
                wanted = ("", *wanted[:2])
            assert tuple(found[j] for j in joints) == wanted, finger
        last = [found[j] for j in FINGER_JOINTS["little"]]
        for finger in gone:  # their motion is not lost: the last finger takes the mean
            assert [found[j] for j in FINGER_JOINTS[finger]] == last


@pytest.mark.parametrize("hint", ["", "mitten_"])
def test_mittens(hint):
    """Its one finger follows all four of ours: ears and straps come in pairs, too."""
    without = tuple(joint for f in ("index", "ring", "little") for joint in FINGER_JOINTS[f])

    def named(side, palm):
        return {slot: hint + name for slot, name in numbered(side, palm).items()}

    bones = two_hands(np.random.default_rng(5), without=without, names=named)
    for side in SIDES:
        found = the_surest(hands_in(bones, side), bones)
        assert (found is None) == (not hint)
        if found is None:
            continue
        names = named(side, False)
        for finger, joints in FINGER_JOINTS.items():
            wanted = joints if finger == "thumb" else FINGER_JOINTS["middle"]
            assert [found.hand_map.bones[j] for j in joints] == [names[j] for j in wanted]


def test_side_of_flat_hand():
    def named(side, palm):
        return {slot: f"{name}_{side}" for slot, name in numbered(side, palm).items()}

    bones = two_hands(np.random.default_rng(1), names=named)
    flat = replace(bones, heads=bones.heads * [1.0, 1.0, 0.0])
    for side in SIDES:
        assert hand_in(flat, side).hand_map.bones[0].endswith(side)


def test_feet_and_hair_are_no_hands():
    """Toes stand in a row and none of them apart; hair hangs down around a head."""
    built = Built()
    hips = built.add("a", -1, np.zeros(3))
    shin = built.add("b", hips, np.array([0.1, 0.0, -0.5]))
    foot = built.add("c", shin, np.array([0.1, 0.0, -0.95]))
    head = built.add("d", hips, np.array([0.0, 0.0, 0.6]))
    for strand in range(5):
        at = 2.0 * np.pi * strand / 5.0
        root = np.array([0.1 * np.cos(at), 0.1 * np.sin(at), 0.7])
        toe = np.array([0.06 + 0.02 * strand, -0.12, -1.0])
        hair, last = head, foot
        for part in range(3):
            last = built.add(f"t{strand}{part}", last, toe - [0.0, 0.03 * part, 0.0])
            hair = built.add(f"h{strand}{part}", hair, root - [0.0, 0.0, 0.1 * part])
    bones = built.bones()
    assert [*hands_in(bones, "left"), *hands_in(bones, "right")] == []


@pytest.mark.parametrize(
    ("foot", "toes"),
    [
        ("foot_l", ["BigToe", "IndexToe", "MidToe", "RingToe", "PinkyToe"]),
        ("foot_l", ["finger1_", "finger2_", "finger3_", "finger4_", "finger5_"]),
        ("左足首", ["左足指1_", "左足指2_", "左足指3_", "左足指4_", "左足指5_"]),
        ("paw_l", ["a", "b", "c", "d", "e"]),
        ("x", ["a", "b", "c", "d", "e"]),
    ],
)
def test_toes_are_no_fingers(foot, toes):
    """However they are called."""
    built = Built()
    last = built.add(foot, built.add("y", -1, np.array([0.1, 0.0, 0.5])), np.array([0.1, 0.02, 0.08]))
    ball = built.add("z", last, np.array([0.1, -0.1, 0.02]))
    for number, toe in enumerate(toes):
        last = ball
        for part in range(2 if number == 0 else 3):
            forward = 0.12 + 0.02 * part + 0.005 * (2 - abs(number - 2))
            at = np.array([0.085 + 0.013 * number, -forward, 0.015 - 0.004 * part * (part > 1)])
            last = built.add(f"{toe}{part}", last, at)
    found = [one for side in SIDES for one in hands_in(built.bones(), side)]
    assert all(one.sure < DOUBTFUL for one in found)


def test_hands_without_side_beside_paired_wings():
    bones = two_hands(np.random.default_rng(1))
    built = Built([*bones.names], [*bones.parents], [*bones.heads])
    for side, sign in (("L", 1.0), ("R", -1.0)):
        wing = built.add(f"w.{side}", 1, np.array([sign * 0.9, 0.2, 1.8]))
        for finger in range(4):
            last, turn = wing, np.radians(10.0 - 35.0 * finger)
            out = np.array([sign * np.cos(turn), 0.0, np.sin(turn)])
            for part in range(3):
                head = built.heads[wing] + (0.02 + 0.3 * part) * out
                last = built.add(f"u{finger}{part}.{side}", last, head)
        claw = built.add(f"v0.{side}", wing, built.heads[wing] + [0.02 * sign, 0.0, 0.03])
        built.add(f"v1.{side}", claw, built.heads[wing] + [0.04 * sign, -0.03, 0.06])
    for side in SIDES:
        assert hand_in(built.bones(), side).hand_map.bones[0] == numbered(side)[0]


def test_six_fingers_of_another_language():
    words = "Daumen Zeigefinger Mittelfinger Ringfinger Kleinfinger".split()
    built = Built()
    names = {0: "Hand_L"}
    for word, joints in zip(words, FINGER_JOINTS.values(), strict=True):
        names |= {joint: f"{word}_{part}_L" for part, joint in enumerate(joints)}
    add_hand(built, "left", names, np.random.default_rng(1))
    last = 0
    for part in range(3):
        ring, little = (built.heads[built.names.index(names[joint + part])] for joint in (10, 7))
        last = built.add(f"Sechster_{part}_L", last, 1.9 * little - 0.9 * ring)
    assert hand_in(built.bones(), "left").hand_map.bones == tuple(names[j] for j in range(NUM_JOINTS))


@pytest.mark.parametrize(
    ("name", "side", "words", "numbers", "left"),
    [
        ("mixamorig1:RightHandThumb1", "right", "mixamorighandthumb", (1, 1), "mixamorig1:LeftHandThumb1"),
        ("右親指０", "right", "親指", (0,), "左親指0"),
        ("Bip001 R Finger01", "right", "bipfinger", (1, 1), "Bip001 L Finger01"),
        ("rMid1", "right", "mid", (1,), "lMid1"),
        ("lindex0", "left", "index", (0,), "lindex0"),
        ("finger1-1.R", "right", "finger", (1, 1), "finger1-1.L"),
        ("Right Little Proximal", "right", "littleproximal", (), "Left Little Proximal"),
        ("righthandindex2", "right", "handindex", (2,), "lefthandindex2"),
        ("bright_spot", None, "brightspot", (), "bright_spot"),
        ("hand.L.001", "left", "hand", (), "hand.L"),
        ("", None, "", (), ""),
    ],
)
def test_names_are_taken_apart(name, side, words, numbers, left):
    found = parsed(name)
    assert (found.side, found.words, found.numbers, found.left) == (side, words, numbers, left)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("rig", [*RIGS, *OTHERS], ids=lambda rig: f"{rig.label}-{rig.hand}-{rig.bones}")
def test_every_naming_is_recognised(rig, side):
    """On hands of other proportions that rest bent, too: digits count neither joints nor metacarpals."""
    names = names_of(rig, side)
    for seed in range(4):
        bones = character(rig, seed=seed, bend=np.radians(20.0) * (seed > 0), stretch=0.2 * (seed > 0))
        found = hand_in(bones, side)
        assert found.hand_map.bones == tuple(names[joint] for joint in range(NUM_JOINTS))
        assert found.hand_map.palm == tuple(names.get(slot, "") for slot in PALM)
        assert (found.hand_map.rig, found.but) == (rig.label, "")
        assert found.sure > (0.9 if rig in RIGS else 0.5)
        keyed = sum(slot not in found.hand_map.keyed for slot in names.values())
        assert sum(map(len, left_out(bones, found.hand_map).values())) == keyed - 1  # the hand itself


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("rig", RIGS, ids=lambda rig: f"{rig.label}-{rig.hand}-{rig.bones}")
def test_prefixes_do_no_harm(rig, side):
    names = names_of(rig, side, "Armature_hero01_")
    found = hand_in(character(rig, "Armature_hero01_"), side)
    assert found.hand_map.bones == tuple(names[joint] for joint in range(NUM_JOINTS))


def test_several_characters_are_named():
    built, rng = Built(), np.random.default_rng(3)
    rig = rig_of("Mixamo")
    for number, prefix in enumerate(("mixamorig:", "mixamorig1:")):
        fore, place = body(built, "left", name=f"b{number}")
        add_hand(built, "left", names_of(rig, "left", prefix), rng, parent=fore, place=place + number)
    bones = built.bones()
    with pytest.raises(SeveralHands, match="'mixamorig:LeftHand', 'mixamorig1:LeftHand': choose"):
        the_surest(hands_in(bones, "left"), bones)


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
        found = the_surest(hands_in(bones, other), bones)
        assert (found is not None) == (other == side)


@pytest.mark.parametrize("side", SIDES)
def test_places_stand_above_names(side):
    """A thumb that is called a ring finger is a thumb, and that is said."""
    names = names_of(rig_of("Mixamo"), side)
    called = ("Ring", "Middle", "Thumb", "Pinky", "Index")
    usual = ("Thumb", "Index", "Middle", "Ring", "Pinky")
    for joints, own, wrong in zip(FINGER_JOINTS.values(), usual, called, strict=True):
        for joint in joints:
            names[joint] = names[joint].replace(own, wrong)
    built = Built()
    fore, place = body(built, side)
    add_hand(built, side, names, np.random.default_rng(1), parent=fore, place=place)
    found = hand_in(built.bones(), side)
    assert found.hand_map.bones == tuple(names[joint] for joint in range(NUM_JOINTS))
    assert "otherwise than they lie" in found.but
    assert found.sure < 0.75


def test_what_hangs_on_hands_is_no_finger():
    """A sword, a sleeve, helpers beside a finger's bones, and a sixth finger, which is left out."""
    built, names = Built(), numbered("left")
    fore, place = body(built, "left")
    add_hand(built, "left", names, np.random.default_rng(1), parent=fore, place=place)
    hand, index = built.names.index(names[0]), built.names.index(names[2])
    built.add("helper", index, built.heads[index])
    last = hand
    for part in range(3):
        last = built.add(f"weapon{part}", last, place - [0.0, 0.1 + 0.1 * part, 0.0])
    last = hand
    for part in range(3):
        ring, little = (built.heads[built.names.index(names[joint + part])] for joint in (10, 7))
        last = built.add(f"sixth{part}", last, 1.9 * little - 0.9 * ring)
    bones = built.bones()
    found = hand_in(bones, "left").hand_map
    assert found.bones == tuple(names[joint] for joint in range(NUM_JOINTS))
    assert set(left_out(bones, found)["not known as a finger's"]) == {
        *("helper", "weapon0", "weapon1", "weapon2", "sixth0", "sixth1", "sixth2")
    }


@pytest.mark.parametrize("named", [True, False])
def test_what_fans_out_otherwise_is_no_hand(named):
    """A body without fingers, whose chest holds a head and two arms; a tail with five ends."""
    built = Built()
    hips = built.add("hips", -1, np.array([0.0, 0.0, 1.0]))
    chest = built.add("chest", built.add("spine", hips, np.array([0.0, 0.0, 1.1])), np.array([0.0, 0.0, 1.3]))
    built.add("head", built.add("neck", chest, np.array([0.0, 0.0, 1.5])), np.array([0.0, 0.0, 1.6]))
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        last, leg = chest, hips
        for part in range(4):
            end = f"{side}{part}" if named else f"{len(side)}{part}"
            last = built.add(
                f"arm{end}", last, np.array([sign * (0.05 + 0.2 * part), 0.0, 1.45 - 0.1 * part])
            )
            leg = built.add(f"leg{end}", leg, np.array([sign * 0.1, -0.02 * part, 0.95 - 0.3 * part]))
    tail = hips
    for part in range(4):
        tail = built.add(f"tail{part}", tail, np.array([0.0, 0.2 + 0.2 * part, 1.0]))
    for end in range(5):
        at, last = 2.0 * np.pi * end / 5.0, tail
        for part in range(3):
            out = 0.1 * (part + 1) * np.array([np.cos(at), 0.0, np.sin(at)])
            last = built.add(f"end{end}{part}", last, out + [0.0, 0.9 + 0.03 * part, 1.0])
    bones = built.bones()
    assert all(found.sure < DOUBTFUL for side in SIDES for found in hands_in(bones, side))


def test_the_fingers_of_a_control_rig_with_groups_between():
    """As Maya's, whose controls each have groups of their own above them."""
    plain, built = Built(), Built()
    add_hand(plain, "left", names_of(rig_of("Rigify bones"), "left", "ctl_"), np.random.default_rng(0))
    place: dict[int, int] = {}
    for bone, (name, parent, head) in enumerate(zip(plain.names, plain.parents, plain.heads, strict=True)):
        above = place.get(parent, -1)
        for group in ("grp_", "sdk_") if parent >= 0 else ():
            above = built.add(group + name, above, head)
        place[bone] = built.add(name, above, head)
    bones = built.bones()
    driven = {name for name in bones.names if not name.startswith("ctl")}
    names = names_of(rig_of("Rigify bones"), "left", "ctl_")
    assert hand_in(bones, "left", driven).hand_map.bones == tuple(names[j] for j in range(NUM_JOINTS))
