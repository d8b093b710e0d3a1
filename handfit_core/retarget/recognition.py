"""Recognition of the bones of a skeleton that are a hand: by how they branch and where they lie, and by what
they are called.

A hand is a bone from which chains of bones fan out. The thumb is the chain that begins nearest the wrist and
points elsewhere; the others stand in a row away from it. Which bone is a finger's first is told by places: a
metacarpal begins near the wrist, beside the others. What lies behind the third bone is a tip.

Names choose among what the bones' places allow: they tell sides, and which finger is which. In a control rig,
where other bones lie between those of a finger, those that are called alike are looked at without the rest.
"""

from __future__ import annotations

import contextlib
import functools
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.common.errors import HandModelError
from handfit_core.common.files import shown
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, Side
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import USUAL_THUMB_ROLL, HandMap
from handfit_core.retarget.transfer import leaning, unit

LABEL: Final = "By its structure"
"""The text of `HandMap.rig` for a hand whose names say nothing"""
DOUBTFUL: Final = 0.35
"""Sureness, 0..1, below which what was found may be no hand"""
UNKNOWN: Final = "not known as a finger's"
"""The reason, as `left_out` gives it, for bones that are neither metacarpals nor tips"""
_LEAST: Final = 0.2
"""Sureness, 0..1, below which nothing is taken for a hand, as feet, jaws and hair are not"""

_WORDS: Final = re.compile(
    "(?i:left|right)|[左右]|[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|[0-9]+|(?:(?![左右])[^\\W\\d_a-zA-Z])+"
)
_LEFT_OF: Final = {"right": "left", "r": "l", "rt": "lf", "右": "左"}
_COPY: Final = re.compile(r"\.\d{3}$")
_FINGER: Final = re.compile(
    "(?P<thumb>thumb|親指|拇)|(?P<index>index|forefinger|fore(?!arm)|pointer|人(?:差し?)?指|食指)"
    "|(?P<middle>middle|mid|中指)|(?P<ring>ring|薬指|无名指)|(?P<little>little|pinky|pinkie|小指)"
)
"""Names of fingers, in several languages, as named groups"""
_GLUED: Final = re.compile(rf"[lr](?=(?:hand|wrist|finger|carpal|{_FINGER.pattern})$)")
"""A letter for the side that stands before a word without anything between, as in lindex"""
_METACARPAL: Final = re.compile("carpal|meta(?!rig)|palm|inhand")
_TIP: Final = re.compile("(?:tip|end|nub|leaf|null|先)(?:joint|jnt|bone)?$")
_FILLERS: Final = re.compile(
    "finger|fing|handstart|hand|wrist|metacarpal|carpal|meta|palm|proximal|intermediate|medial|middle|distal"
    "|phalanx|base|start|joint|jnt|bone"
)
"""Words in the name of a finger's bone that do not tell which finger it is"""
_HAND: Final = re.compile("hand|wrist|palm|thumb|finger|mitt|手|指")
"""Words of which a name must have one if two chains of bones are to be a mitten: ears, legs and straps come
in pairs, too"""
_HELPER: Final = re.compile("twist|(?<![ct])roll|helper|hlp|corrective|offset|sdk|捩")
"""Words in the names of bones that lie beside or between those of a finger and help to deform it"""
_PROP: Final = re.compile("weapon|prop|item|attach|socket|slot|hold|grip|sleeve|twist|roll|ik$")
"""Words in the names of bones that are attached to hands but are no fingers"""
_NO_HAND: Final = re.compile("toe|foot|ankle|paw|claw|hair|skirt|wing|tail|cloth|feather|足|髪|スカート")

_FINGERS_FOLLOWED: Final = {
    4: (("index",), ("middle",), ("ring",), ("little",)),
    3: (("index",), ("middle",), ("ring", "little")),
    2: (("index",), ("middle", "ring", "little")),
    1: (("index", "middle", "ring", "little"),),
}
"""The captured fingers that each finger of a hand follows, from the index on, by how many fingers the hand
has without its thumb"""
_MOST_BONES: Final = 14
"""Number of bones below a hand's child, with twists and helpers, beyond which the child begins no finger but
a limb"""
_REACH: Final = {"finger": 1.43, "thumb": 0.53}
"""Distance from the wrist to where a finger or the thumb begins, as a multiple of the length of its first two
bones, measured on our hand"""

