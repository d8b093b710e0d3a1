"""How other programs name a hand's 21 points, in JSON keys and in columns of tables."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from handfit_core.common.skeleton import FINGERS, KEYPOINT_NAMES, NUM_KEYPOINTS, SIDES, Side

_APPLE_CODE: Final = re.compile(r"VNHLK([A-Z]{3,4})")
_APPLE_THUMB: Final = re.compile(r"thumb_?MP(?![a-zA-Z])", re.IGNORECASE)
_WORDS: Final = re.compile(r"[a-z]+|[A-Z]+(?![a-z])|[A-Z][a-z]+|\d+")
_AXES: Final = {"x": "x", "y": "y", "z": "z"} | dict.fromkeys(
    ("c", "conf", "confidence", "score", "visibility", "v", "likelihood", "presence"), "c"
)
_SIDE_WORDS: Final[dict[str, Side]] = {
    **dict.fromkeys(("left", "lefthand", "l", "lh"), SIDES[0]),
    **dict.fromkeys(("right", "righthand", "r", "rh"), SIDES[1]),
}
_FILLING: Final = frozenset(
    "hand landmark landmarks lm kp kpt point keypoint joint p pt h mediapipe norm px".split()
)


_NAMES: Final = (
    {name.replace("_", ""): point for point, name in enumerate(KEYPOINT_NAMES)}
    | {
        called + between + joint: 1 + 4 * number + place
        for number, finger in enumerate(FINGERS)
        for place, joint in enumerate(
            ("cmc", "mcp", "ip", "tip") if number == 0 else ("mcp", "pip", "dip", "tip")
        )
        for called in ((finger, "pinky") if finger == "little" else (finger,))
        for between in ("", "finger")
    }
    | {"thumbmp": 2}
)  # Apple's


def plain(name: str) -> str:
    """A key or a column's name without its case and the signs between its words."""
    return re.sub(r"[^a-z0-9]", "", name[:300].lower())


def point_named(name: str) -> int | None:
    """Which of the 21 points somebody calls so: MediaPipe (INDEX_FINGER_MCP), Apple's Vision (indexMCP,
    VNHLKIMCP), and this project (index_1); None: none."""
    if code := _APPLE_CODE.search(name):
        if code[1] == "WRI":
            return 0
        return _NAMES.get(dict(zip("TIMRP", FINGERS, strict=True)).get(code[1][0], "") + code[1][1:].lower())
    return _NAMES.get(plain(name))


def is_apple(name: str) -> bool:
    """Whether a point's or a column's name is Apple's Vision's alone: its keys, and its thumb's MP."""
    return bool(_APPLE_CODE.search(name)) or bool(_APPLE_THUMB.search(name))


def side_named(text: object) -> Side | None:
    """The side that a label names, as in Left, right_hand, R; None: none."""
    if not isinstance(text, str):
        return None
    words = [word.lower() for word in _WORDS.findall(text[:100])]
    sides: set[Side] = {_SIDE_WORDS[word] for word in words if word in _SIDE_WORDS}
    return next(iter(sides)) if len(sides) == 1 else None


@dataclass(frozen=True)
class PointColumn:
    """A table's column that holds one number of a hand's point."""

    index: int
    """Which column"""
    point: int
    axis: str
    """x, y, z, or c: how sure it is"""
    side: Side | None
    hand: int
    """Which hand, where columns number them"""
    world: bool
    """Whether it is in metres about the hand's middle, as MediaPipe's world landmarks"""


def point_columns(names: Sequence[str]) -> list[PointColumn]:
    """The columns of a table in which each row holds whole hands, as in x0, wrist_x or right_hand_wrist_x.

    Where points are numbered from 1, 21 is among them and 0 is not.
    """
    found = [parsed for index, name in enumerate(names) if (parsed := _parsed(index, name)) is not None]
    numbered = {column.point for column, counts in found if counts}
    first = 1 if NUM_KEYPOINTS in numbered and 0 not in numbered else 0
    columns = [replace(column, point=column.point - first * counts) for column, counts in found]
    return [column for column in columns if 0 <= column.point < NUM_KEYPOINTS]


def _parsed(index: int, name: str) -> tuple[PointColumn, bool] | None:
    """The column, and whether its point is numbered rather than named; None: it is no point's."""
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
        return PointColumn(index, digits[-1], axis, side, digits[0] if len(digits) == 2 else 0, world), True
    point = point_named("".join(rest))
    return None if point is None else (PointColumn(index, point, axis, side, 0, world), False)
