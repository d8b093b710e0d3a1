"""Joints of hands as headsets track them: OpenXR's XR_EXT_hand_tracking and WebXR, recorded as JSON.

Both have the same joints, with OpenXR's palm before them. Spaces are right-handed, y up, metres; a joint's -Z
points along its bone to the next joint and +Y out of the back of the hand (of a thumb: out of its nail);
orientations are quaternions (x, y, z, w). No standard says how to write them down: what is read here are
frames whose joints are named or in the standards' order.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from handfit_core.arrays import LARGEST
from handfit_core.batch import scatter
from handfit_core.doors.values import Unfit, number, shortly
from handfit_core.errors import InputError
from handfit_core.files import shown
from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_rotvec
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import REST_FROM_MODEL, bone_frames
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.document import Document
from handfit_core.interchange.numbered import check_count, told_twice
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording, known
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.media.source import DEFAULT_FPS
from handfit_core.retarget.transfer import palm_frame
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, NUM_BETAS, NUM_JOINTS, PARENTS, SIDES, Side
from handfit_core.take import TAKE_LIMITS

_FINGER: Final = ("metacarpal", "proximal", "intermediate", "distal", "tip")
JOINTS: Final = (
    "wrist",
    *(f"{finger}{part}" for finger in FINGERS for part in _FINGER if (finger, part) != ("thumb", _FINGER[2])),
)
"""The 25 joints of WebXR in its order, as `_plain` has their names; OpenXR has the palm before them"""
_OURS: Final = {
    joint: JOINTS.index(f"{finger}{part}")
    for finger, joints in FINGER_JOINTS.items()
    for joint, part in zip(
        joints, ("metacarpal", "proximal", "distal") if finger == "thumb" else _FINGER[1:4], strict=True
    )
} | {0: 0}
"""Their joint by MANO's, whose bones begin there"""
_NOISE: Final = re.compile(r"xr|hand|joint|ext|finger|phalanx|left|right|[^a-z]")
_NAMES: Final = {
    "position": ("position", "pos", "p", "translation"),
    "orientation": ("orientation", "rotation", "quaternion", "rot", "q"),
    "nested": ("pose", "transform"),
    "time": ("timestamp", "time", "t", "predictedDisplayTime"),
}


def _plain(name: str) -> str:
    """`index-finger-phalanx-proximal`, `XR_HAND_JOINT_INDEX_PROXIMAL_EXT` -> `indexproximal`."""
    return _NOISE.sub("", name.lower()).replace("pinky", "little")


def _recognises(document: Document) -> bool:
    return any(any(True for _ in _hands(frame)) for frame in _frames(document.json))


def _frames(content: Any) -> list[Any]:
    if isinstance(content, dict):
        content = content.get("frames", [content])
    return content if isinstance(content, list) else []


def _hands(frame: Any) -> Iterator[tuple[Side, dict[str, Any]]]:
    """The hands of a frame: `{"left": joints}`, maybe in `hands`, or a list of `{"handedness", "joints"}`."""
    if not isinstance(frame, dict):
        return
    hands = frame.get("hands", frame)
    listed: list[tuple[Any, Any]] = []
    if isinstance(hands, dict):
        listed = [(name, hand) for name, hand in hands.items() if name in SIDES]
    elif isinstance(hands, list):
        listed = [
            (h.get("handedness", h.get("hand", h.get("side"))), h) for h in hands if isinstance(h, dict)
        ]
    for side, hand in listed:
        if isinstance(hand, dict):
            hand = hand.get("joints", hand)
        if isinstance(hand, list) and len(hand) in (len(JOINTS), len(JOINTS) + 1):
            hand = dict(zip(JOINTS, hand[-len(JOINTS) :], strict=True))
        if not isinstance(hand, dict) or str(side).lower() not in SIDES:
            continue
        named = {_plain(str(name)): joint for name, joint in hand.items()}
        if {"wrist", "indexproximal", "thumbmetacarpal"} <= set(named):
            yield "left" if str(side).lower() == "left" else "right", named


@dataclass(frozen=True, eq=False)
class _Tracked:
    """One hand over T frames; NaN where it is not tracked."""

    places: np.ndarray
    """(T, 25, 3) metres, y up"""
    quats: np.ndarray
    """(T, 25, 4) as they are in the file"""


