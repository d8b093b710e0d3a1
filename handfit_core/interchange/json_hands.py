"""Hands in the JSON that people write of MediaPipe's and Apple's results, which has no one layout."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any, Final

import numpy as np

from handfit_core.interchange.numbered import keyed
from handfit_core.interchange.point_names import point_named, side_named
from handfit_core.interchange.settings import LIMITS
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES, Side

_NAMES: Final = {
    "picture": "multihandlandmarks handlandmarks landmarks lmlist keypoints points joints landmark".split(),
    "world": "multihandworldlandmarks handworldlandmarks worldlandmarks landmarksworld".split(),
    "side": "multihandedness handedness handednesses side label type hand chirality".split(),
    "score": "score confidence handednessscore".split(),
    "within": "result results hands observations detections".split(),
}
"""Names by what they hold, in lower case and without what is between words"""
_CHIRALITY: Final = {-1: SIDES[0], 1: SIDES[1]}


@dataclass(frozen=True, eq=False)
class JsonHand:
    """One hand of one frame, as it is told."""

    points: np.ndarray | None
    """(21, 4) x, y, z, and how sure it is; NaN: not told. None: only the world is told"""
    world: np.ndarray | None
    """(21, 3) metres"""
    label: Side | None
    score: float | None
    mirrored: bool | None
    """Whether the label counts for mirrored pictures; None: not known"""


def hands_in(content: Any, depth: int = 0) -> Iterator[JsonHand]:
    """The hands of one frame's JSON. Raises ValueError for hands that have other than 21 points."""
    if depth > 4 or content is None:
        return
    if isinstance(content, list):
        if is_hand(content):
            yield from _several([content], [], [], {}, mirrored=None)
        else:
            for each in content[: LIMITS.hands]:
                yield from hands_in(each, depth + 1)
        return
    of = keyed(content)
    named = False
    for side in SIDES:
        # Holistic's hands are those of the person that is seen.
        for key in (f"{side}handlandmarks", side, f"{side}hand"):
            if of.get(key):
                named = True
                value = of[key]
                inner = keyed(value)
                points = next((inner[k] for k in _NAMES["picture"] if k in inner), value)
                world = next(
                    (inner[k] for k in _NAMES["world"] if k in inner), of.get(f"{side}handworldlandmarks")
                )
                yield from _several([points], [world], [side], inner, mirrored=False)
    if named:
        return
    key = next((key for key in _NAMES["picture"] if key in of), None)
    world_key = next((key for key in _NAMES["world"] if key in of), None)
    if key is None and world_key is None:
        if is_hand(content):
            yield from _several([content], [], [_told(of)], of, mirrored=None)
            return
        for within in _NAMES["within"]:
            if of.get(within):
                yield from hands_in(of[within], depth + 1)
                return
        return
    points, world = (_as_hands(of.get(k)) if k else [] for k in (key, world_key))
    newer = {"handlandmarks", "handednesses"} & set(of)
    mirrored = True if key == "multihandlandmarks" else False if newer else None
    yield from _several(points, world, _told(of), of, mirrored=mirrored)


def _told(of: Mapping[str, Any]) -> list[Any]:
    """What is told of each hand's side. Only Apple's chirality tells it by a number: others count hands."""
    for key in _NAMES["side"]:
        told = of.get(key)
        labels = told if isinstance(told, list) else [told]
        if key == "chirality":
            labels = [_CHIRALITY.get(label, label) if type(label) is int else label for label in labels]
        if any(label is not None and not isinstance(label, int | float) for label in labels):
            return labels
    return []


def _several(
    points: list[Any], world: list[Any], labels: list[Any], of: Mapping[str, Any], *, mirrored: bool | None
) -> Iterator[JsonHand]:
    count = max(len(points), len(world))
    score = next((of[key] for key in _NAMES["score"] if isinstance(of.get(key), int | float)), None)
    for where, space, label in zip_longest(points, world, labels[:count]):
        side, sure = _label(label)
        seen = None if where is None else _numbers(where)
        there = None if space is None else _numbers(space)
        if seen is not None or there is not None:
            world_points = None if there is None else there[:, :3]
            yield JsonHand(seen, world_points, side, sure if sure is not None else score, mirrored)


