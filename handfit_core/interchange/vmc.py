"""Hands as datagrams of the VMC protocol: OSC 1.0 messages with the local rotations of Unity's bones.

Unity's axes are left-handed, a mirror at x = 0 of the humanoid frame: positions are (-x, y, z), rotations
(x, -y, -z, w), and the left hand stays the left one. Nothing is sent here: `handfit_core.network` does.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.interchange.humanoid import BODY, HumanoidHand, bone_names
from handfit_core.skeleton import FINGER_JOINTS, NUM_JOINTS, PARENTS, Side

_BUNDLE: Final = b"#bundle\0" + struct.pack(">Q", 1)
"""What a bundle begins with, to be acted on at once"""


def unity_names(side: Side) -> tuple[str, ...]:
    """The names in Unity's HumanBodyBones of a hand's 16 bones, by MANO's joints. The thumb's first bone is
    its proximal one there, not its metacarpal."""
    names = [f"{side.title()}Hand"] * NUM_JOINTS
    for finger, joints in FINGER_JOINTS.items():
        for joint, part in zip(joints, ("Proximal", "Intermediate", "Distal"), strict=True):
            names[joint] = f"{side.title()}{finger.title()}{part}"
    return tuple(names)


def osc_message(address: str, *values: str | float | int) -> bytes:
    """One OSC 1.0 message; numbers have 32 bits."""
    tags, content = ",", b""
    for value in values:
        if isinstance(value, str):
            tags, content = tags + "s", content + _padded(value)
        elif isinstance(value, int):
            tags, content = tags + "i", content + struct.pack(">i", value)
        else:
            tags, content = tags + "f", content + struct.pack(">f", value)
    return _padded(address) + _padded(tags) + content


def _padded(text: str) -> bytes:
    """ASCII, ended by one to four zeros so that the length is a multiple of four."""
    data = text.encode("ascii")
    return data + b"\0" * (4 - len(data) % 4)


@dataclass(frozen=True, eq=False)
class VmcMotion:
    """What is sent of hands: datagrams of each moment."""

    times: np.ndarray
    """(N,) seconds, increasing"""
    messages: list[list[bytes]]
    """N times, the messages of the bones"""

    @classmethod
    def of(cls, hands: Sequence[HumanoidHand]) -> VmcMotion:
        """Of hands over each moment that one of them is seen in; while a hand is not, nothing is said of
        it."""
        times = np.unique(np.concatenate([hand.times for hand in hands]))
        messages: list[list[bytes]] = [[] for _ in times]
        for hand in hands:
            names, rows = bone_names(hand.side), np.searchsorted(times, hand.times).tolist()
            forearm = np.array(BODY[BODY[names[0]][0]][1])
            for name, quats in hand.quats.items():
                joint = names.index(name)
                above = hand.heads[PARENTS[joint]] if joint else forearm
                place = (hand.heads[joint] - above) * [-1.0, 1.0, 1.0]
                told = np.column_stack([quats[:, 1:] * [1.0, -1.0, -1.0], quats[:, 0]])
                for row, turned in zip(rows, told.tolist(), strict=True):
                    values = (unity_names(hand.side)[joint], *place.tolist(), *turned)
                    messages[row].append(osc_message("/VMC/Ext/Bone/Pos", *values))
        return cls(times, messages)

    def datagrams(self, row: int, now: float) -> list[bytes]:
        """What is sent in one of the N moments, `now` seconds after the first was sent."""
        told = [osc_message("/VMC/Ext/OK", 1), osc_message("/VMC/Ext/T", float(now)), *self.messages[row]]
        found = [_BUNDLE]
        for message in told:
            element = struct.pack(">i", len(message)) + message
            # Of a datagram, so that no network cuts it in two
            if len(found[-1]) + len(element) > 1400:
                found.append(_BUNDLE)
            found[-1] += element
        return found