def _read(document: Document, asked: Asked) -> Recording:
    frames = _frames(document.json)
    check_count(document, frames)
    tracked: dict[Side, _Tracked] = {
        side: _Tracked(np.full((len(frames), 25, 3), np.nan), np.full((len(frames), 25, 4), np.nan))
        for side in SIDES
    }
    twice: Counter[Side] = Counter()
    for row, frame in enumerate(frames):
        seen: Counter[Side] = Counter()
        for side, joints in _hands(frame):
            seen[side] += 1
            if seen[side] > 1:
                continue
            for at, name in enumerate(JOINTS):
                try:
                    told = _joint(joints.get(name))
                except Unfit as error:
                    raise InputError(
                        f"{shown(document.path)}: the {side} hand's {name} in frame {row + 1} is no joint "
                        f"({error})"
                    ) from error
                if told is not None:
                    tracked[side].places[row, at], tracked[side].quats[row, at] = told
        twice.update(side for side, count in seen.items() if count > 1)
    assumed = told_twice(twice)
    posed = []
    for side, hand in tracked.items():
        if known(hand.quats).any():
            model = load_model(asked.model, side)
            try:
                posed.append(_posed(hand, side, model, assumed))
            except _Wrong as error:
                raise InputError(f"{shown(document.path)}: the {side} hand {error}") from error
    if not posed:
        raise InputError(
            f"{shown(document.path)}: no frame has a hand with positions and orientations of joints"
        )
    return Recording(
        "hand-tracking",
        (str(document.path.absolute()),),
        asked.fps or _rate(frames, assumed),
        np.arange(1, len(frames) + 1),
        posed=tuple(posed),
        assumed=tuple(dict.fromkeys(assumed)),
    )


class _Wrong(Exception):
    """What is wrong with a hand, to be put after it."""


def _joint(told: Any) -> tuple[list[float], list[float]] | None:
    """Where a joint is and how it is turned; None where it is not tracked. Raises Unfit."""
    if told is None:
        return None
    if isinstance(told, list):
        if len(told) != 7:
            raise Unfit(f"expected x, y, z and a quaternion x, y, z, w, found {shortly(told)}")
        return _numbers(told[:3], "xyz"), _numbers(told[3:], "xyzw")
    for name in _NAMES["nested"]:
        if isinstance(told, dict) and isinstance(told.get(name), dict):
            told = told[name]
    if not isinstance(told, dict):
        raise Unfit(f"expected a position and an orientation, found {shortly(told)}")
    place = next((told[name] for name in _NAMES["position"] if told.get(name) is not None), None)
    turn = next((told[name] for name in _NAMES["orientation"] if told.get(name) is not None), None)
    if place is None and turn is None:
        return None
    return _numbers(place, "xyz"), _numbers(turn, "xyzw")


def _numbers(told: Any, names: str) -> list[float]:
    if isinstance(told, dict):
        told = [told.get(name, told.get(f"_{name}")) for name in names]
    if not isinstance(told, list) or len(told) not in (len(names), 4) or len(told) < len(names):
        raise Unfit(f"expected {', '.join(names)}, found {shortly(told)}")
    return [number(name, value, -LARGEST, LARGEST) for name, value in zip(names, told, strict=False)]


