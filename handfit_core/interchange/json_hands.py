"""The hands of one frame's JSON, in the layouts that people write."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import zip_longest
from typing import Any, Final, NamedTuple

import numpy as np

from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, Side
from handfit_core.interchange.orders import HANDS, width_of
from handfit_core.interchange.point_names import KEYS, place_of, plain, side_named
from handfit_core.interchange.settings import LIMITS

PICTURE: Final = (
    "multihandlandmarks handlandmarks landmarks lmlist keypoints points joints landmark posekeypoints2d "
    "worldcoord keypoints2d"
).split()
"""Plain keys under which JSON has points in pictures"""
WORLD: Final = (
    "multihandworldlandmarks handworldlandmarks worldlandmarks landmarksworld keypoints3d landmarks3d"
).split()
"""Plain keys under which JSON has points in metres about the hand's middle"""
_OF_SIDE: Final = (
    "{}handlandmarks {} {}hand hand{}keypoints2d hand{}keypoints {}handkpts {}handkeypoints".split()
)
_WITHIN: Final = "result results hands observations detections".split()
_CHIRALITY: Final = {-1: SIDES[0], 1: SIDES[1]}
_PLACE: Final = "position location pos p translation".split()
_TURN: Final = "orientation rotation quaternion rot q".split()
_AXES: Final = "xyzcijkw"
"""Letters of a point's eight numbers: its place x, y, z, its confidence c, and a quaternion i, j, k, w"""


class JsonHand(NamedTuple):
    """One hand of one frame, or both hands of a person in one list, as the file tells it."""

    side: Side | None
    number: int
    """The number of the hand within its frame, where the file counts hands"""
    score: float
    """How sure the program is of the hand, 0..1; NaN where the file does not tell"""
    points: np.ndarray
    """(N, 8) x, y, z, how sure it is, and a quaternion x, y, z, w, in the file's order; NaN: not told"""
    world: np.ndarray
    """(N, 3) metres about the hand's middle; NaN where the file does not tell"""
    named: bool
    """True if the hand's points are named, and stand in MediaPipe's order"""
    mirrored: bool
    """True if the side holds for mirrored pictures, so that left and right must be swapped"""


def keyed(content: Any) -> dict[str, Any]:
    """Return an object's values by their plain keys; an empty dictionary for anything else."""
    return {plain(key): value for key, value in content.items()} if isinstance(content, Mapping) else {}


def hands_in(content: Any, columns: Mapping[int, str], depth: int = 0) -> Iterator[JsonHand]:
    """Yield the hands of one frame's JSON. `columns`: the meaning of lists of so many numbers, by letters of
    x, y, z, c (the confidence) and i, j, k, w (a quaternion). Raises ValueError and TypeError for what is no
    list of points."""
    if depth > 4 or content is None:
        return
    of = keyed(content)
    if isinstance(content, list) and not is_hand(content):
        for each in content[: LIMITS.hands]:
            yield from hands_in(each, columns, depth + 1)
        return
    named = False
    for side in SIDES:
        # Holistic's and OpenPose's hands are those of the person that is seen.
        for key in (name.format(side) for name in _OF_SIDE):
            if _some(of.get(key)):
                named = True
                inner = keyed(of[key])
                points = next((inner[k] for k in PICTURE if k in inner), of[key])
                world = next((inner[k] for k in WORLD if k in inner), of.get(f"{side}handworldlandmarks"))
                yield from _several([points], [world], [side], inner, columns)
    if named:
        return
    key = next((key for key in PICTURE if key in of), "")
    world_key = next((key for key in WORLD if key in of), "")
    if isinstance(inner := of.get(key), Mapping) and not is_hand(inner) and not world_key:
        yield from hands_in(inner, columns, depth + 1)
    elif key or world_key:
        points, world = (_as_hands(of.get(each)) for each in (key, world_key))
        mirrored = key == "multihandlandmarks"
        yield from _several(points, world, _sides_in(of), of, columns, mirrored=mirrored)
    elif is_hand(content):
        yield from _several([content], [], _sides_in(of), of, columns)
    else:
        yield from hands_in(next((of[key] for key in _WITHIN if of.get(key)), None), columns, depth + 1)


def _some(value: Any) -> bool:
    return bool(len(value)) if isinstance(value, np.ndarray) else bool(value)


def _sides_in(of: Mapping[str, Any]) -> list[Any]:
    """Return what a frame tells of each hand's side. Only Apple's chirality tells it by a number: others
    count hands."""
    for key in KEYS["side"]:
        told = of.get(key)
        labels = told if isinstance(told, list) else [told]
        if key == "chirality":
            labels = [_CHIRALITY.get(label, label) if type(label) is int else label for label in labels]
        if any(_label(label)[0] for label in labels):
            return labels
    return []


def _several(
    points: list[Any],
    world: list[Any],
    labels: list[Any],
    of: Mapping[str, Any],
    columns: Mapping[int, str],
    *,
    mirrored: bool = False,
) -> Iterator[JsonHand]:
    keys = (*KEYS["score"], "confidence")
    score = next((of[key] for key in keys if isinstance(of.get(key), int | float)), np.nan)
    for where, space, label in zip_longest(points, world, labels[: max(len(points), len(world))]):
        if where is None and space is None:
            continue
        side, sure = _label(label)
        seen, named = _numbers(space if where is None else where, columns)
        if where is None:
            seen = np.full_like(seen, np.nan)
        there = np.full_like(seen, np.nan)
        if space is not None:
            there, named = _numbers(space, {3: "xyz", 4: "xyzc"})
        if "keypointscores" in of:
            scores = np.array(of["keypointscores"], dtype=np.float64).ravel()
            if len(scores) != len(seen):
                raise ValueError(f"{len(seen)} points with {len(scores)} scores")
            seen[:, 3] = scores
        if not np.isnan(seen[:, 3]).all():
            seen[:, 3] = np.nan_to_num(seen[:, 3])
        sure = score if sure is None else sure
        number = of.get("handnumber")
        number = int(number) if isinstance(number, int | np.integer) and abs(number) < 1e6 else 0
        yield JsonHand(side, number, sure, seen, there[:, :3], named, mirrored)


