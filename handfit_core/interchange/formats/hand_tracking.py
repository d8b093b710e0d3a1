"""Joints of hands as headsets track them: OpenXR's XR_EXT_hand_tracking and WebXR, recorded as JSON.

Both have the same joints, with OpenXR's palm before them. Spaces are right-handed, y up, metres; a joint's -Z
points along its bone to the next joint and +Y out of the back of the hand (of a thumb: out of its nail);
orientations are quaternions (x, y, z, w). No standard says how to write them down: what is read here are
frames whose joints are named or in the standards' order.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from handfit_core.common.batch import scatter
from handfit_core.common.skeleton import (
    FINGER_JOINTS,
    FINGERS,
    KEYPOINT_SOURCE,
    NUM_BETAS,
    NUM_JOINTS,
    PARENTS,
)
from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_rotvec
from handfit_core.hand_model.axes import REST_FROM_MODEL, bone_frames
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.document import Document
from handfit_core.interchange.formats.keypoints import some_hands
from handfit_core.interchange.point_reader import PointLayout
from handfit_core.interchange.recording import known
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.retarget.transfer import palm_frame

JOINTS: Final = (
    "wrist",
    *(f"thumb{part}" for part in ("metacarpal", "proximal", "distal", "tip")),
    *(
        f"{finger}{part}"
        for finger in FINGERS[1:]
        for part in ("metacarpal", "proximal", "intermediate", "distal", "tip")
    ),
)
"""The 25 joints of WebXR in its order; OpenXR has the palm before them"""
_POINTS: Final = [KEYPOINT_SOURCE.index(joint) for joint in range(NUM_JOINTS)]
"""(16,) for each of MANO's joints, which of MediaPipe's 21 keypoints it is"""
_KNUCKLES: Final = {finger: _POINTS[joints[0]] for finger, joints in FINGER_JOINTS.items()}


def _with_names(frame: Any) -> Any:
    """Return a frame with its lists of 25 or 26 joints turned into objects by the joints' names."""
    if isinstance(frame, Mapping):
        return {key: _with_names(value) for key, value in frame.items()}
    if isinstance(frame, list) and len(frame) in (len(JOINTS), len(JOINTS) + 1):
        return dict(zip(JOINTS, frame[-len(JOINTS) :], strict=True))
    return [_with_names(each) for each in frame] if isinstance(frame, list) else frame


def _recognises(document: Document) -> bool:
    return any(
        known(hand.points[:, 4:]).sum() > NUM_JOINTS // 2 for hand in some_hands(document, _with_names)
    )


def _posed(joints_told: np.ndarray, model: HandModel, said: list[str]) -> HandMotion:
    """Return the pose of a hand whose joints are (T, 21, 7): places in metres, y up, and quaternions; NaN
    where not tracked. Raises ValueError.

    Directions and twists of fingers are the joints' own; how the hand is turned is told by where its knuckles
    and its wrist are, as wrists' axes differ between makers.
    """
    hand, there = f"the {model.side} hand", np.isfinite(joints_told[:, _POINTS]).all(axis=(1, 2))
    if not there.any():
        raise ValueError(f"{hand} lacks joints, or their orientations, in every frame")
    places, quats = joints_told[there, :, :3], joints_told[there, :, 3:]
    if np.linalg.norm(quats[:, _POINTS], axis=-1).min() < 0.5:
        raise ValueError(f"{hand} has quaternions that are no rotations")
    frames = _frames_of(places, quats, hand, said)
    flat = REST_FROM_MODEL.T @ bone_frames(model.shaped(), model.side)
    flat = np.stack([-flat[..., 0], -flat[..., 2], -flat[..., 1]], axis=-1)
    up, joints = UP_AXES["y"], model.shaped().joints
    knuckles = {finger: joints[chain[0]] for finger, chain in FINGER_JOINTS.items()}
    own, size = palm_frame(joints[0], knuckles, model.side)
    palm = [0, *(chain[0] for finger, chain in FINGER_JOINTS.items() if finger != "thumb")]
    whole = np.empty((len(places), NUM_JOINTS, 3, 3))
    transl = np.empty((len(places), 3))
    sizes = np.empty(len(places))
    for row, place in enumerate(places):
        theirs, sizes[row] = palm_frame(place[0], {f: place[p] for f, p in _KNUCKLES.items()}, model.side)
        whole[row, 0] = up @ theirs @ own.T
        middle = place[[_POINTS[joint] for joint in palm]].mean(axis=0)
        transl[row] = up @ middle - whole[row, 0] @ (joints[palm].mean(axis=0) - joints[0]) - joints[0]
    if not 0.5 < np.median(sizes) / size < 2.0:
        raise ValueError(
            f"{hand} is {np.median(sizes):.3g} long from wrist to knuckle; expected metres, some {size:.2g}"
        )
    whole[:, 1:] = up @ frames[:, _POINTS[1:]] @ np.swapaxes(flat[1:], -1, -2)
    local = np.swapaxes(whole[:, PARENTS[1:]], -1, -2) @ whole[:, 1:]
    pose = rotmat_to_rotvec(local).reshape(len(places), -1)
    moved = (scatter(part, there, len(joints_told)) for part in (rotmat_to_rotvec(whole[:, 0]), pose, transl))
    return HandMotion(model.side, np.zeros(NUM_BETAS), *moved)


def _frames_of(places: np.ndarray, quats: np.ndarray, hand: str, said: list[str]) -> np.ndarray:
    """Return (T, 21, 3, 3) axes of joints in which -Z points to the next joint, of quaternions (T, 21, 4) in
    x, y, z, w or w, x, y, z order, whichever makes it so. Raises ValueError where neither does."""
    starts = np.setdiff1d(_POINTS[1:], [_POINTS[chain[2]] for chain in FINGER_JOINTS.values()])
    steps = places[:, starts + 1] - places[:, starts]
    steps /= np.maximum(np.linalg.norm(steps, axis=-1, keepdims=True), 1e-9)
    orders = ([3, 0, 1, 2], [0, 1, 2, 3])
    frames = [quat_to_rotmat(np.nan_to_num(quats[..., order], nan=0.5)) for order in orders]
    fits = [float(np.median(-(each[:, starts][..., 2] * steps).sum(axis=-1))) for each in frames]
    # How well -Z must point to the next joint, as a cosine, by which orders of quaternions are told apart
    if max(fits) < 0.8:
        angle = np.degrees(np.arccos(np.clip(max(fits), -1.0, 1.0)))
        raise ValueError(
            f"{hand} has joints whose -Z points {angle:.0f} degrees past the next joint; expected OpenXR's "
            "or WebXR's axes and quaternions x, y, z, w"
        )
    if fits[1] > fits[0]:
        said.append("its quaternions are in the order w, x, y, z, as only so joints point to the next")
    return frames[int(fits[1] > fits[0])]


HAND_TRACKING: Final = PointLayout(
    "hand-tracking",
    "OpenXR and WebXR",
    "JSON of frames with 25 or 26 joints a hand, with orientations",
    "https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrHandJointEXT.html",
    recognises=_recognises,
    columns="xyz xyzijkw",
    hands=_with_names,
    order="mediapipe",
    persons="one",
    units={"metres": 1.0},
    posed=_posed,
    assumes="the mean hand's shape",
)
