"""Armatures at rest as other programs build them, from the open hand: names, bones and where they lie."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, PARENTS, SIDES, Side
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import axes, load_model
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.transfer import SourceHand

CURLED = {"left": 0.25, "right": -0.25}
"""radians about Y by which a relaxed hand's fingers bend towards the palm"""


@dataclass(frozen=True)
class Rig:
    """How a kind of rig calls a left hand's bones. `{}` stands for a finger, then for one of its bones."""

    label: str
    """What it is recognised as"""
    hand: str
    bones: str
    """One name for all of a finger's bones, or three that `|` parts"""
    fingers: str = "thumb index middle ring pinky"
    parts: tuple[str, ...] = ("1", "2", "3")
    thumb: tuple[str, ...] = ()
    """The thumb's bones, where they are called otherwise than a finger's"""
    palm: str = ""
    """The metacarpals, likewise, or all four"""
    tip: str = ""
    """Bones at the tips"""
    prefix: str = ""
    """The usual prefix of each name; others are recognised, too"""

    @cached_property
    def slots(self) -> dict[int, str]:
        """The names without prefix: by MANO's joints, from 16 on metacarpals, and from 20 on tips."""
        words: dict[str, str] = dict(zip(FINGERS, self.fingers.split(), strict=True))
        named = {0: self.hand}
        bones = (self.bones.split("|") * 3)[:3]
        for number, (finger, joints) in enumerate(FINGER_JOINTS.items()):
            parts = self.thumb if finger == "thumb" and self.thumb else self.parts
            for joint, bone, part in zip(joints, bones, parts, strict=True):
                named[joint] = bone.format(words[finger], part)
            if self.tip:
                named[TIPS + number] = self.tip.format(words[finger])
            if self.palm and number:
                palm = (self.palm.split("|") * 4)[number - 1]
                named[NUM_JOINTS + number - 1] = palm.format(words[finger])
        return named


TIPS = NUM_JOINTS + 4
_TITLE = "Thumb Index Middle Ring Little"
_BONES = ("Proximal", "Intermediate", "Distal")
_ANATOMY = ("Metacarpal", "Proximal", "Distal")
_NUMBERS = "1 2 3 4 5"
_FROM_0 = ("0", "1", "2")
_PINKY = "Thumb Index Middle Ring Pinky"
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
        palm="metacarpal1.L|metacarpal2.L|metacarpal3.L|metacarpal4.L"),
    Rig("Auto-Rig Pro", "hand.l", "c_{}{}.l", palm="c_{}1_base.l"),
    Rig("Auto-Rig Pro", "hand.l", "{}1.l|c_{}2.l|c_{}3.l", palm="c_{}1_base.l"),
    Rig("SMPL-X", "left_wrist", "left_{}{}"),
    Rig("3ds Max Biped", "L Hand", "L Finger{}{}", "0 1 2 3 4", ("", "1", "2"), prefix="Bip01 "),
    Rig("Advanced Skeleton", "Wrist_L", "{}Finger{}_L", "Thumb Index Middle Ring Pinky"),
    Rig("Rokoko", "LeftHand", "LeftFinger{}{}", _NUMBERS, ("Proximal", "Medial", "Distal"), _ANATOMY,
        palm="LeftFinger{}Metacarpal"),
    Rig("Captured hand", "wrist.L", "{}_{}.L", "thumb index middle ring little",
        ("proximal", "middle", "distal"), _ANATOMY),
)  # fmt: skip
"""Those that are known by their names"""