_RIGS: Final = (
    ("Rigify bones", r"thumb\.01\.L/f_index\.01\.L"),
    ("Mixamo", r"mixamorig\d*[:_]LeftHandThumb1/.*"),
    ("Ready Player Me", "LeftHandThumb1/LeftHandIndex1"),
    ("Unreal Engine", "thumb_01_l/index_01_l"),
    ("VRM 1", "leftThumbMetacarpal/leftIndexProximal"),
    ("Godot", "LeftThumbMetacarpal/LeftIndexProximal"),
    ("VRM 0", "leftThumbProximal/leftIndexProximal"),
    ("Unity", "Left ?Thumb ?Proximal/Left ?Index ?Proximal"),
    ("VRM add-on", r"(?i:thumb\.\w+\.L/index\.proximal\.L)"),
    ("VRoid", "J_Bip_L_Thumb1/J_Bip_L_Index1"),
    ("MikuMikuDance", "左親指0/左人指1|thumb0_L/fore1_L"),
    ("Cats Blender Plugin", "Thumb0_L/IndexFinger1_L"),
    ("Reallusion", r"CC_Base_L_(?:Thumb1|Finger00)/.*"),
    ("Daz Genesis 8", "lThumb1/lIndex1"),
    ("Daz Genesis 9", "l_thumb1/l_index1"),
    ("MakeHuman", r"finger1-1\.L/finger2-1\.L"),
    ("Auto-Rig Pro", r"(?:c_)?thumb1\.l/(?:c_)?index1\.l"),
    ("SMPL-X", "left_thumb1/left_index1"),
    ("3ds Max Biped", ".*[ _]L[ _]Finger0/.*Finger1"),
    ("Advanced Skeleton", "ThumbFinger1_L/IndexFinger1_L"),
    ("Rokoko", "LeftFinger1Metacarpal/LeftFinger2Proximal"),
    ("Captured hand", r"(?i:thumb_metacarpal\.L/index_proximal\.L)"),
)
"""Names of rigs, with patterns of the names that they give to the first bones of thumb and index finger of a
left hand. The first pattern that fits counts"""
_THUMB_ROLLS: Final = {"MakeHuman": 15.0, "SMPL-X": 0.0, "Captured hand": 0.0}
"""`HandMap.thumb_roll` in degrees of the rigs for which it is not the usual one: nails of characters that
were inspected then face where ours do"""


@dataclass(frozen=True)
class Name:
    """The parts of a bone's name: its words, side and numbers."""

    side: Side | None
    words: str
    """The words of the name in small letters, without side and numbers, and without what stands between
    them"""
    numbers: tuple[int, ...]
    left: str
    """The name that the bone of the left side has"""
    copy: str
    """The number that Blender has put behind the name of a copy, as in `.001`"""

    @property
    def finger(self) -> str | None:
        """The finger that the name tells; None where it tells none."""
        found = _FINGER.search(self.words)
        return found.lastgroup if found else None

    @property
    def family(self) -> str:
        """The rest of the name besides what it says of a finger's bone, which the bones of one hand share."""
        return _FILLERS.sub("", re.sub(f"f?(?:{_FINGER.pattern})", "", self.words, count=1))


@functools.lru_cache(maxsize=8192)
def parsed(name: str) -> Name:
    """Take a bone's name apart."""
    text = unicodedata.normalize("NFKC", name)
    copy = _COPY.search(text)
    text = text[: copy.start()] if copy else text
    side: Side | None = None
    left, words, numbers, end = "", "", [], 0
    for found in _WORDS.finditer(text):
        left += text[end : found.start()]
        end = found.end()
        for part in re.split(r"(?<=\A[lrLR])", found[0]) if _GLUED.match(found[0].lower()) else [found[0]]:
            word = part.lower()
            if word in _LEFT_OF or word in _LEFT_OF.values():
                side = "right" if word in _LEFT_OF else "left"
                there = _LEFT_OF.get(word, word)
                left += there.upper() if part.isupper() else there.title() if part.istitle() else there
                continue
            left += part
            if word.isdecimal():
                numbers.append(int(word))
            else:
                words += word
    return Name(side, words, tuple(numbers), left + text[end:], copy[0] if copy else "")


