"""Joints of hands as headsets track them: OpenXR's XR_EXT_hand_tracking and WebXR, recorded as JSON.

Both have the same joints, with OpenXR's palm before them. Spaces are right-handed, y up, metres; a joint's -Z
points along its bone to the next joint and +Y out of the back of the hand (of a thumb: out of its nail);
orientations are quaternions (x, y, z, w). No standard says how to write them down: what is read here are
frames whose joints are named or in the standards' order.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from handfit_core.common.arrays import LARGEST
from handfit_core.common.batch import scatter
from handfit_core.common.errors import InputError
from handfit_core.common.files import shown
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_BETAS, NUM_JOINTS, PARENTS, SIDES, Side
from handfit_core.common.values import number, shortly
from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_rotvec
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import REST_FROM_MODEL, bone_frames
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.document import Document
from handfit_core.interchange.json_points import frames_of, several_hands
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import ReadOptions, Recording, known
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.retarget.transfer import palm_frame

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
_POSITION: Final = "position", "pos", "p", "translation"
_ORIENTATION: Final = "orientation", "rotation", "quaternion", "rot", "q"


def _plain(name: str) -> str:
    """`index-finger-phalanx-proximal`, `XR_HAND_JOINT_INDEX_PROXIMAL_EXT` -> `indexproximal`."""
    return _NOISE.sub("", name.lower()).replace("pinky", "little")


def _recognises(document: Document) -> bool:
    content = document.json
    frames = content.get("frames", [content]) if isinstance(content, dict) else content
    return isinstance(frames, list) and any(any(True for _ in _hands(frame)) for frame in frames)


def _hands(frame: Any) -> Iterator[tuple[Side, dict[str, Any]]]:
    """The hands of a frame: `{"left": joints}`, maybe in `hands`, or a list of `{"handedness", "joints"}`."""
    hands = frame.get("hands", frame) if isinstance(frame, dict) else []
    listed = list(hands.items()) if isinstance(hands, dict) else []
    if isinstance(hands, list):
        listed = [
            (h.get("handedness", h.get("hand", h.get("side"))), h) for h in hands if isinstance(h, dict)
        ]
    for side, hand in listed:
        joints = hand.get("joints", hand) if isinstance(hand, dict) else hand
        if isinstance(joints, list) and len(joints) in (len(JOINTS), len(JOINTS) + 1):
            joints = dict(zip(JOINTS, joints[-len(JOINTS) :], strict=True))
        if isinstance(joints, dict) and str(side).lower() in SIDES:
            named = {_plain(name): joint for name, joint in joints.items()}
            if {"wrist", "indexproximal", "thumbmetacarpal"} <= set(named):
                yield SIDES[SIDES.index(str(side).lower())], named


def _read(document: Document, asked: ReadOptions) -> Recording:
    path = shown(document.path)
    frames = frames_of(document, lambda _: False)
    count = len(frames.numbers)
    told: dict[Side, np.ndarray] = {side: np.full((count, len(JOINTS), 7), np.nan) for side in SIDES}
    seen: dict[Side, np.ndarray] = {side: np.zeros(count, dtype=int) for side in SIDES}
    for row, frame in enumerate(frames.contents):
        for side, joints in _hands(frame):
            seen[side][row] += 1
            if seen[side][row] == 1:
                try:
                    told[side][row] = [_joint(name, joints.get(name)) for name in JOINTS]
                    if np.any(np.abs(told[side][row]) > LARGEST):
                        raise ValueError(f"a number lies beyond {LARGEST:g}")
                except (TypeError, ValueError, OverflowError) as error:
                    raise InputError(
                        f"{path}: the {side} hand in frame {row + 1} has something that is no joint "
                        f"({str(error)[:200]})"
                    ) from error
    assumed = several_hands({side: int((times > 1).sum()) for side, times in seen.items()})
    posed = []
    for side, joints in told.items():
        if known(joints).any():
            try:
                posed.append(_posed(joints, side, load_model(asked.model, side), assumed))
            except _Wrong as error:
                raise InputError(f"{path}: the {side} hand {error}") from error
    if not posed:
        raise InputError(f"{path}: no frame has a hand with positions and orientations of joints")
    return Recording(
        "hand-tracking",
        (str(document.path.absolute()),),
        asked.fps or frames.fps,
        np.arange(1, count + 1),
        posed=tuple(posed),
        assumed=tuple(dict.fromkeys(assumed)),
    )


class _Wrong(Exception):
    """What is wrong with a hand, to be put after it."""


def _joint(name: str, told: Any) -> list[Any]:
    """Where a joint is and how it is turned, x, y, z and a quaternion; NaN where it is not tracked. Raises
    ValueError."""
    if isinstance(told, dict):
        told = next(
            (told[nested] for nested in ("pose", "transform") if isinstance(told.get(nested), dict)), told
        )
        place, turn = (
            next((told[key] for key in keys if told.get(key) is not None), None)
            for keys in (_POSITION, _ORIENTATION)
        )
        told = None if place is None and turn is None else [*_axes(place, "xyz"), *_axes(turn, "xyzw")]
    if told is None:
        return [np.nan] * 7
    if not isinstance(told, list) or len(told) != 7:
        raise ValueError(f"{name} is {shortly(told)}; expected x, y, z and a quaternion x, y, z, w")
    return [number(name, value) for value in told]


def _axes(told: Any, names: str) -> list[Any]:
    """The numbers of an object or a list, which may have a fourth one beside a position."""
    if isinstance(told, dict):
        return [told.get(name, told.get(f"_{name}")) for name in names]
    return told[: len(names)] if isinstance(told, list) else []


def _posed(joints_told: np.ndarray, side: Side, model: HandModel, assumed: list[str]) -> HandMotion:
    """The pose of joints (T, 25, 7) in metres, y up, and quaternions; NaN: not tracked.

    Directions and twists of fingers are the joints' own; how the hand is turned is told by where its knuckles
    and its wrist are, as wrists' axes differ between makers.
    """
    needed = list(_OURS.values())
    there = np.asarray(known(joints_told[:, needed]).all(axis=1))
    if not there.any():
        raise _Wrong("lacks joints in every frame")
    places, quats = joints_told[there, :, :3], joints_told[there, :, 3:]
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


READER = Reader(
    "OpenXR and WebXR",
    "JSON of frames with 25 or 26 joints a hand, with orientations",
    _recognises,
    _read,
    assumed="the mean hand's shape",
)