_NAMED = "By names and structure"
OTHERS = (
    Rig(_NAMED, "wrist_l", "finger_{}_{}_l", parts=_FROM_0, palm="finger_{}_meta_l", tip="finger_{}_l_end"),
    Rig(_NAMED, "wrist_l", "finger_{}_{}_l", parts=_FROM_0),
    Rig(_NAMED, "hand_l", "{}_0{}_l", parts=_FROM_0),
    Rig(_NAMED, "Hand_L", "{}{}_L", _PINKY, _FROM_0),
    Rig(_NAMED, "Wrist_L", "{}_0{}_L", _PINKY, ("2", "3", "4"), ("1", "2", "3"), palm="{}_01_L"),
    Rig(_NAMED, "hand.L", "{}{}.L", parts=("2", "3", "4"), thumb=("1", "2", "3"), palm="{}1.L"),
    Rig(_NAMED, "hand.L", "{}{}.L", tip="{}4.L"),
    Rig("Unity", "LeftHand", "Left{}{}", _PINKY, ("Proximal", "Medial", "Distal")),
    Rig(_NAMED, "left_hand_joint", "left_hand{}_{}_joint", _PINKY, thumb=("Start", "1", "2"),
        palm="left_hand{}Start_joint", tip="left_hand{}End_joint"),
    Rig(_NAMED, "L_Wrist", "l{}{}", parts=_FROM_0),
    Rig(_NAMED, "LArm_Hand", "LArm_Finger{}{}", _NUMBERS),
    Rig("Mixamo", "LeftHand", "LeftHand{}{}", _PINKY, tip="LeftHand{}4", prefix="mixamorig:"),
    Rig("Ready Player Me", "LeftHand", "LeftHand{}{}", _PINKY, palm="LeftInHand{}"),
    Rig(_NAMED, "b_l_wrist", "b_l_{}{}", tip="b_l_{}_null"),
    Rig(_NAMED, "L_Wrist", "L_{}_{}", parts=("a", "b", "c"), palm="L_{}_meta", tip="L_{}_end"),
    Rig("VRM add-on", "wrist.L", "{}.{}.L", "thumb index middle ring little", _BONES, _ANATOMY,
        palm="{}.metacarpal.L", tip="{}.tip.L"),
    Rig("By its structure", "LeftHand", "Left{}{}", "First Second Third Fourth Fifth", ("PP", "MP", "DP"),
        ("MC", "PP", "DP"), palm="Left{}MC"),
    Rig(_NAMED, "mWristLeft", "mHand{}{}Left", _PINKY),
    Rig(_NAMED, "NPC L Hand [LHnd]", "NPC L Finger{0}{1} [LF{0}{1}]", "0 1 2 3 4", _FROM_0),
    Rig("3ds Max Biped", "L_Hand", "L_Finger{}{}", "0 1 2 3 4", ("", "1", "2"), prefix="ValveBiped.Bip01_"),
    Rig("By its structure", "n_hte_l", "j_{}_{}_l", "oya hito naka kusu ko", ("a", "b", "c")),
    Rig(_NAMED, "hand_L0_0_jnt", "{}_{}_jnt", "thumb_L0 finger_L0 finger_L1 finger_L2 finger_L3", _FROM_0),
    Rig(_NAMED, "hand.L", "DEF-{}{}.L", _PINKY),
    Rig(_NAMED, "b__L_Hand__", "b__L_{}{}__", _PINKY, _FROM_0),
    Rig(_NAMED, "main_L", "{}{}_L", "Daumen Zeige Mittel Ring Klein"),
    Rig("By its structure", "os 8", "os 1{}{}", _NUMBERS),
)  # fmt: skip
"""Those that are known by how their bones lie"""


def source(side: Side) -> SourceHand:
    """The open hand."""
    return SourceHand.of(load_model(None, side).shaped(), side)


def sided(name: str, side: Side) -> str:
    """A name of the left side's tables on the other one."""
    if side == "left":
        return name
    for left, right in (("left", "right"), ("Left", "Right"), ("左", "右")):
        if left in name:
            return name.replace(left, right)
    alone = re.sub(r"(?<![A-Za-z])[lL](?![a-z])", lambda found: {"l": "r", "L": "R"}[found[0]], name)
    if alone != name:
        return alone
    return "r" + name[1:] if name[0] == "l" else f"{name}b"