@dataclass(frozen=True)
class Found:
    """A hand that was recognised among the bones of an armature."""

    hand_map: HandMap
    sure: float
    """How sure it is that this is a hand, from 0 (not at all) to 1"""
    but: str = ""
    """A sentence for the user where names were not believed; else empty"""


class SeveralHands(HandModelError):
    """Raised where an armature has several hands of one side that are as sure as each other."""

    def __init__(self, sentence: str, sure: float) -> None:
        super().__init__(sentence)
        self.sure = sure


def the_surest(found: Sequence[Found], bones: Bones, driven: Collection[str] = ()) -> Found | None:
    """Return the surest of the hands that were found on one side, which come in order of sureness; None where
    there are none.

    Where several are of one hand, as a rig's controls and the bones that follow them, it is the one with the
    fewest bones among `driven`, whose own keys would do nothing. Raises SeveralHands where two hands of the
    side are as sure as each other, as where an armature holds two characters.
    """
    found = [one for one in found if one.sure > 0.8 * found[0].sure]
    if not found:
        return None
    ends = np.array([[bones.heads[bones.index[name]] for name in _ends(one.hand_map)] for one in found])
    sizes = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
    there = np.linalg.norm(ends[:, 0] - ends[0, 0], axis=-1) < 0.5 * sizes[0]
    if not there.all():
        hands = dict.fromkeys(repr(shown(one.hand_map.bones[0])) for one in found)
        raise SeveralHands(
            f"there are several {found[0].hand_map.side} hands here, {', '.join(hands)}: choose the bones of "
            "one in the table, or separate the characters into armatures of their own",
            found[0].sure,
        )
    return min(found, key=lambda one: (sum(name in driven for name in one.hand_map.keyed), -one.sure))


def _ends(hand_map: HandMap) -> tuple[str, str]:
    """Return the names of the bones at which a palm begins and ends."""
    return hand_map.bones[0], hand_map.bones[next(j for j in (4, 1, 7, 10, 13) if hand_map.bones[j])]


def hands_in(bones: Bones, side: Side) -> list[Found]:
    """Find every hand of that side, the surest first.

    One hand may be found several times, as the controls and the deforming bones of a control rig. Where some
    have a counterpart on the other side, one that has none, such as a prosthesis, is left out.
    """
    found: dict[tuple[str, ...], Found] = {}
    for hand, chains in [*_fans(bones), *_families(bones, side)]:
        with contextlib.suppress(HandModelError):  # bones in one place or on a line are no hand
            one = _hand(bones, hand, chains)
            if one is not None and one.sure > _LEAST and one.hand_map.side == side:
                found.setdefault(one.hand_map.bones, one)
    names = [parsed(name) for name in bones.names]
    mirrored = {(name.left, name.copy) for name in names if name.side not in (side, None)}

    def paired(one: Found) -> bool:
        own = [parsed(name) for name in one.hand_map.bones if name]
        return all(name.side is None or (name.left, name.copy) in mirrored for name in own)

    ordered = sorted(found.values(), key=lambda one: -one.sure)
    return [one for one in ordered if paired(one)] or ordered


@dataclass(frozen=True)
class _Chain:
    """A chain of bones at a hand that may be a finger, as indices of the armature's bones."""

    stem: tuple[int, ...]
    """The bones between hand and finger that this chain shares with other chains"""
    own: tuple[int, ...]
    """The chain's own bones, from the hand on, without those that are called tips or helpers"""

    @classmethod
    def of(cls, bones: Bones, stem: Sequence[int], own: Sequence[int]) -> _Chain:
        own = [bone for bone in own if not _HELPER.search(parsed(bones.names[bone]).words)] or [*own]
        end = len(own)
        while end > 2 and _TIP.search(parsed(bones.names[own[end - 1]]).words):
            end -= 1
        return cls(tuple(stem), tuple(own[:end]))


