"""Which bones are a hand, by the names that programs give them.

A name is taken apart into words, its side among them, and compared with the tables of `RIGS` from its end, so
that any prefix may stand before. No single name decides: "ThumbProximal" is the thumb's first bone in one
rig and its second in another. The table that explains most of the bones does, as far as they hang on each
other as fingers do.
"""

from __future__ import annotations

import contextlib
import functools
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, Side
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import PALM_FINGERS, USUAL_THUMB_ROLL, Found, HandMap
from handfit_core.retarget.transfer import leaning

_WORDS = re.compile(
    "(?i:left|right)|[左右]|[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|[0-9]+|(?:(?![左右])[^\\W\\d_a-zA-Z])+"
)
_LEFT_OF = {"right": "left", "r": "l", "rt": "lf", "右": "左"}
_ALIKE = {"pinky": "little", "pinkie": "little", "mid": "middle"}
_COPY = re.compile(r"\.\d{3}$")
_ZEROS = re.compile(r"(?<!\d)0+(?=\d)")


@dataclass(frozen=True)
class Name:
    """A bone's name, taken apart."""

    side: Side | None
    exact: str
    """its words without the side, in small letters and without what stands between them; numbers that follow
    each other are kept apart"""
    plain: str
    """`exact`, with numbers without leading zeros"""
    left: str
    """how the bone of the left side is called"""
    copy: str
    """the number that Blender has put behind it, as in `.001`"""


@functools.lru_cache(maxsize=8192)
def parsed(name: str) -> Name:
    """A bone's name, taken apart."""
    text = unicodedata.normalize("NFKC", name)
    copy = _COPY.search(text)
    text = text[: copy.start()] if copy else text
    side: Side | None = None
    left, exact, plain, end = "", "", "", 0
    for found in _WORDS.finditer(text):
        word = found[0].lower()
        left += text[end : found.start()]
        end = found.end()
        if word in _LEFT_OF or word in _LEFT_OF.values():
            side = "right" if word in _LEFT_OF else "left"
            there = _LEFT_OF.get(word, word)
            left += there.upper() if found[0].isupper() else there.title() if found[0].istitle() else there
            continue
        left += found[0]
        if word not in {"jnt", "joint", "bone", "bind", "skin"}:
            between = "-" if word.isdigit() and exact[-1:].isdigit() else ""
            exact += between + _ALIKE.get(word, word)
            plain += between + (str(int(word)) if word.isdigit() else _ALIKE.get(word, word))
    return Name(side, exact, plain, left + text[end:], copy[0] if copy else "")


@dataclass(frozen=True)
class Rig:
    """How a kind of rig calls a left hand's bones. `{}` stands for a finger, then for one of its bones."""

    label: str
    hand: str
    bones: str
    """One name for all of a finger's bones, or three that `|` parts"""
    fingers: str = "thumb index middle ring pinky"
    parts: tuple[str, ...] = ("1", "2", "3")
    thumb: tuple[str, ...] = ()
    """The thumb's bones, where they are called otherwise than a finger's"""
    palm: str = ""
    """The metacarpals, likewise, or all four"""
    prefix: str = ""
    """The usual prefix of each name; others are recognised, too"""
    thumb_roll: float = USUAL_THUMB_ROLL
    """degrees, see `HandMap.thumb_roll`: with it, nails of characters that were inspected face where ours
    do"""

    @functools.cached_property
    def slots(self) -> dict[int, str]:
        """The names without prefix: by MANO's joints, and 16 to 19 for the metacarpals of `PALM_FINGERS`."""
        words: dict[str, str] = dict(zip(FINGERS, self.fingers.split(), strict=True))
        named = {0: self.hand}
        bones = (self.bones.split("|") * 3)[:3]
        for finger, joints in FINGER_JOINTS.items():
            parts = self.thumb if finger == "thumb" and self.thumb else self.parts
            for joint, bone, part in zip(joints, bones, parts, strict=True):
                named[joint] = bone.format(words[finger], part)
        for number, finger in enumerate(PALM_FINGERS if self.palm else ()):
            palm = (self.palm.split("|") * 4)[number]
            named[NUM_JOINTS + number] = palm.format(words[finger])
        return named

    @functools.cached_property
    def keys(self) -> dict[str, int]:
        """Slot by what `parsed` makes of its name; numbers may have other zeros before them where that
        leaves no doubt."""
        names = {slot: parsed(name) for slot, name in self.slots.items()}
        return {name.plain: slot for slot, name in names.items()} | {
            name.exact: slot for slot, name in names.items()
        }