def _label(entry: Any) -> tuple[Side | None, float | None]:
    """Return the side and how sure it is, 0..1, of a text or of MediaPipe's categories; None where not
    told."""
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
    """Return a list of hands, whether the value tells one or several."""
    if isinstance(value, list) and not is_hand(value) and not _flat(value):
        return value[: LIMITS.hands]
    return [value] if value is not None and _some(value) else []


def _flat(value: list[Any]) -> bool:
    """Return whether the numbers of all points follow one another in one list; some may be null."""
    return any(isinstance(each, int | float) for each in value[:9])


def is_hand(value: Any) -> bool:
    """Return whether a value is one hand rather than a list of hands."""
    value = _pointwise(value)
    if isinstance(value, Mapping):
        places = [
            key for key, point in value.items() if place_of(key) is not None and not _is_frame(key, point)
        ]
        return "landmark" in value or len(places) >= NUM_KEYPOINTS // 2
    if not isinstance(value, list) or not value:
        return isinstance(value, np.ndarray)
    first = next((each for each in value if each is not None), None)
    if _flat(value):
        return len(value) >= 40 and width_of(len(value), (2, 3, 4)) > 0
    if isinstance(first, Mapping):
        return {"x", "y"} <= {key.lower() for key in first if isinstance(key, str)}
    return isinstance(first, list) and 2 <= len(first) <= 4 and all(isinstance(n, int | float) for n in first)


def _pointwise(value: Any) -> Any:
    """Return the points, one after the other, of a hand whose x, y and z stand in lists of their own, or by
    numbers, as pandas writes tables; anything else as it is."""
    of = keyed(value)
    axes = [list(of[a].values()) if isinstance(of[a], Mapping) else of[a] for a in "xyz" if a in of]
    if len(axes) < 2 or not all(isinstance(axis, list) and len(axis) in HANDS for axis in axes):
        return value
    return [list(point) for point in zip(*axes, strict=True)]


def _is_frame(key: str, value: Any) -> bool:
    """Return whether a key counts a frame, which has lists or objects in it, rather than a point."""
    within = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    return key.isdigit() and (len(within) > 8 or any(isinstance(each, list | Mapping) for each in within))


def _numbers(hand: Any, columns: Mapping[int, str]) -> tuple[np.ndarray, bool]:
    """Return the numbers (N, 8) in the order of `_AXES` of whatever stands for points, and whether their
    names tell which points they are. Raises ValueError, TypeError."""
    if isinstance(hand, np.ndarray):
        return np.pad(hand, ((0, 0), (0, len(_AXES) - hand.shape[1])), constant_values=np.nan), False
    if isinstance(hand, Mapping) and "landmark" in hand:
        hand = hand["landmark"]
    hand = _pointwise(hand)
    if isinstance(hand, list) and hand and all(isinstance(each, Mapping) for each in hand):
        names = [each.get("name", each.get("part")) for each in hand]
        if all(isinstance(name, str) for name in names):
            hand = dict(zip(names, hand, strict=True))
    named = False
    if isinstance(hand, Mapping):
        places = {place: value for key, value in hand.items() if (place := place_of(key)) is not None}
        named = not all(key.isdigit() for key in hand)
        hand = [places.get(place) for place in range(NUM_KEYPOINTS)]
    if not isinstance(hand, list):
        raise ValueError("a hand is neither a list nor an object of points")
    if _flat(hand):
        size = width_of(len(hand), columns)
        if not size:
            raise ValueError(
                f"{len(hand)} numbers of a hand; expected 21 times {' or '.join(columns.values())}"
            )
        hand = [hand[i : i + size] for i in range(0, len(hand), size)]
    points = [_point(value, columns) for value in hand]
    try:
        return np.array(points, dtype=np.float64).reshape(-1, len(_AXES)), named
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError("a point has something that is no number") from error


def _point(value: Any, columns: Mapping[int, str]) -> list[Any]:
    """Return a point's numbers in the order of `_AXES`; None for those that are not told."""
    if isinstance(value, list):
        if len(value) not in columns:
            raise ValueError(f"a point of {len(value)} numbers; expected {' or '.join(columns.values())}")
        told = dict(zip(columns[len(value)], value, strict=True))
        return [told.get(axis) for axis in _AXES]
    of = keyed(value)
    of = next((keyed(of[key]) for key in ("pose", "transform") if isinstance(of.get(key), Mapping)), of)
    place, turn = (
        next((of[key] for key in keys if isinstance(of.get(key), list | Mapping)), None)
        for keys in (_PLACE, _TURN)
    )
    sure = next((of[key] for key in ("confidence", "score") if of.get(key) is not None), None)
    return [*_axes_of(of if place is None else place, "xyz"), sure, *_axes_of(turn, "xyzw")]


def _axes_of(told: Any, names: str) -> list[Any]:
    """Return the numbers of an object or a list for these letters; the list may have more numbers, or
    fewer."""
    if isinstance(told, list):
        return [*told, None, None, None, None][: len(names)]
    of = keyed(told)
    return [of.get(name) for name in names]
