"""Biovision's BVH: skeletons with fingers of any names, read; the names of MotionBuilder, written.

Rotations are degrees, intrinsic in the order of the channels, and relative to a rest pose in which the axes
of every bone are the file's own; offsets say where bones begin in it. Files do not tell their unit, nor what
is up.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.arrays import LARGEST
from handfit_core.common.errors import HandModelError, InputError, OptionError
from handfit_core.common.files import shown
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, SIDES, Side
from handfit_core.common.values import Unfit
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import REST_FROM_MODEL
from handfit_core.interchange.document import Document
from handfit_core.interchange.every_frame import EveryFrame
from handfit_core.interchange.humanoid import bone_names, humanoid_bones, t_pose
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import ReadOptions, Recording
from handfit_core.interchange.settings import LIMITS
from handfit_core.interchange.skeletons import (
    UP_AXES,
    AnimatedBones,
    hand_of_bones,
    name_of_unit,
    no_hand,
)
from handfit_core.interchange.writers import Writer
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.transfer import SourceHand
from handfit_core.take import TAKE_LIMITS, Take

_MOTION: Final = re.compile(r"^[ \t]*MOTION[ \t]*\r?$", re.MULTILINE | re.IGNORECASE)
"""The line MOTION of a file; it must match within its line, so that blank lines before it are not gone
through again for each of them"""
_HEADER: Final = re.compile(r"\s*Frames:?\s*(\d{1,9})\s+Frame\s+Time:?\s*(\S{1,40})", re.IGNORECASE)
_CHANNEL: Final = re.compile("[xyz](position|rotation)")
_HEAD: Final = re.compile("head|neck", re.IGNORECASE)
_LONGEST: Final = 1 << 22
"""The most letters of the hierarchy, each word of which takes fifty bytes of memory"""


@dataclass
class _Skeleton:
    """The bones of a file while its hierarchy is read."""

    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[list[float]] = field(default_factory=list)
    channels: list[list[str]] = field(default_factory=list)


def _recognises(document: Document) -> bool:
    return document.bytes[:64].lstrip(b"\xef\xbb\xbf \t\r\n").upper().startswith(b"HIERARCHY")


def _read(document: Document, asked: ReadOptions) -> Recording:
    skeleton, numbers, seconds = _parsed(document)
    animated, largest = _posed(skeleton, numbers)
    up = _up_axis(animated.bones)
    try:
        made = (hand_of_bones(animated, load_model(asked.model, side), UP_AXES[up]) for side in SIDES)
        hands = [hand for hand in made if hand is not None]
    except HandModelError as error:
        raise InputError(f"{shown(document.path)}: {error}") from error
    if not hands:
        raise Unfit(no_hand(animated.bones))
    units = dict.fromkeys(name_of_unit(hand.unit) for hand in hands)
    assumed = [f"its numbers are {' and '.join(units)}, as its hands' size tells, and {up} is up"]
    for hand in hands:
        assumed.append(f"the {hand.posed.side} hand's bones are those of {hand.hand_map.rig}")
        if np.ptp(hand.posed.hand_pose, axis=0).max() == 0.0 and len(numbers) > 1:
            assumed.append(f"the {hand.posed.side} hand's fingers do not move in this file")
    if 0.0 < largest <= 2.0 * np.pi:
        assumed.append(
            f"no angle exceeds {largest:.2g}: BVH has degrees; if these are radians, write them as degrees"
        )
    told = 1.0 / seconds if seconds > 0.0 else 0.0
    return Recording(
        "bvh",
        (str(document.path.absolute()),),
        told if TAKE_LIMITS.min_fps <= told <= TAKE_LIMITS.max_fps else 0.0,
        np.arange(1, len(numbers) + 1),
        posed=tuple(hand.posed for hand in hands),
        assumed=tuple(assumed),
    )


def _parsed(document: Document) -> tuple[_Skeleton, np.ndarray, float]:
    """Read the bones, the values of their channels in T frames, (T, channels), and the seconds that a frame
    lasts. Raises Unfit."""
    if len(document.bytes) > LIMITS.text_bytes:
        raise Unfit(
            f"it has more than {LIMITS.text_bytes} bytes, and at most so many are read: cut it in parts"
        )
    text = document.text
    if text is None:
        text = document.bytes.decode("latin-1")
    motion = _MOTION.search(text)
    if not motion:
        raise Unfit("it has no MOTION, so that it is only a part of one")
    if motion.start() > _LONGEST:
        raise Unfit(f"it has a HIERARCHY of more than {LIMITS.bvh_bones} bones")
    skeleton = _hierarchy(iter(text[: motion.start()].split()))
    said = _HEADER.match(text, motion.end())
    if not said:
        raise Unfit("it does not say Frames and Frame Time after MOTION")
    count, width = int(said[1]), sum(map(len, skeleton.channels))
    LIMITS.check(document.path, count, points=max(len(skeleton.names), width // 3))
    if len(text) - said.end() > 64 * (count * width + 100):
        raise Unfit(f"it says {count} frames of {width} channels, and has far more numbers")
    try:
        seconds = float(said[2])
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)
            numbers = np.fromstring(text[said.end() :], sep=" ")
    except (ValueError, DeprecationWarning) as error:
        raise Unfit("it holds what is no number among its frames") from error
    if not count * width or len(numbers) != count * width:
        raise Unfit(
            f"it says {count} frames of {width} channels, which are {count * width} numbers, and has "
            f"{len(numbers)}; it may be cut off"
        )
    if not (np.abs(numbers) <= LARGEST).all():
        raise Unfit("it holds numbers that are none, or too large")
    return skeleton, numbers.reshape(count, width), seconds


def _hierarchy(words: Iterator[str]) -> _Skeleton:
    """Read the bones from the words before MOTION. Raises Unfit."""
    skeleton, open_bones = _Skeleton(), []
    try:
        if next(words).upper() != "HIERARCHY":
            raise Unfit("it does not begin with HIERARCHY")
        for word in words:
            match word.upper():
                case "ROOT" | "JOINT" | "END":
                    name = " ".join(iter(lambda: next(words), "{"))
                    parent = open_bones[-1] if open_bones else -1
                    if word.upper() == "END":
                        name = f"{skeleton.names[parent] if parent >= 0 else ''} end"
                    if len(skeleton.names) >= LIMITS.bvh_bones or not 0 < len(name) <= 260:
                        raise Unfit(
                            f"it has more than {LIMITS.bvh_bones} bones, or one without a name of its own"
                        )
                    open_bones.append(len(skeleton.names))
                    taken = name in skeleton.names
                    skeleton.names.append(f"{name}'{len(skeleton.names)}" if taken else name)
                    skeleton.parents.append(parent)
                    skeleton.offsets.append([0.0] * 3)
                    skeleton.channels.append([])
                case "OFFSET":
                    skeleton.offsets[open_bones[-1]] = [float(next(words)) for _ in range(3)]
                case "CHANNELS":
                    named = [next(words).lower() for _ in range(min(int(next(words)), 7))]
                    if len(set(named)) != len(named) or not all(map(_CHANNEL.fullmatch, named)):
                        raise Unfit(
                            f"it has the channels {' '.join(named)[:100]}, expected Xposition, Zrotation..."
                        )
                    skeleton.channels[open_bones[-1]] = named
                case "}":
                    open_bones.pop()
                case _:
                    raise Unfit(
                        f"it has {shown(word[:40])!r} where a JOINT, an OFFSET or CHANNELS are expected"
                    )
    except Unfit:
        raise
    except (StopIteration, IndexError, ValueError) as error:
        raise Unfit("it has a HIERARCHY that is damaged or cut off") from error
    if open_bones or not skeleton.names or not (np.abs(np.array(skeleton.offsets)) <= LARGEST).all():
        raise Unfit("it has a HIERARCHY that is damaged or cut off")
    return skeleton


def _posed(skeleton: _Skeleton, numbers: np.ndarray) -> tuple[AnimatedBones, float]:
    """Return every bone in every frame, and the largest angle in degrees that the file has. Positions stand
    for a bone's offset where it has such channels."""
    offsets, parents = np.array(skeleton.offsets), skeleton.parents
    count, bones = len(numbers), len(parents)
    rest = np.zeros((bones, 3))
    turned = np.empty((count, bones, 3, 3))
    heads = np.empty((count, bones, 3))
    column, largest = 0, 0.0
    for bone, parent in enumerate(parents):
        above = turned[:, parent] if parent >= 0 else np.broadcast_to(np.eye(3), (count, 3, 3))
        step, turn = np.broadcast_to(offsets[bone], (count, 3)).copy(), above
        for channel in skeleton.channels[bone]:
            values, axis = numbers[:, column], "xyz".index(channel[0])
            column += 1
            if channel.endswith("position"):
                step[:, axis] = values
            else:
                largest = max(largest, float(np.abs(values).max()))
                turn = turn @ rotvec_to_rotmat(np.radians(values)[:, None] * np.eye(3)[axis])
        rest[bone] = offsets[bone] + (rest[parent] if parent >= 0 else 0.0)
        turned[:, bone] = turn
        heads[:, bone] = (above @ step[..., None])[..., 0] + (heads[:, parent] if parent >= 0 else 0.0)
    first_children = {parent: bone for bone, parent in reversed([*enumerate(parents)])}
    found = Bones(
        tuple(skeleton.names),
        np.array(parents),
        rest,
        rest[[first_children.get(bone, bone) for bone in range(bones)]],
        np.broadcast_to(np.eye(3), (bones, 3, 3)),
    )
    return AnimatedBones(found, turned, heads), largest


