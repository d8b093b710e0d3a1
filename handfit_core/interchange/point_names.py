"""How other programs name a hand's 21 points, in JSON keys and in columns of tables."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

from handfit_core.common.skeleton import FINGERS, NUM_KEYPOINTS, SIDES, Side

_APPLE_CODE: Final = re.compile(r"VNHLK([A-Z]{3,4})")
_APPLE_THUMB: Final = re.compile(r"thumb_?MP(?![a-zA-Z])", re.IGNORECASE)
_WORDS: Final = re.compile(r"[a-z]+|[A-Z]+(?![a-z])|[A-Z][a-z]+|\d+")
_AXES: Final = {"x": "x", "y": "y", "z": "z", "tx": "x", "ty": "y", "tz": "z"} | dict.fromkeys(
    ("c", "conf", "confidence", "score", "visibility", "v", "likelihood", "presence"), "c"
)
_SIDE_WORDS: Final[dict[str, Side]] = {
    **dict.fromkeys(("left", "lefthand", "l", "lh"), SIDES[0]),
    **dict.fromkeys(("right", "righthand", "r", "rh"), SIDES[1]),
}
_FILLING: Final = frozenset(
    "hand landmark landmarks lm kp kpt point keypoint joint p pt h mediapipe norm px device position".split()
)


_THUMB: Final = (
    "cmc mcp ip tip",
    "metacarpal proximal distal tip",
    "knuckle intermediatebase intermediatetip tip",
    "cmc mp ip tip",
)
_FINGER: Final = (
    "mcp pip dip tip",
    "proximal intermediate distal tip",
    "knuckle middle distal tip",
    "knuckle intermediatebase intermediatetip tip",
)
"""The joints' names of MediaPipe, OpenXR, MRTK, visionOS and (of the thumb) Apple's Vision"""
_NAMES: Final = {"wrist": 0} | {
    called + joint: 1 + 4 * number + place
    for number, finger in enumerate(FINGERS)
    for joints in (*(_FINGER if number else _THUMB), "1 2 3 4")
    for place, joint in enumerate(joints.split())
    for called in ((finger, "pinky") if finger == "little" else (finger,))
}
XR_NAMES: Final = frozenset(
    name for name in _NAMES if re.search("proximal|intermediate|knuckle|metacarpal|distal", name)
)
"""The names that headsets give to joints, which they tell in metres"""
_AROUND: Final = re.compile(r"finger|phalanx|joint|xrhand|hand|ext$|^xr|left|right")
KEYS: Final = {
    "frame": "frame frameid framenumber frameindex frameidx frameno framenum fnum imageid image file".split(),
    "time": (
        "timestamp timestampms timestampinmilliseconds timestamps time times timem timems t "
        "predicteddisplaytime trackingtimestampus timestampus"
    ).split(),
    "side": (
        "multihandedness handedness handednesses side chirality label type handtype hand handlabel handside "
        "handhandedness handhandness which model"
    ).split(),
    "hand": "handid handindex handidx handnumber handno hand id".split(),
    "score": "score handednessscore handscore".split(),
    "confidence": "confidence visibility likelihood conf presence score".split(),
    "point": (
        "landmark landmarkindex landmarkid landmarkname landmarkidx point pointid pointname keypoint "
        "keypointid keypointname joint jointname jointid index name id"
    ).split(),
}
"""Plain names of JSON's keys and of tables' columns, by what a value of that name holds"""


@lru_cache(maxsize=10_000)
def plain(name: str) -> str:
    """Return a key's or column's name in small letters and without the signs between its words."""
    return re.sub(r"[^a-z0-9]", "", name[:300].lower())


@lru_cache(maxsize=10_000)
def point_named(name: str) -> int | None:
    """Return which of the 21 points has that name in MediaPipe (INDEX_FINGER_MCP), Apple's Vision (indexMCP,
    VNHLKIMCP), headsets (IndexProximal), or this project (index_1); None where none has."""
    if code := _APPLE_CODE.search(name):
        if code[1] == "WRI":
            return 0
        return _NAMES.get(dict(zip("TIMRP", FINGERS, strict=True)).get(code[1][0], "") + code[1][1:].lower())
    return _NAMES.get(short(name))


def place_of(name: str) -> int | None:
    """Return which point a JSON key or a table's cell names, or counts from 0 or 1; None where it does
    neither."""
    number = name.removesuffix(".0")
    if number.isascii() and number.isdigit():
        return int(number) if len(number) < 4 and int(number) <= NUM_KEYPOINTS else None
    return point_named(name)


def short(name: str) -> str:
    """Return a point's plain name without its side and the words around it:
    `XR_HAND_JOINT_INDEX_PROXIMAL_EXT` and `right_hand_index_finger_proximal` become `indexproximal`."""
    return _AROUND.sub("", plain(name))


def is_apple(name: str) -> bool:
    """Return whether only Apple's Vision gives a point this name: by its keys, and the MP of its thumb."""
    return bool(_APPLE_CODE.search(name)) or bool(_APPLE_THUMB.search(name))


