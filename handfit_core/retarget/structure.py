"""Which bones are a hand, whatever they are called: by how they branch and where they lie.

A hand is a bone from which chains of bones fan out. The thumb is the one that begins nearest the wrist and
points elsewhere; the others stand in a row away from it. Metacarpals and bones at the tips are distinguished
from the three bones of a finger by where they begin and by how many there are.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, Side
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import USUAL_THUMB_ROLL, Found, HandMap
from handfit_core.retarget.names import parsed
from handfit_core.retarget.transfer import leaning, unit

LABEL = "By its structure"
_TIP = re.compile(r"(tip|end|nub|leaf|先)[._\s]?(l|r|left|right)?$", re.IGNORECASE)
_NO_HAND = re.compile(r"toe|foot|hair|skirt|wing|tail|cloth|feather|足|髪|スカート", re.IGNORECASE)
_HAND = re.compile(r"hand|wrist|palm|thumb|finger|mitt|手|指", re.IGNORECASE)
"""Words of which a name needs one for two chains to be a mitten: ears, legs and straps come in pairs, too"""
_FINGERS_FOLLOWED = {
    4: (("index",), ("middle",), ("ring",), ("little",)),
    3: (("index",), ("middle",), ("ring", "little")),
    2: (("index",), ("middle", "ring", "little")),
    1: (("index", "middle", "ring", "little"),),
}
"""Captured fingers that the fingers of a hand follow, by their number without the thumb, from the index on"""


def structured_hands(bones: Bones, side: Side) -> list[Found]:
    """Every hand of that side that the bones' tree and places tell of, the surest first.

    Names tell the side where they do, else how fingers bend, else that characters have their left at +X."""
    depth = np.ones(len(bones.names), dtype=int)
    for bone in range(len(depth) - 1, -1, -1):
        if (parent := bones.parents[bone]) >= 0:
            depth[parent] = max(depth[parent], depth[bone] + 1)
    found = []
    for hand in range(len(depth)):
        try:
            guess = _hand(bones, hand, depth)
        except HandModelError:  # bones in one place or on a line are no hand
            continue
        # Least confidence of a hand: feet, jaws and hair stay below
        if guess is not None and guess.sure > 0.2 and guess.hand_map.side == side:
            found.append(guess)
    return sorted(found, key=lambda one: -one.sure)


def _chains(bones: Bones, hand: int, depth: np.ndarray) -> list[tuple[list[int], list[int]]]:
    """The chains that hang from a bone like fingers: for each, the bones it shares with others, and its
    own."""
    found: list[tuple[list[int], list[int]]] = []
    open_ends = [([], [child]) for child in bones.children[hand] if depth[child] > 1]
    while open_ends:
        stem, own = open_ends.pop()
        deep = [child for child in bones.children[own[-1]] if depth[child] > 1]
        if len(deep) > 1:
            if len(stem) + len(own) > 1:
                return []  # an arm, a spine: what hangs there are no fingers
            open_ends += [(own, [child]) for child in deep]
        # Bones in a finger: metacarpal, three, and one at its tip
        elif len(own) > 5:
            return []
        elif bones.children[own[-1]]:
            open_ends.append((stem, [*own, deep[0] if deep else bones.children[own[-1]][0]]))
        else:
            found.append((stem, own[:-1] if len(own) > 2 and _TIP.search(bones.names[own[-1]]) else own))
    return found


def _hand(bones: Bones, hand: int, depth: np.ndarray) -> Found | None:
    """The hand that begins at a bone; None where it is none."""
    chains = _chains(bones, hand, depth)
    if not 2 <= len(chains) <= 5 or len({(stem or own)[0] for stem, own in chains}) < 2:
        return None
    every = [hand, *(bone for stem, own in chains for bone in (*stem, *own))]
    if len(chains) == 2 and not any(_HAND.search(bones.names[bone]) for bone in every):
        return None
    wrist = bones.heads[hand]

    def far(bone: int) -> float:
        return float(np.linalg.norm(bones.heads[bone] - wrist))

    # A metacarpal begins nearer the wrist than it is long; a finger's first bone does not.
    rooted = [
        far(own[0]) < np.linalg.norm(bones.heads[own[1]] - bones.heads[own[0]])
        for stem, own in chains
        if not stem
    ]
    has_palm = 2 * sum(rooted) > len(rooted)
    shortest = min(len(own) for _, own in chains)
    starts = [own[int(has_palm and not stem and len(own) > 2)] for stem, own in chains]
    ends = [own[-1] for _, own in chains]
    along = [unit(bones.heads[e] - bones.heads[start]) for e, start in zip(ends, starts, strict=True)]
    likely = np.zeros(len(chains))
    for i, (_, own) in enumerate(chains):
        others = [j for j in range(len(chains)) if j != i]
        usual = float(np.median([far(starts[j]) for j in others]))
        if not usual > 0.0:
            raise HandModelError("two bones begin in one place")
        near = far(own[0]) / usual if len(own) == shortest else 1.0
        aside = unit(bones.heads[ends[i]] - bones.heads[own[0]]) @ unit(
            np.sum([along[j] for j in others], axis=0)
        )
        likely[i] = 2.0 * max(1.0 - near, 0.0) + np.arccos(np.clip(aside, -1.0, 1.0)) / (0.5 * np.pi)
    thumb = int(np.argmax(likely))
    others = [i for i in range(len(chains)) if i != thumb]

    # By their directions from the wrist, as metacarpals differ in length.
    rays = np.array([unit(bones.heads[starts[i]] - wrist) for i in others])
    row = np.linalg.svd(rays - rays.mean(axis=0))[2][0]
    start, end = bones.heads[chains[thumb][1][0]], bones.heads[ends[thumb]]
    row = row * np.sign(row @ (unit(0.5 * (start + end) - wrist) - rays.mean(axis=0)))
    others = [others[i] for i in np.argsort(-rays @ row)]

    slots, palm = [""] * NUM_JOINTS, [""] * 4
    slots[0] = bones.names[hand]
    lengths = []
    for number, i in enumerate(others):
        stem, own = chains[i]
        fingers = _FINGERS_FOLLOWED[len(others)][number]
        first = own.index(starts[i])
        own, before = own[first:], own[:first] or stem
        lengths.append(len(own))
        if before and not any(before[-1] in (*chains[j][0], *chains[j][1]) for j in others if j != i):
            for finger in fingers:
                palm[FINGERS.index(finger) - 1] = bones.names[before[-1]]
        for finger in fingers:
            joints = FINGER_JOINTS[finger] if len(own) > 2 else FINGER_JOINTS[finger][::2]
            for joint, bone in zip(joints, own, strict=False):
                slots[joint] = bones.names[bone]
    own = chains[thumb][1]
    own = (own[:-1] if np.median(lengths) > 3 and len(own) > 2 else own)[-3:]
    for joint, bone in zip(FINGER_JOINTS["thumb"][3 - len(own) :], own, strict=True):
        slots[joint] = bones.names[bone]
    hand_map = HandMap(
        "left", tuple(slots), (palm[0], palm[1], palm[2], palm[3]), rig=LABEL, thumb_roll=USUAL_THUMB_ROLL
    )

    outwards = [unit(bones.heads[starts[i]] - wrist) @ along[i] for i in others]
    reach = [np.linalg.norm(bones.heads[ends[i]] - bones.heads[starts[i]]) for i in others]
    palm_size = np.median([far(starts[i]) for i in others]) / max(np.median(reach), 1e-9)
    sure = 0.6 * (0.6 + 0.08 * len(chains)) * min(1.0, likely[thumb] / 0.8)
    sure *= 1.0 if min(outwards) > 0.2 else 0.4
    sure *= 1.0 if 0.4 < palm_size < 4.0 and max(reach) < 3.0 * min(reach) else 0.4
    sure *= 1.0 if max(lengths) == min(lengths) else 0.8
    if any(_NO_HAND.search(bones.names[bone]) for bone in every):
        sure *= 0.1
    sides = [parsed(bones.names[bone]).side for bone in (*every, *bones.ancestors(hand))]
    named = next((side for side in sides if side is not None), None)
    lean = leaning(bones, hand_map)
    # Bend of the fingers, see `leaning`, below which it does not tell the side
    if abs(lean) < 0.02:
        lean, sure = float(wrist[0]), sure * (1.0 if named else 0.7)
    return Found(replace(hand_map, side=named or ("left" if lean > 0.0 else "right")), sure)