def _up_axis(bones: Bones) -> str:
    """Return which axis is up: y, as in most files, or z where a body stands along it or the bones are those
    of our own rigs, which Blender has written."""
    head = next((bone for bone, name in enumerate(bones.names) if _HEAD.search(name)), None)
    if head is None:
        return "z" if any(re.match(r"wrist\.[LR]", name) for name in bones.names) else "y"
    along = np.abs(bones.heads[head] - bones.heads[0])
    return "z" if along[2] > along[1] else "y"


def _motionbuilders_names() -> dict[str, str]:
    """Return MotionBuilder's names of a humanoid's bones by VRM's."""
    names = {"hips": "Hips", "spine": "Spine", "chest": "Spine1", "upperChest": "Spine2"}
    names |= {"neck": "Neck", "head": "Head"}
    parts = {"Shoulder": "Shoulder", "UpperArm": "Arm", "LowerArm": "ForeArm", "Hand": "Hand"}
    parts |= {"UpperLeg": "UpLeg", "LowerLeg": "Leg", "Foot": "Foot"}
    for side in SIDES:
        names |= {f"{side}{part}": f"{side.title()}{called}" for part, called in parts.items()}
        for finger, joints in FINGER_JOINTS.items():
            called = f"{side.title()}Hand{'Pinky' if finger == 'little' else finger.title()}"
            names |= {bone_names(side)[joint]: f"{called}{n}" for n, joint in enumerate(joints, 1)}
    return names