_TITLE = "Thumb Index Middle Ring Little"
_BONES = ("Proximal", "Intermediate", "Distal")
_ANATOMY = ("Metacarpal", "Proximal", "Distal")
_NUMBERS = "1 2 3 4 5"
_FROM_0 = ("0", "1", "2")
RIGS = (
    Rig("Rigify bones", "hand.L", "{}.0{}.L", "thumb f_index f_middle f_ring f_pinky",
        palm="palm.01.L|palm.02.L|palm.03.L|palm.04.L"),
    Rig("Mixamo", "LeftHand", "LeftHand{}{}", "Thumb Index Middle Ring Pinky", prefix="mixamorig:"),
    Rig("Ready Player Me", "LeftHand", "LeftHand{}{}", "Thumb Index Middle Ring Pinky"),
    Rig("Unreal Engine", "hand_l", "{}_0{}_l", palm="{}_metacarpal_l"),
    Rig("VRM 1", "leftHand", "left{}{}", _TITLE, _BONES, _ANATOMY),
    Rig("Godot", "LeftHand", "Left{}{}", _TITLE, _BONES, _ANATOMY),
    Rig("VRM 0", "leftHand", "left{}{}", _TITLE, _BONES),
    Rig("Unity", "LeftHand", "Left{}{}", _TITLE, _BONES),
    Rig("Unity", "Left Hand", "Left {} {}", _TITLE, _BONES),
    Rig("VRM add-on", "hand.L", "{}.{}.L", "thumb index middle ring little", _BONES, _ANATOMY),
    Rig("VRM add-on", "hand.L", "{}.{}.L", "thumb index middle ring little", _BONES),
    Rig("VRoid", "L_Hand", "L_{}{}", _TITLE, prefix="J_Bip_"),
    Rig("MikuMikuDance", "左手首", "左{}{}", "親指 人指 中指 薬指 小指", thumb=_FROM_0),
    Rig("MikuMikuDance", "wrist_L", "{}{}_L", "thumb fore middle third little", thumb=_FROM_0),
    Rig("Cats Blender Plugin", "Left wrist", "{}{}_L",
        "Thumb IndexFinger MiddleFinger RingFinger LittleFinger", thumb=_FROM_0),
    Rig("Reallusion", "L_Hand", "L_{}{}", "Thumb Index Mid Ring Pinky", prefix="CC_Base_"),
    Rig("Reallusion", "L_Hand", "L_Finger{}{}", "0 1 2 3 4", _FROM_0, prefix="CC_Base_"),
    Rig("Daz Genesis 8", "lHand", "l{}{}", "Thumb Index Mid Ring Pinky",
        palm="lCarpal1|lCarpal2|lCarpal3|lCarpal4"),
    Rig("Daz Genesis 9", "l_hand", "l_{}{}", "thumb index mid ring pinky", palm="l_{}metacarpal"),
    Rig("MakeHuman", "wrist.L", "finger{}-{}.L", _NUMBERS,
        palm="metacarpal1.L|metacarpal2.L|metacarpal3.L|metacarpal4.L", thumb_roll=15.0),
    Rig("Auto-Rig Pro", "hand.l", "c_{}{}.l", palm="c_{}1_base.l"),
    Rig("Auto-Rig Pro", "hand.l", "{}1.l|c_{}2.l|c_{}3.l", palm="c_{}1_base.l"),
    Rig("SMPL-X", "left_wrist", "left_{}{}", thumb_roll=0.0),
    Rig("3ds Max Biped", "L Hand", "L Finger{}{}", "0 1 2 3 4", ("", "1", "2"), prefix="Bip01 "),
    Rig("Advanced Skeleton", "Wrist_L", "{}Finger{}_L", "Thumb Index Middle Ring Pinky"),
    Rig("Rokoko", "LeftHand", "LeftFinger{}{}", _NUMBERS, ("Proximal", "Medial", "Distal"), _ANATOMY,
        palm="LeftFinger{}Metacarpal"),
    Rig("Captured hand", "wrist.L", "{}_{}.L", "thumb index middle ring little",
        ("proximal", "middle", "distal"), _ANATOMY, thumb_roll=0.0),
)  # fmt: skip
"""Where two explain a hand as well, the first does"""


_FOREARM = ("forearm", "lowerarm", "elbow", "ひじ", "前腕")
_UPPER_ARM = ("arm", "shldr", "腕")
_NOT_ARM = ("twist", "roll", "捩", "armature")
"""What `Name.plain` of the bones of an arm holds; a clavicle may be called a shoulder, as an upper arm may"""


def named_arm(chain: Sequence[str]) -> tuple[int, int] | None:
    """Which of the bones above a hand, the nearest first, are upper arm and forearm by their names; of those
    that are parted, the first parts."""

    def last(words: tuple[str, ...], start: int, without: tuple[str, ...]) -> int | None:
        held = [i for i in range(start, len(plain)) if any(word in plain[i] for word in words)]
        held = [i for i in held if not any(word in plain[i] for word in without)]
        return held[-1] if held else None

    plain = [parsed(name).plain for name in chain]
    fore = last(_FOREARM, 0, _NOT_ARM)
    if fore is None:
        return None
    upper = last(_UPPER_ARM, fore + 1, (*_NOT_ARM, *_FOREARM))
    upper = last(("shoulder",), fore + 1, _NOT_ARM) if upper is None else upper
    return None if upper is None else (upper, fore)