def _fans(bones: Bones) -> Iterator[tuple[int, list[_Chain]]]:
    """Yield the bones from which chains hang as fingers hang from a hand, each with its chains."""
    count = len(bones.names)
    depth = np.array([not _HELPER.search(parsed(name).words) for name in bones.names], dtype=int)
    alone, size = depth.copy(), np.ones(count, dtype=int)
    for bone in range(count - 1, -1, -1):
        if (parent := bones.parents[bone]) >= 0:
            depth[parent] = max(depth[parent], depth[bone] + alone[parent])
            size[parent] += size[bone]

    def following(bone: int) -> list[int]:
        return [child for child in bones.children[bone] if depth[child] > 1]

    for hand in range(count):
        chains: list[_Chain] = []
        open_ends = [([], [child]) for child in following(hand)]
        if len(open_ends) < 2 or any(size[own[0]] > 5 * _MOST_BONES for _, own in open_ends):
            continue
        while open_ends:
            stem, own = open_ends.pop()
            deep = following(own[-1])
            if len(deep) > 1 and len(own) == 1 and not stem:
                open_ends += [(own, [child]) for child in deep]
            elif size[own[0]] > _MOST_BONES:
                chains = []  # an arm, a spine: what hangs there are no fingers
                break
            elif bones.children[own[-1]]:
                deepest = max(bones.children[own[-1]], key=lambda child: depth[child])
                open_ends.append((stem, [*own, deepest]))
            else:
                chains.append(_Chain.of(bones, stem, own))
        if len(chains) > 1:
            yield hand, chains


def _families(bones: Bones, side: Side) -> Iterator[tuple[int, list[_Chain]]]:
    """Yield the hands whose fingers are named, each with its fingers' chains, whatever other bones lie
    between theirs."""
    groups: dict[tuple[str, str, Side | None], dict[str, list[int]]] = {}
    for bone, text in enumerate(bones.names):
        name = parsed(text)
        if name.side in (side, None) and (finger := name.finger):
            group = groups.setdefault((name.family, name.copy, name.side), {})
            group.setdefault(finger, []).append(bone)
    hands = {(n.family, n.copy, n.side): b for b, t in enumerate(bones.names) if _is_hand(n := parsed(t))}
    for key, fingers in groups.items():
        chains = []
        for those in fingers.values():
            lines: dict[int, list[int]] = {}
            for bone in those:  # parents come before children
                above = next((a for a in bones.ancestors(bone) if a in lines), None)
                lines[bone] = [*(lines[above] if above is not None else ()), bone]
            chains.append(_Chain.of(bones, (), max(lines.values(), key=len)))
        hand = bones.holding([chain.own[0] for chain in chains], hands.get(key))
        if hand is not None and len(chains) > 1:
            yield hand, chains


def _is_hand(name: Name) -> bool:
    return name.finger is None and bool(re.search("hand|wrist|手首", name.words))


def _chosen(bones: Bones, chains: list[_Chain]) -> list[_Chain]:
    """Return those of the chains at a hand that are fingers, where others, such as a weapon's, hang there,
    too."""
    names = {chain: parsed(bones.names[chain.own[0]]) for chain in chains}
    chains = [chain for chain in chains if names[chain].finger or not _PROP.search(names[chain].words)]
    if len(chains) < 6:
        return chains
    family, count = Counter(names[chain].family for chain in chains).most_common(1)[0]
    return [chain for chain in chains if count < 3 or names[chain].family == family]