_CENTIMETRES: Final = 100.0
_GROUND: Final = (0.0, -120.0, -40.0)
"""The vector in centimetres from the hands to the ground under a person who may have them"""


def _write(take: Take, path: Path) -> None:
    """Write one body, whose hands have positions of their own where the take has them, as its arms are not
    known."""
    tracks = [track for track in take.hands if track.present.any()]
    if not tracks:
        raise OptionError("there is no hand in this take")
    if len({track.side for track in tracks}) < len(tracks):
        raise OptionError(
            f"the take has {len(tracks)} hands, and a BVH body has one of each side: capture again with "
            "--hands or --person"
        )
    frames = EveryFrame.of(take)
    count = len(frames.numbers)
    turned: dict[str, np.ndarray] = {}
    wrists: dict[str, np.ndarray] = {}
    heads: dict[Side, np.ndarray] = {}
    ends: dict[str, np.ndarray] = {"head": np.array([0.0, 10.0, 0.0])}
    up = UP_AXES["y"].T
    for side, hand in frames.hands.items():
        shaped = load_model(take.model, side).shaped(hand.betas)
        target, heads[side] = t_pose(SourceHand.of(shaped, side))
        names, index = bone_names(side), [*map(target.bones.index, bone_names(side)[1:])]
        turns = np.broadcast_to(np.eye(3), (count, NUM_JOINTS, 3, 3)).copy()
        turns[:, 1:] = rotvec_to_rotmat(hand.hand_pose.reshape(-1, NUM_JOINTS - 1, 3))
        local = target.local(REST_FROM_MODEL @ turns @ REST_FROM_MODEL.T)
        orient = rotvec_to_rotmat(hand.global_orient)
        turned[names[0]] = up @ orient @ REST_FROM_MODEL.T @ target.aligned.T
        turned |= {names[joint]: local[:, bone] for joint, bone in enumerate(index, start=1)}
        wrists[names[0]] = (hand.transl + shaped.joints[0]) @ up.T * _CENTIMETRES
        for finger, tip in zip(FINGERS, target.tips, strict=True):
            last = FINGER_JOINTS[finger][2]
            ends[names[last]] = _CENTIMETRES * (tip - target.heads[index[last - 1]])
    bones = {name: (parent, _CENTIMETRES * place) for name, (parent, place) in humanoid_bones(heads).items()}
    ground = np.median(np.concatenate([*wrists.values()]), axis=0) + _GROUND
    lines, called = ["HIERARCHY"], _motionbuilders_names()
    columns: list[np.ndarray] = []

    def add(name: str, depth: int) -> None:
        parent, place = bones[name]
        step = place - bones[parent][1] if parent else place
        before = "\t" * depth
        moved = name in wrists or not parent
        lines.extend([f"{before}{'JOINT' if parent else 'ROOT'} {called[name]}", before + "{"])
        lines.append(f"{before}\tOFFSET {_words(step)}")
        channels = "6 Xposition Yposition Zposition" if moved else "3"
        lines.append(f"{before}\tCHANNELS {channels} Zrotation Xrotation Yrotation")
        if moved:
            there = wrists[name] - ground - bones[parent][1] if parent else place + ground
            columns.append(np.broadcast_to(there, (count, 3)))
        columns.append(_degrees(turned[name]) if name in turned else np.zeros((count, 3)))
        children = [other for other, (of, _) in bones.items() if of == name]
        for child in children:
            add(child, depth + 1)
        if not children:
            end = _words(ends.get(name, np.array([0.0, 0.0, 10.0])))
            lines.extend([f"{before}\tEnd Site", before + "\t{", f"{before}\t\tOFFSET {end}", before + "\t}"])
        lines.append(before + "}")

    add("hips", 0)
    lines += ["MOTION", f"Frames: {count}", f"Frame Time: {1.0 / frames.fps:.9g}"]
    lines += map(_words, np.concatenate(columns, axis=1))
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _words(numbers: np.ndarray) -> str:
    return " ".join(f"{number:.6f}" for number in numbers)


def _degrees(rotmat: np.ndarray) -> np.ndarray:
    """Return (T, 3) degrees about z, x and y of rotations (T, 3, 3), R = Rz Rx Ry, without jumps of full
    turns."""
    z = np.arctan2(-rotmat[:, 0, 1], rotmat[:, 1, 1])
    x = np.arcsin(np.clip(rotmat[:, 2, 1], -1.0, 1.0))
    y = np.arctan2(-rotmat[:, 2, 0], rotmat[:, 2, 2])
    return np.degrees(np.unwrap(np.stack([z, x, y], axis=-1), axis=0))


READER = Reader(
    "BVH",
    "a .bvh with finger bones, of any names",
    _recognises,
    _read,
    met="Blender's exporter (2026-11)",
    assumed="the unit, by the hands' size; up, by the body",
)
WRITER = Writer("BVH", (".bvh",), _write)
