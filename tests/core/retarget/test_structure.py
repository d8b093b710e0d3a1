"""Hands by how bones branch and lie, whatever they are called."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, SIDES, Side
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import HandMap, the_surest
from handfit_core.retarget.structure import structured_hands

from .rigs import Built, add_hand, body

PALM = range(NUM_JOINTS, NUM_JOINTS + 4)


def hand_in(bones: Bones, side: Side) -> HandMap:
    found = the_surest(structured_hands(bones, side), bones)
    assert found is not None
    return found.hand_map


def rebuilt(bones: Bones, order: Sequence[int], parents: np.ndarray) -> Bones:
    """The bones in another order, with other parents."""
    place = {bone: number for number, bone in enumerate(order)}
    above = np.array([place.get(int(parents[bone]), -1) for bone in order])
    arrays = (array[list(order)] for array in (bones.heads, bones.tails, bones.frames, bones.inherits))
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
        found = hand_in(bones, side)
        assert found.bones == tuple(names[joint] for joint in range(NUM_JOINTS))
        assert found.palm == tuple(names[slot] if palm else "" for slot in PALM)


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
        names, found = numbered(side, palm=True), hand_in(bones, side)
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
        found = hand_in(bones, side).bones
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
        found = the_surest(structured_hands(bones, side), bones)
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
        assert hand_in(flat, side).bones[0].endswith(side)


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
    assert [*structured_hands(bones, "left"), *structured_hands(bones, "right")] == []