def _label(entry: Any) -> tuple[Side | None, float | None]:
    """The side and how sure it is, of a text or of MediaPipe's categories."""
    while isinstance(entry, list):
        entry = entry[0] if entry else None
    if isinstance(entry, str):
        return side_named(entry), None
    of = keyed(entry)
    if "classification" in of:
        return _label(of["classification"])
    named = next((of[key] for key in ("categoryname", "label", "displayname", "name") if of.get(key)), None)
    score = of.get("score")
    return side_named(named), float(score) if isinstance(score, int | float) else None


def _as_hands(value: Any) -> list[Any]:
    """A list of hands, whether one or several are told."""
    if value is None:
        return []
    if is_hand(value):
        return [value]
    return value[: LIMITS.hands] if isinstance(value, list) else [value]


def is_hand(value: Any) -> bool:
    """Whether this is one hand rather than a list of hands."""
    if isinstance(value, Mapping):
        return "landmark" in value or sum(_place(key) is not None for key in value) >= NUM_KEYPOINTS // 2
    if not isinstance(value, list) or len(value) == 0:
        return False
    first = value[0]
    if isinstance(first, int | float):
        return len(value) in (2 * NUM_KEYPOINTS, 3 * NUM_KEYPOINTS)
    if isinstance(first, Mapping):
        return {"x", "y"} <= {key.lower() for key in first if isinstance(key, str)}
    return isinstance(first, list) and 2 <= len(first) <= 4 and all(isinstance(n, int | float) for n in first)


def _place(key: Any) -> int | None:
    if not isinstance(key, str):
        return None
    if key.isascii() and key.isdigit():
        return int(key) if len(key) < 3 and int(key) < NUM_KEYPOINTS else None
    return point_named(key)


def _numbers(hand: Any) -> np.ndarray:
    """(21, 4) x, y, z and how sure it is, of whatever stands for one hand. Raises ValueError."""
    table = np.full((NUM_KEYPOINTS, 4), np.nan)
    if isinstance(hand, Mapping) and "landmark" in hand:
        hand = hand["landmark"]
    if isinstance(hand, Mapping):
        for key, value in hand.items():
            place = _place(key)
            if place is not None:
                table[place] = _point(value)
        return table
    if not isinstance(hand, list):
        raise ValueError("a hand is neither a list nor an object of points")
    if hand and isinstance(hand[0], int | float) and len(hand) in (2 * NUM_KEYPOINTS, 3 * NUM_KEYPOINTS):
        size = len(hand) // NUM_KEYPOINTS
        hand = [hand[i : i + size] for i in range(0, len(hand), size)]
    if len(hand) != NUM_KEYPOINTS:
        raise ValueError(f"a hand of {len(hand)} points; expected 21")
    for place, value in enumerate(hand):
        table[place] = _point(value)
    return table


def _point(value: Any) -> tuple[float, float, float, float]:
    """x, y, z and how sure it is."""
    number: Callable[[Any], float] = lambda v: np.nan if v is None else float(v)  # noqa: E731
    if value is None:
        return np.nan, np.nan, np.nan, np.nan
    if isinstance(value, list) and 2 <= len(value) <= 4:
        x, y, z, sure = (*map(number, value), np.nan, np.nan)[:4]
        return x, y, z, sure
    of = keyed(value)
    inner = of.get("location") or of.get("position")
    if inner is not None:
        x, y, z, _ = _point(inner)
    else:
        x, y, z = (number(of.get(axis)) for axis in "xyz")
    sure = next((number(of[key]) for key in ("confidence", "score") if of.get(key) is not None), np.nan)
    return x, y, z, sure