def side_named(text: object) -> Side | None:
    """Return the side that a label names, as in Left, right_hand, R; None where it names none."""
    if not isinstance(text, str):
        return None
    words = [word.lower() for word in _WORDS.findall(text[:100])]
    sides: set[Side] = {_SIDE_WORDS[word] for word in words if word in _SIDE_WORDS}
    return next(iter(sides)) if len(sides) == 1 else None


@dataclass(frozen=True)
class PointColumn:
    """A table's column that holds one number of a hand's point."""

    index: int
    """The column's index in the table"""
    point: int
    axis: str
    """The number that the column holds: x, y, z, or c, which is how sure the point is"""
    side: Side | None
    hand: int
    """The number of the hand, where columns number hands"""
    named: bool
    """True if the column's point is named rather than numbered"""
    world: bool
    """True if the column is in metres about the hand's middle, as MediaPipe's world landmarks are"""


def point_columns(names: Sequence[str]) -> list[PointColumn]:
    """Return the point columns of a table in which each row holds whole hands, as in x0, wrist_x or
    right_hand_wrist_x.

    Where points are numbered from 1, 21 is among them and 0 is not.
    """
    found = [column for index, name in enumerate(names) if (column := _parsed(index, name)) is not None]
    counted = {column.point for column in found if not column.named}
    # Beside numbered points, others that are named, as a wrist's pose, are not the hand's.
    kept = [column for column in found if not column.named or len(counted) < 6]
    first = 1 if max(counted, default=0) in (20, 21) and 0 not in counted else 0
    columns = [column if column.named else replace(column, point=column.point - first) for column in kept]
    return [column for column in columns if 0 <= column.point < NUM_KEYPOINTS]


def _parsed(index: int, name: str) -> PointColumn | None:
    """Return what the column of that name holds; None where it is no point's."""
    if len(name) > 100:
        return None
    code = _APPLE_CODE.search(name)
    rest = [code[0]] if code else []
    words = [word.lower() for word in _WORDS.findall(_APPLE_CODE.sub(" ", name, count=1))]
    axis, side, world = None, None, False
    for at, word in enumerate(words):
        if word in _AXES and axis is None and at in (0, len(words) - 1):
            axis = _AXES[word]
        elif word in _SIDE_WORDS and side is None:
            side = _SIDE_WORDS[word]
        elif word in ("world", "w"):
            world = True
        elif word not in _FILLING:
            rest.append(word)
    if axis is None or not rest:
        return None
    digits = [int(word) for word in rest if word.isdigit() and len(word) <= 4]
    if len(digits) == len(rest) <= 2:
        return PointColumn(index, digits[-1], axis, side, digits[0] if len(digits) == 2 else 0, False, world)
    point = point_named("".join(rest))
    return None if point is None else PointColumn(index, point, axis, side, 0, True, world)