def _posed(hand: _Tracked, side: Side, model: HandModel, assumed: list[str]) -> HandMotion:
    """The pose of tracked joints. Directions and twists of fingers are the joints' own; how the hand is
    turned is told by where its knuckles and its wrist are, as wrists' axes differ between makers."""
    needed = list(_OURS.values())
    told = known(hand.places[:, needed]) & known(hand.quats[:, needed])
    there = np.asarray(told.all(axis=1))
    if not there.any():
        raise _Wrong("lacks joints in every frame")
    places, quats = hand.places[there], hand.quats[there]
    if np.linalg.norm(quats[:, needed], axis=-1).min() < 0.5:
        raise _Wrong("has quaternions that are no rotations")
    frames, wxyz = _frames_of(places, quats)
    if wxyz:
        assumed.append("its quaternions are in the order w, x, y, z, as only so joints point to the next")
    flat = REST_FROM_MODEL.T @ bone_frames(model.shaped(), side)
    flat = np.stack([-flat[..., 0], -flat[..., 2], -flat[..., 1]], axis=-1)
    up = UP_AXES["y"]
    joints = model.shaped().joints
    begins = {finger: FINGER_JOINTS[finger][0] for finger in FINGERS}
    own, size = palm_frame(joints[0], {f: joints[j] for f, j in begins.items()}, side)
    whole = np.empty((len(places), NUM_JOINTS, 3, 3))
    transl = np.empty((len(places), 3))
    sizes = np.empty(len(places))
    for row, place in enumerate(places):
        theirs, sizes[row] = palm_frame(place[0], {f: place[_OURS[j]] for f, j in begins.items()}, side)
        whole[row, 0] = up @ theirs @ own.T
        palm = [0, *(j for f, j in begins.items() if f != "thumb")]
        middle = place[[_OURS[j] for j in palm]].mean(axis=0)
        transl[row] = up @ middle - whole[row, 0] @ (joints[palm].mean(axis=0) - joints[0]) - joints[0]
    if not 0.5 < np.median(sizes) / size < 2.0:
        raise _Wrong(
            f"is {np.median(sizes):.3g} long from wrist to knuckle; expected metres, some {size:.2g}"
        )
    for joint in range(1, NUM_JOINTS):
        whole[:, joint] = up @ frames[:, _OURS[joint]] @ flat[joint].T
    local = np.stack(
        [np.swapaxes(whole[:, PARENTS[j]], -1, -2) @ whole[:, j] for j in range(1, NUM_JOINTS)], axis=1
    )

    return HandMotion(
        side,
        np.zeros(NUM_BETAS),
        scatter(rotmat_to_rotvec(whole[:, 0]), there, len(there)),
        scatter(rotmat_to_rotvec(local).reshape(len(places), -1), there, len(there)),
        scatter(transl, there, len(there)),
    )


def _frames_of(places: np.ndarray, quats: np.ndarray) -> tuple[np.ndarray, bool]:
    """(T, 25, 3, 3) joints' axes, and whether the quaternions have w first: in the right order, -Z points to
    the next joint. Raises _Wrong where it does in none."""
    starts = [
        _OURS[j] for j in range(1, NUM_JOINTS) if j not in {chain[2] for chain in FINGER_JOINTS.values()}
    ]
    steps = places[:, [s + 1 for s in starts]] - places[:, starts]
    steps /= np.maximum(np.linalg.norm(steps, axis=-1, keepdims=True), 1e-9)
    frames, fits = [], []
    for order in ([3, 0, 1, 2], [0, 1, 2, 3]):
        frames.append(quat_to_rotmat(np.nan_to_num(quats[..., order], nan=0.5)))
        fits.append(float(np.median(-(frames[-1][:, starts][..., 2] * steps).sum(axis=-1))))
    best = int(fits[1] > fits[0])
    # How well -Z must point to the next joint, as a cosine, by which orders of quaternions are told apart
    if fits[best] < 0.8:
        angle = np.degrees(np.arccos(np.clip(max(fits), -1.0, 1.0)))
        raise _Wrong(
            f"has joints whose -Z points {angle:.0f} degrees past the next joint; expected OpenXR's or "
            "WebXR's axes and quaternions x, y, z, w"
        )
    return frames[best], bool(best)


def _rate(frames: list[Any], assumed: list[str]) -> float:
    """Frames per second, by the time stamps: seconds, milliseconds, microseconds or nanoseconds, whichever
    gives between 5 and 500."""
    times = [
        next((f[name] for name in _NAMES["time"] if name in f), None) for f in frames if isinstance(f, dict)
    ]
    if len(times) > 1 and all(isinstance(t, int | float) and abs(t) < 1e300 for t in times):
        step = float(np.median(np.diff(np.array(times, dtype=np.float64))))
        for unit in (1.0, 1e-3, 1e-6, 1e-9):
            if step > 0.0 and 5.0 <= 1.0 / (step * unit) <= 500.0:
                return float(np.clip(1.0 / (step * unit), TAKE_LIMITS.min_fps, TAKE_LIMITS.max_fps))
    if len(frames) > 1:
        assumed.append(f"{DEFAULT_FPS:g} frames per second, as no times tell")
    return DEFAULT_FPS


READER = Reader("OpenXR and WebXR", "JSON of frames with 25 or 26 joints a hand", _recognises, _read)