class _Reading:
    """A reading of the chains at a hand as fingers: where each begins, points to, and how far it stands
    apart."""

    def __init__(self, bones: Bones, hand: int, chains: list[_Chain]) -> None:
        """Read the chains at the bone `hand`. Raises HandModelError where bones lie in one place."""
        self.bones, self.chains = bones, chains
        self.wrist = bones.heads[hand]
        self.close = False
        lengths = Counter(len(chain.own) for chain in chains)
        begins = {length: self._beginning(length) for length in lengths}
        self.fingers = [chain.own[begins[len(chain.own)] :] for chain in chains]
        self.starts = [own[0] for own in self.fingers]
        self.rays = np.array([unit(self.at(start) - self.wrist) for start in self.starts])
        self.along = np.array([unit(self.at(own[:2][-1]) - self.at(own[0])) for own in self.fingers])
        self.apart = np.array([self._apart(i) for i in range(len(chains))])

    def at(self, bone: int) -> np.ndarray:
        """Return where a bone begins at rest, (3,) in the armature's space."""
        return self.bones.heads[bone]

    def far(self, bone: int) -> float:
        """Return how far from the wrist a bone begins, in the armature's units."""
        return float(np.linalg.norm(self.at(bone) - self.wrist))

    def words(self, bone: int) -> str:
        return parsed(self.bones.names[bone]).words

    def long(self, own: Sequence[int]) -> float:
        """Return the length, in the armature's units, of the way from where the first of these bones begins
        to where the last one does."""
        return float(np.linalg.norm(np.diff(self.bones.heads[list(own)], axis=0), axis=-1).sum())

    def reach(self, own: Sequence[int]) -> float:
        """Return how far from the wrist these bones begin, as a multiple of their length."""
        return self.far(own[0]) / max(self.long(own), 1e-9)

    def _beginning(self, length: int) -> int:
        """Return the index, in the chains of `length` bones, of the bone that begins at a knuckle: those
        before it are metacarpals."""
        owns = [chain.own for chain in self.chains if len(chain.own) == length]
        if length < 3 or (length == 3 and len(owns) == 1):
            return 0

        def doubt(first: int) -> float:
            last = min(first + 2, length - 1)
            usual = _REACH["finger"] * (1.0 if last == first + 2 else 1.7)
            reach = max(float(np.median([self.reach(own[first : last + 1]) for own in owns])), 1e-3)
            said = [[bool(_METACARPAL.search(self.words(bone))) for bone in own] for own in owns]
            against = sum(row[i] != (i < first) for row in said for i in range(length) if any(row))
            heads = np.array([[self.at(bone) for bone in own] for own in owns])
            spread = np.median(np.linalg.norm(heads - np.median(heads, axis=0), axis=-1), axis=0)
            # Metacarpals fan out; the first bones of fingers hardly do.
            fans = spread[first - 1] / max(spread[first], 1e-9) if first and len(owns) > 2 else 0.65
            few = 1.5 if last < first + 2 else 0.0
            return (
                abs(np.log(reach / usual))
                + 6.0 * max(0.0, np.log(max(fans, 1e-3) / 0.6))
                + few
                + against / len(owns)
            )

        doubts = [doubt(first) for first in range(length - 1)]
        self.close |= len(doubts) > 1 and np.diff(sorted(doubts))[0] < 0.2
        return int(np.argmin(doubts))

    def _apart(self, i: int) -> float:
        """Return how much a chain stands apart from the others, as thumbs do."""
        own, others = self.chains[i].own, [j for j in range(len(self.chains)) if j != i]
        usual = float(np.median([self.far(self.starts[j]) for j in others]))
        if not usual > 0.0:
            raise HandModelError("two bones begin in one place")
        shortest = all(len(own) < len(self.chains[j].own) for j in others)
        near = self.far(own[0] if shortest else self.starts[i]) / usual
        aside = unit(self.at(own[-1]) - self.at(own[0])) @ unit(self.along[others].sum(axis=0))
        return 2.0 * max(1.0 - near, 0.0) + float(np.arccos(np.clip(aside, -1.0, 1.0))) / (0.5 * np.pi)

    def row(self, thumb: int) -> tuple[list[int], np.ndarray]:
        """Return the other chains in their row, from the thumb's side on, and their places (N,) along it; by
        their directions from the wrist, as metacarpals differ in length."""
        others = [i for i in range(len(self.chains)) if i != thumb]
        rays = self.rays[others]
        _, sizes, axes = np.linalg.svd(rays - rays.mean(axis=0))
        self.is_row, row = bool(np.all(sizes[1:2] < 0.6 * sizes[0])), axes[0]
        middle = 0.5 * (self.at(self.chains[thumb].own[0]) + self.at(self.chains[thumb].own[-1]))
        row = row * np.sign(row @ (unit(middle - self.wrist) - rays.mean(axis=0)))
        order = np.argsort(-rays @ row)
        return [others[i] for i in order], (rays @ row)[order]

    def named(self) -> list[str | None]:
        """Return for each chain the finger that its name tells, or None. Where all are numbered, the thumb
        has the lowest number."""
        names = [parsed(self.bones.names[start]) for start in self.starts]
        told = [name.finger for name in names]
        counted = [name.numbers for name in names]
        if not any(told) and all("finger" in name.words or "指" in name.words for name in names):
            order = sorted(range(len(names)), key=lambda i: counted[i])
            if len(names) == 5 and len(set(counted)) == 5:
                for finger, i in zip(FINGERS, order, strict=True):
                    told[i] = finger
        return told

    def thumb_bones(self, thumb: int, behind: int) -> tuple[int, ...]:
        """Return the bones of the thumb's chain that are its own, where `behind` bones hang at the ends of
        the other fingers."""
        own = self.chains[thumb].own
        if len(own) == 2 + behind and self.reach(own[:3]) > 0.9:
            return own[:2]

        def doubt(first: int) -> float:
            reach = max(self.reach(own[first : first + 3]), 1e-3)
            return 0.5 * abs(np.log(reach / _REACH["thumb"])) + 0.25 * (len(own) - 3 - first != behind)

        first = min(range(len(own) - 2), key=doubt, default=0)
        return own[first : first + 3]