def named_hands(bones: Bones, side: Side) -> list[Found]:
    """Every hand of that side that names tell of, the surest first.

    One hand may be found several times, as the controls and the deforming bones of a control rig. Where some
    have a counterpart on the other side, one that has none, such as a prosthesis, is left out."""
    found: list[Found] = []
    for rig, bearers in _bearers(bones, side):
        with contextlib.suppress(HandModelError):  # bones in one place or on a line are no hand
            guess = _hand(bones, side, rig, bearers)
            found += [guess] if guess is not None else []
    names = [parsed(name) for name in bones.names]
    mirrored = {(name.left, name.copy) for name in names if name.side not in (side, None)}

    def paired(one: Found) -> bool:
        own = [parsed(name) for name in one.hand_map.bones if name]
        return all((name.left, name.copy) in mirrored for name in own)

    found.sort(key=lambda one: -one.sure)
    return [one for one in found if paired(one)] or found


def _bearers(bones: Bones, side: Side) -> Iterator[tuple[Rig, dict[int, int]]]:
    """The bones by slot, for every rig, and for everything that stands before or behind its names."""
    groups: dict[tuple[int, str, str, bool], dict[int, int]] = {}
    for bone, text in enumerate(bones.names):
        name = parsed(text)
        if name.side not in (side, None):
            continue
        seen: set[int] = set()
        for words in (name.exact, name.plain):
            for start in range(len(words)):
                for rig, slot in _KEYS.get(words[start:], ()):
                    if rig not in seen:
                        seen.add(rig)
                        key = (rig, _ZEROS.sub("", words[:start]), name.copy, name.side is None)
                        groups.setdefault(key, {}).setdefault(slot, bone)
    for (rig, *_), bearers in groups.items():
        yield RIGS[rig], bearers


_KEYS: dict[str, list[tuple[int, int]]] = {}
for _number, _rig in enumerate(RIGS):
    for _key, _slot in _rig.keys.items():
        _KEYS.setdefault(_key, []).append((_number, _slot))


def _hand(bones: Bones, side: Side, rig: Rig, bearers: dict[int, int]) -> Found | None:
    """The hand of that side that the `bearers` (bones by slot) of a rig's names are; None where they are
    none."""
    fingers = {f: [j for j in joints if j in bearers] for f, joints in FINGER_JOINTS.items()}
    fingers = {finger: joints for finger, joints in fingers.items() if joints}
    if len(fingers) < 2 or sum(map(len, fingers.values())) < 4:
        return None
    hand = bones.holding([bearers[joints[0]] for joints in fingers.values()], bearers.get(0))
    if hand is None:
        return None
    palm = [bearers.get(NUM_JOINTS + number) for number in range(len(PALM_FINGERS))]
    slots, ordered = [-1] * NUM_JOINTS, 0
    slots[0] = hand
    mapped = {hand, *(bone for slot, bone in bearers.items() if slot)}
    for finger, joints in fingers.items():
        after: set[int | None] = {hand, *palm}
        for joint in joints:
            ordered += next((bone for bone in bones.ancestors(bearers[joint]) if bone in mapped), -1) in after
            after = {bearers[joint]}
        numbered = not rig.thumb and rig.parts[0] == "1"
        if numbered and [*joints] == [*FINGER_JOINTS[finger][:2]]:  # short fingers end in the last joint's
            joints = FINGER_JOINTS[finger][1:] if finger == "thumb" else FINGER_JOINTS[finger][::2]
        for joint, bone in zip(joints, (bearers[j] for j in fingers[finger]), strict=True):
            slots[joint] = bone
    names = tuple(bones.names[bone] if bone >= 0 else "" for bone in slots)
    index, middle, ring, little = ("" if bone is None else bones.names[bone] for bone in palm)
    hand_map = HandMap(side, names, (index, middle, ring, little), rig=rig.label, thumb_roll=rig.thumb_roll)
    if parsed(bones.names[bearers[min(bearers)]]).side is None:
        sign = 1.0 if side == "left" else -1.0
        if sign * leaning(bones, hand_map) < 0.0:
            return None
    usual = [
        parsed(bones.names[bone]).left == parsed(rig.prefix + rig.slots[s]).left
        for s, bone in bearers.items()
    ]
    rest = 0.05 * sum(usual) / len(usual) + 0.02 * (bearers.get(0) == hand) + 0.01 * any(hand_map.palm)
    return Found(hand_map, (0.66 + 0.05 * len(fingers)) * ordered / (3 * len(fingers)) + rest)
