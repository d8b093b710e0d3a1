"""Armatures at rest as other programs build them, from the open hand: names, bones and where they lie."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, NUM_JOINTS, PARENTS, SIDES, Side
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import axes, load_model
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.names import Rig
from handfit_core.retarget.transfer import SourceHand

CURLED = {"left": -0.25, "right": 0.25}
"""radians about Z by which a relaxed hand's fingers bend towards the palm"""


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
    for left, right in (("L_", "R_"), ("L ", "R "), ("l_", "r_")):
        if name.startswith(left):
            return right + name[2:]
    if name[-2:] in (".L", "_L", ".l", "_l"):
        return name[:-1] + {"L": "R", "l": "r"}[name[-1]]
    assert name[0] == "l", name
    return "r" + name[1:]


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
        return Bones(
            tuple(self.names), np.array(self.parents), heads, heads + 0.01, frames, np.ones(count, dtype=bool)
        )


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
    tips: bool = False,
    without: tuple[int, ...] = (),
) -> None:
    """A hand with rest bends up to `bend` (radians) and proportions up to `stretch`.

    It has metacarpals where `names` has them (16 to 19), bones at the `tips`, and none for joints `without`.
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
            curl = np.array([0.0, 0.0, CURLED[side] if finger != "thumb" else 0.0])
            turned = turned @ rotvec_to_rotmat(curl + rng.uniform(-1.0, 1.0, 3) * bend / np.sqrt(3.0))
            if joint not in without:
                last = built.add(names[joint], last, head)
        if tips and last != index[0]:
            built.add(f"{names[joints[2]]}_tip", last, head + turned @ (ends[number] - rest[joints[2]]))


def body(built: Built, side: Side, name: str = "bone") -> tuple[int, np.ndarray]:
    """An arm to put a hand on: the forearm, and where the hand goes. Both arms have one spine."""
    if not built.names:
        spine = built.add(f"{name}.0", -1, np.array([0.0, 0.0, 1.0]))
        built.add(f"{name}.1", spine, np.array([0.0, 0.0, 1.3]))
    sign = 1.0 if side == "left" else -1.0
    upper = built.add(f"{name}.{side}.upper", 1, np.array([sign * 0.15, 0.0, 1.4]))
    fore = built.add(f"{name}.{side}.fore", upper, np.array([sign * 0.4, 0.0, 1.4]))
    return fore, np.array([sign * 0.65, 0.0, 1.4])


def character(rig: Rig, prefix: str | None = None) -> Bones:
    """A body with two hands, named by a table."""
    built, rng = Built(), np.random.default_rng(1)
    for side in SIDES:
        fore, place = body(built, side)
        add_hand(built, side, names_of(rig, side, prefix), rng, parent=fore, place=place)
    return built.bones()