def _hand(bones: Bones, hand: int, chains: list[_Chain]) -> Found | None:
    """Return the hand that begins at a bone, with its chains as fingers; None where it is none."""
    chains = _chosen(bones, chains)
    every = [hand, *(bone for chain in chains for bone in (*chain.stem, *chain.own))]
    names = [parsed(bones.names[bone]) for bone in every]
    if not 2 <= len(chains) <= 6 or len({(chain.stem or chain.own)[0] for chain in chains}) < 2:
        return None
    if len({name.side for name in names} - {None}) > 1:  # shoulders, hips
        return None
    if len(chains) == 2 and not any(_HAND.search(name.words) for name in names):
        return None
    reading = _Reading(bones, hand, chains)
    told, but = reading.named(), ""
    thumb, likely = int(np.argmax(reading.apart)), float(reading.apart.max())
    distinct = len({finger for finger in told if finger}) == sum(map(bool, told))
    if distinct and "thumb" in told and reading.apart[told.index("thumb")] > 0.4 * likely:
        thumb = told.index("thumb")
    others, places = reading.row(thumb)
    fingers = [_FINGERS_FOLLOWED[min(len(others), 4)][min(i, 3)] for i in range(len(others))]
    called = [FINGERS.index(finger) for i in others if (finger := told[i])]
    in_row = all(np.diff(called) > 0) or np.diff(places).max() > -1e-3
    if distinct and all(told) and told[thumb] == "thumb" and len(others) < 5 and in_row:
        fingers = [(str(told[i]),) for i in others]
    agreed = sum(told[i] in own for i, own in zip(others, fingers, strict=True)) + (told[thumb] == "thumb")
    if agreed < sum(map(bool, told)):
        but = "its fingers are called otherwise than they lie: by their places they are taken"

    slots, palm = [""] * NUM_JOINTS, [""] * 4
    slots[0] = bones.names[hand]
    lengths, behind = [], []
    for i, followed in list(zip(others, fingers, strict=True))[:4]:
        own, before = reading.fingers[i], chains[i].own[: -len(reading.fingers[i])] or chains[i].stem
        lengths.append(min(len(own), 3))
        behind.append(max(len(own) - 3, 0))
        if before and not any(before[-1] in (*chains[j].stem, *chains[j].own) for j in others if j != i):
            for finger in followed:
                palm[FINGERS.index(finger) - 1] = bones.names[before[-1]]
        for finger in followed:
            joints = FINGER_JOINTS[finger] if len(own) > 2 else FINGER_JOINTS[finger][::2]
            for joint, bone in zip(joints, own, strict=False):
                slots[joint] = bones.names[bone]
    own = reading.thumb_bones(thumb, int(np.median(behind)))
    for joint, bone in zip(FINGER_JOINTS["thumb"][3 - len(own) :], own, strict=True):
        slots[joint] = bones.names[bone]
    palms = (palm[0], palm[1], palm[2], palm[3])
    label = _rig(reading, thumb, others) if agreed else LABEL
    roll = _THUMB_ROLLS.get(label, USUAL_THUMB_ROLL)
    hand_map = HandMap("left", tuple(slots), palms, rig=label, thumb_roll=roll)

    outwards = [float(reading.rays[i] @ reading.along[i]) for i in others]
    together = min(float(reading.rays[i] @ reading.rays[j]) for i in others for j in others)
    reach = [reading.long(reading.fingers[i]) for i in others]
    palm_size = np.median([reading.far(reading.starts[i]) for i in others]) / max(np.median(reach), 1e-9)
    share = agreed / len(chains)
    # Never as sure as a rig's own notes
    sure = 0.98 * (0.6 + 0.08 * min(len(chains), 5)) * (0.6 + 0.4 * share)
    sure *= 1.0 if share == 1.0 else min(1.0, likely / 0.9)
    sure *= 1.0 if min(outwards) > 0.0 and together > 0.2 and reading.is_row else 0.4
    sure *= 1.0 if 0.4 < palm_size < 4.0 and max(reach) < 3.0 * min(reach) else 0.4
    sure *= 1.0 if max(lengths) == min(lengths) and not reading.close else 0.75
    above = [parsed(bones.names[bone]) for bone in bones.ancestors(hand)]
    if "thumb" not in [name.finger for name in names]:
        around = [names[0], *(() if _is_hand(names[0]) else above[:2])]
        elsewhere = [i for i, start in enumerate(reading.starts) if _NO_HAND.search(reading.words(start))]
        if 2 * len(elsewhere) >= len(chains) or any(_NO_HAND.search(name.words) for name in around):
            sure *= 0.1
    named = next((name.side for name in (*names, *above) if name.side is not None), None)
    lean = leaning(bones, hand_map)
    # Bend of the fingers, see `leaning`, below which it does not tell the side
    if abs(lean) < 0.02:
        lean, sure = float(reading.wrist[0]), sure * (1.0 if named else 0.7)
    return Found(replace(hand_map, side=named or ("left" if lean > 0.0 else "right")), sure, but)