def names_of(rig: Rig, side: Side, prefix: str | None = None) -> dict[int, str]:
    """By slot, as `Rig.slots`."""
    before = rig.prefix if prefix is None else prefix
    return {slot: before + sided(name, side) for slot, name in rig.slots.items()}


@dataclass
class Built:
    """Bones as they are put together, parents before children."""

    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    heads: list[np.ndarray] = field(default_factory=list)

    def add(self, name: str, parent: int, head: np.ndarray) -> int:
        self.names.append(name)
        self.parents.append(parent)
        self.heads.append(head)
        return len(self.names) - 1

    def bones(self) -> Bones:
        count = len(self.names)
        frames = np.broadcast_to(np.eye(3), (count, 3, 3))
        heads = np.array(self.heads)
        return Bones(tuple(self.names), np.array(self.parents), heads, heads + 0.01, frames)


def add_hand(
    built: Built,
    side: Side,
    names: Mapping[int, str],
    rng: np.random.Generator,
    *,
    parent: int = -1,
    place: np.ndarray | None = None,
    bend: float = 0.0,
    stretch: float = 0.0,
    curl: float = 1.0,
    tips: bool = False,
    without: tuple[int, ...] = (),
) -> None:
    """A hand with rest bends up to `bend` (radians) and proportions up to `stretch`, `curl` times as curled
    as a relaxed one.

    It has metacarpals and tips where `names` has them (from 16 and from 20 on), other bones at the `tips`,
    and none for joints `without`.
    """
    rest = axes.points_to_rest(load_model(None, side).shaped().joints)
    ends = axes.points_to_rest(load_model(None, side).shaped().tips)
    place = np.zeros(3) if place is None else place
    index = {0: built.add(names[0], parent, place)}
    for number, (finger, joints) in enumerate(FINGER_JOINTS.items()):
        turned, head, last = np.eye(3), place, index[0]
        metacarpal = NUM_JOINTS + number - 1
        if number and metacarpal in names:
            knuckle = rest[joints[0]] - rest[0]
            last = built.add(names[metacarpal], last, place + 0.2 * knuckle)
        for joint in joints:
            length = 1.0 + rng.uniform(-stretch, stretch)
            head = head + turned @ (length * (rest[joint] - rest[PARENTS[joint]]))
            usual = np.array([0.0, CURLED[side] if finger != "thumb" else 0.0, 0.0])
            turned = turned @ rotvec_to_rotmat(curl * usual + rng.uniform(-1.0, 1.0, 3) * bend / np.sqrt(3.0))
            if joint not in without:
                last = built.add(names[joint], last, head)
        if (tips or TIPS + number in names) and last != index[0]:
            tip = names.get(TIPS + number, f"{names[joints[2]]}_tip")
            built.add(tip, last, head + turned @ (ends[number] - rest[joints[2]]))


def body(built: Built, side: Side, name: str = "bone") -> tuple[int, np.ndarray]:
    """An arm to put a hand on: the forearm, and where the hand goes. Both arms have one spine."""
    if not built.names:
        spine = built.add(f"{name}.0", -1, np.array([0.0, 0.0, 1.0]))
        built.add(f"{name}.1", spine, np.array([0.0, 0.0, 1.3]))
    sign = 1.0 if side == "left" else -1.0
    upper = built.add(f"{name}.{side}.upper", 1, np.array([sign * 0.15, 0.0, 1.4]))
    fore = built.add(f"{name}.{side}.fore", upper, np.array([sign * 0.4, 0.0, 1.4]))
    return fore, np.array([sign * 0.65, 0.0, 1.4])


def character(rig: Rig, prefix: str | None = None, seed: int = 1, **bent: Any) -> Bones:
    """A body with two hands, named by a table."""
    built, rng = Built(), np.random.default_rng(seed)
    for side in SIDES:
        fore, place = body(built, side)
        add_hand(built, side, names_of(rig, side, prefix), rng, parent=fore, place=place, **bent)
    return built.bones()
