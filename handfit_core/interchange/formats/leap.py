"""Leap Motion and Ultraleap: frames as JSON, of its websocket (leapjs) or with the names of LeapC.

Millimetres, y up, z towards the user. A thumb's metacarpal has no length, so that every finger has its
knuckle where its second bone begins, and the thumb's is the joint at its root.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from handfit_core.arrays import LARGEST
from handfit_core.doors.values import Unfit, number, shortly
from handfit_core.errors import InputError
from handfit_core.files import shown
from handfit_core.interchange.document import Document
from handfit_core.interchange.numbered import check_count, told_twice
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, PointsHand, Recording
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.media.source import DEFAULT_FPS
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES, Side

_MILLIMETRES: Final = 0.001
_JOINTS: Final = ("mcpPosition", "pipPosition", "dipPosition", "btipPosition")
_HANDS: Final = (0.03, 0.2)
"""metres from wrist to middle knuckle: what else is another unit"""


def _recognises(document: Document) -> bool:
    return any(_hands(frame) for frame in _frames(document))


def _frames(document: Document) -> list[dict[str, Any]]:
    content = document.json if document.json is not None else document.lines
    if isinstance(content, dict):
        content = content.get("frames", [content])
    return [f for f in content if isinstance(f, dict)] if isinstance(content, list) else []


def _hands(frame: dict[str, Any]) -> list[dict[str, Any]]:
    """The hands of a frame with what tells of their fingers."""
    hands = frame.get("hands")
    found = [hand for hand in hands if isinstance(hand, dict)] if isinstance(hands, list) else []
    if isinstance(frame.get("pointables"), list):
        return [hand | {"fingers": list(_of_hand(frame, hand))} for hand in found if "type" in hand]
    return [hand for hand in found if isinstance(hand.get("digits"), list)]


def _of_hand(frame: dict[str, Any], hand: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for finger in frame["pointables"]:
        if isinstance(finger, dict) and finger.get("handId") == hand.get("id") and "mcpPosition" in finger:
            yield finger


def _read(document: Document, asked: Asked) -> Recording:
    frames = _frames(document)
    check_count(document, frames)
    points = {side: np.full((len(frames), NUM_KEYPOINTS, 3), np.nan) for side in SIDES}
    twice: Counter[Side] = Counter()
    for row, frame in enumerate(frames):
        seen: Counter[Side] = Counter()
        for hand in _hands(frame):
            try:
                told = str(hand.get("type", hand.get("handedness", ""))).lower().removeprefix("elehandtype_")
                if told not in SIDES:
                    raise Unfit(f"its type is {shortly(hand.get('type'))}, expected left or right")
                side = SIDES[SIDES.index(told)]
                seen[side] += 1
                if seen[side] == 1:
                    points[side][row] = _points(hand)
            except Unfit as error:
                raise InputError(
                    f"{shown(document.path)}: a hand of frame {row + 1} does not fit Leap's: {error}"
                ) from error
        twice.update(side for side, count in seen.items() if count > 1)
    found = []
    for side in SIDES:
        hand = PointsHand(side, points[side] @ UP_AXES["y"].T * _MILLIMETRES, sigma=0.003)
        if not hand.present.any():
            continue
        size = float(np.nanmedian(np.linalg.norm(hand.points[:, 9] - hand.points[:, 0], axis=-1)))
        if not _HANDS[0] < size < _HANDS[1]:
            raise InputError(
                f"{shown(document.path)}: the {side} hand is {size / _MILLIMETRES:.3g} long from wrist to "
                "knuckle; expected millimetres, some 90"
            )
        found.append(hand)
    if not found:
        raise InputError(f"{shown(document.path)}: no frame has a hand with its fingers' joints")
    assumed = told_twice(twice)
    fps = asked.fps or _rate(frames, assumed)
    assumed.append("the device lies on a table and looks up: y is up")
    return Recording(
        "leap",
        (str(document.path.absolute()),),
        fps,
        np.arange(1, len(frames) + 1),
        points=tuple(found),
        assumed=tuple(assumed),
    )


def _points(hand: dict[str, Any]) -> np.ndarray:
    """(21, 3) millimetres. Raises Unfit."""
    found = np.full((NUM_KEYPOINTS, 3), np.nan)
    arm = hand.get("arm")
    wrist = hand.get("wrist", arm.get("next_joint", arm.get("nextJoint")) if isinstance(arm, dict) else None)
    found[0] = _place("wrist", wrist)
    fingers = hand.get("fingers")
    if fingers is None:
        fingers = hand["digits"]
        if len(fingers) != 5:
            raise Unfit(f"it has {len(fingers)} digits, expected 5")
    for order, finger in enumerate(fingers):
        if not isinstance(finger, dict):
            raise Unfit(f"a finger is {shortly(finger)}")
        if "bones" in finger:
            number_of, joints = order, _joints(finger["bones"])
        else:
            number_of = int(number("a finger's type", finger.get("type"), 0, 4))
            joints = [_place(name, finger.get(name)) for name in _JOINTS]
        found[1 + 4 * number_of : 5 + 4 * number_of] = joints
    return found


def _joints(bones: Any) -> list[list[float]]:
    """Where the last three of a finger's four bones begin, and where they end."""
    if not isinstance(bones, list) or len(bones) != 4 or not all(isinstance(bone, dict) for bone in bones):
        raise Unfit(f"a finger's bones are {shortly(bones)}, expected 4")
    ends = [_place("next_joint", bone.get("next_joint", bone.get("nextJoint"))) for bone in bones]
    return [_place("prev_joint", bones[1].get("prev_joint", bones[1].get("prevJoint"))), *ends[1:]]


def _place(name: str, told: Any) -> list[float]:
    if isinstance(told, dict):
        told = [told.get(axis) for axis in "xyz"]
    if not isinstance(told, list) or len(told) != 3:
        raise Unfit(f"{name} is {shortly(told)}, expected x, y, z")
    return [number(name, value, -LARGEST, LARGEST) for value in told]


def _rate(frames: list[dict[str, Any]], assumed: list[str]) -> float:
    """Frames per second, by the time stamps in microseconds, or what the frames say of it."""
    times = [frame.get("timestamp") for frame in frames]
    if len(times) > 1 and all(isinstance(t, int | float) and abs(t) < 1e300 for t in times):
        step = float(np.median(np.diff(np.array(times, dtype=np.float64)))) * 1e-6
        if 1e-3 < step < 1.0:
            return 1.0 / step
    if len(frames) > 1:
        assumed.append(f"{DEFAULT_FPS:g} frames per second, as no time stamps in microseconds tell")
    return DEFAULT_FPS


READER = Reader("Leap Motion", "JSON of frames with hands and pointables, or digits", _recognises, _read)