def _rig(reading: _Reading, thumb: int, others: list[int]) -> str:
    """Return the name of the rig whose bones are named so, or a phrase that says how the hand was read where
    no rig's are."""
    first = [parsed(reading.bones.names[reading.starts[i]]).left for i in (thumb, others[0])]
    said = "/".join(re.sub(r"^(?:DEF-|(?!mixamorig)\w+:)", "", name) for name in first)
    return next((label for label, pattern in _RIGS if re.fullmatch(pattern, said)), "By names and structure")


def left_out(bones: Bones, hand_map: HandMap) -> dict[str, list[str]]:
    """Return the names of the bones below a hand's own that its motion is not keyed on, by the reason why
    not."""
    hand, keyed = bones.index[hand_map.bones[0]], {bones.index[name] for name in hand_map.keyed}
    before = {above for bone in keyed for above in bones.ancestors(bone)}
    found: dict[str, list[str]] = {}
    for bone, name in enumerate(bones.names):
        if bone in keyed or hand not in bones.ancestors(bone):
            continue
        why = UNKNOWN
        if bone in before or name in hand_map.palm or _METACARPAL.search(parsed(name).words):
            why = "between hand and fingers"
        elif bones.parents[bone] in keyed - before:
            why = "at the tips"
        found.setdefault(why, []).append(name)
    return found


_FOREARM = ("forearm", "lowerarm", "elbow", "ひじ", "前腕")
_UPPER_ARM = ("arm", "shldr", "腕")
_NOT_ARM = ("twist", "roll", "捩", "armature")
"""Words that tell forearms and upper arms in `Name.words`, and words that no bone of an arm has; a clavicle
may be called a shoulder, as an upper arm may"""


def named_arm(chain: Sequence[str]) -> tuple[int, int] | None:
    """Return which of the bones above a hand, whose names come nearest first, are upper arm and forearm by
    their names, as two indices; of those that are split into parts, the first part. None where names do not
    tell."""

    def last(words: tuple[str, ...], start: int, without: tuple[str, ...]) -> int | None:
        held = [i for i in range(start, len(plain)) if any(word in plain[i] for word in words)]
        held = [i for i in held if not any(word in plain[i] for word in without)]
        return held[-1] if held else None

    plain = [parsed(name).words for name in chain]
    fore = last(_FOREARM, 0, _NOT_ARM)
    if fore is None:
        return None
    upper = last(_UPPER_ARM, fore + 1, (*_NOT_ARM, *_FOREARM))
    upper = last(("shoulder",), fore + 1, _NOT_ARM) if upper is None else upper
    return None if upper is None else (upper, fore)
