"""Frames and hands in JSON, in the layouts that people write: a file a frame, or all in one file."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from handfit_core.common.errors import InputError
from handfit_core.common.files import shown
from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, Side
from handfit_core.common.values import LARGEST_WHOLE
from handfit_core.interchange.document import Document
from handfit_core.interchange.orders import width_of
from handfit_core.interchange.point_names import plain, point_named, side_named
from handfit_core.interchange.settings import LIMITS

_LAST_NUMBER: Final = re.compile(r"\d+(?!.*\d)")
_FRAMES: Final = "frames results data predictions detections annotations instanceinfo".split()
_FRAME: Final = "frame frameid framenumber frameindex frameidx frameno imageid".split()
_TIME: Final = "timestamp timestampms timestampinmilliseconds time timems t predicteddisplaytime".split()
_PICTURE: Final = (
    "multihandlandmarks handlandmarks landmarks lmlist keypoints points joints landmark posekeypoints2d "
    "worldcoord keypoints2d"
).split()
_WORLD: Final = (
    "multihandworldlandmarks handworldlandmarks worldlandmarks landmarksworld keypoints3d landmarks3d"
).split()
_OF_SIDE: Final = (
    "{}handlandmarks {} {}hand hand{}keypoints2d hand{}keypoints {}handkpts {}handkeypoints".split()
)
_SIDE: Final = "multihandedness handedness handednesses side label type handtype hand chirality".split()
_SCORE: Final = "score confidence handednessscore".split()
_WITHIN: Final = "result results hands observations detections".split()
_PICTURES: Final = (".jpg", ".jpeg", ".png", ".bmp")
_CHIRALITY: Final = {-1: SIDES[0], 1: SIDES[1]}


def keyed(content: Any) -> dict[str, Any]:
    """An object's values by their plain keys; nothing for anything else."""
    return {plain(key): value for key, value in content.items()} if isinstance(content, Mapping) else {}


def objects_in(content: Any, most: int = 2000) -> Iterator[Mapping[str, Any]]:
    """The objects in JSON, each before those within it, among the first `most` values."""
    waiting = [content]
    for _ in range(most):
        if not waiting:
            return
        each = waiting.pop()
        if isinstance(each, Mapping):
            yield each
            each = each.values()
        elif not isinstance(each, list):
            continue
        waiting += reversed(list(islice(each, most)))


def several_hands(frames: Mapping[Side, int]) -> list[str]:
    """Phrases for the frames, counted, in which hands of a side came after another one, and were left out."""
    return [
        f"{count} {'frame has' if count == 1 else 'frames have'} several {side} hands: the first was taken"
        for side, count in frames.items()
        if count
    ]


# Frames


@dataclass(frozen=True, eq=False)
class JsonFrames:
    """T frames of a document, in order."""

    numbers: np.ndarray
    """(T,) int, increasing"""
    contents: list[Any]
    """(T) what the JSON has for each"""
    header: dict[str, Any] = field(default_factory=dict)
    """What stands beside the frames, by plain keys"""
    assumed: tuple[str, ...] = ()

    @property
    def fps(self) -> float:
        """Frames per second, as a header or the frames' times tell; 0: not told."""
        for key in ("fps", "framerate", "framespersecond"):
            told = self.header.get(key)
            if isinstance(told, int | float) and not isinstance(told, bool) and 1e-3 < told < 1e6:
                return float(told)
        of = [keyed(content) for content in self.contents]
        for key in _TIME:
            times = [each.get(key) for each in of]
            if all(isinstance(time, int | float) and abs(time) < 1e300 for time in times):
                return rate_of(self.numbers, np.array(times, dtype=float))
        return 0.0


def rate_of(frames: np.ndarray, times: np.ndarray) -> float:
    """Frames per second of frames (N,) at times (N,) in seconds, or in milli-, micro- or nanoseconds,
    whichever makes it 1 or more; 0 where they tell none."""
    there = np.isfinite(times)
    order = np.argsort(frames[there], kind="stable")
    steps, spent = np.diff(frames[there][order]), np.diff(times[there][order])
    moved = (steps > 0) & (spent > 0.0)
    if not moved.any():
        return 0.0
    step = float(np.median(spent[moved] / steps[moved]))
    unit = next((unit for unit in (1.0, 1e-3, 1e-6, 1e-9) if step * unit <= 1.0), 0.0)
    rate = 1.0 / (step * unit) if step * unit > 1e-4 else 0.0
    # Milliseconds are often whole numbers.
    nearest = round(rate)
    return float(nearest) if unit == 1e-3 and abs(rate - nearest) < 0.02 * nearest else rate


def some_contents(document: Document) -> Iterator[Any]:
    """A document's JSON, or that of a folder's first files, as those of frames without anybody say little."""
    if not document.is_folder:
        yield document.json if document.json is not None else document.lines
    else:
        for file in document.files(".json")[: LIMITS.looked_at]:
            yield Document(file).json


def frames_of(document: Document, is_one: Callable[[Any], bool], *, grouped: bool = False) -> JsonFrames:
    """The frames of a folder of JSON files, of a list, of an object with a list or with frames by their
    numbers, or of a single frame, of which `is_one` says that it is no list of frames. `grouped`: whether
    what has the same number belongs to one frame. Raises InputError."""
    if document.is_folder:
        files, assumed = _frame_files(document)
        contents = [Document(file).json for _, file in files]
        for (_, file), content in zip(files, contents, strict=True):
            if content is None:
                raise InputError(f"{shown(file)}: this file of the sequence is no JSON, or a damaged one")
        return _in_order(document, [number for number, _ in files], contents, {}, assumed)
    content = next(some_contents(document))
    header = keyed(content)
    if isinstance(content, Mapping):
        listed = next((header[key] for key in _FRAMES if isinstance(header.get(key), list | dict)), None)
        # Where more hands stand beside one another than a picture has, they are one hand's frames.
        many = (header[key] for key in (*_PICTURE, *_WORLD) if isinstance(header.get(key), list))
        listed = listed or next((each for each in many if len(each) > 8 and all(map(is_hand, each))), None)
        if listed is not None:
            content = listed
            header = {k: v for k, v in header.items() if k == "images" or not isinstance(v, list | dict)}
    alone = is_one(content)
    keys = [_number_of(key) for key in content] if isinstance(content, Mapping) and not alone else []
    numbers = [number for number in keys if number is not None]
    if isinstance(content, Mapping) and numbers and len(numbers) == len(keys):
        of = next(iter(content.values()))
        if isinstance(of, Mapping) and of and all(map(_digits, of)):
            if len(content) > 1:
                some = ", ".join(list(content)[:5])
                raise InputError(
                    f"{shown(document.path)}: it has {len(content)} clips ({some} ..); give each its own file"
                )
            content = of
            numbers = [int(key) for key in content]
        return _in_order(document, numbers, list(content.values()), header)
    if isinstance(content, Mapping) or alone:
        number = _number_in(content) or _number_in({"frame": document.path.stem}) or 1
        return _in_order(document, [number], [content], header)
    if not isinstance(content, list) or not content:
        raise InputError(f"{shown(document.path)}: there is no frame in it ({document.found})")
    told = [number for each in content if (number := _number_in(each)) is not None]
    if len(told) == len(content):
        return _in_order(document, told, content, header, grouped=grouped)
    assumed = ("its frames have no numbers: they are counted from 1",) if len(content) > 1 else ()
    return _in_order(document, range(1, len(content) + 1), content, header, assumed)


def _in_order(
    document: Document,
    told: Collection[int],
    contents: list[Any],
    header: dict[str, Any],
    assumed: tuple[str, ...] = (),
    *,
    grouped: bool = False,
) -> JsonFrames:
    """Frames by their numbers. Raises InputError where one comes twice, or there are too many."""
    if grouped and len(set(told)) < len(told):
        together: dict[int, list[Any]] = {}
        for number, content in zip(told, contents, strict=True):
            together.setdefault(number, []).append(content)
        told, contents = list(together), list(together.values())
    LIMITS.check(document.path, len(contents))
    numbers = np.array([*told], dtype=np.int64)
    order = np.argsort(numbers, kind="stable")
    numbers = numbers[order]
    twice = np.flatnonzero(np.diff(numbers) == 0)
    if len(twice):
        raise InputError(f"{shown(document.path)}: frame {numbers[twice[0]]} is there twice")
    return JsonFrames(numbers, [contents[i] for i in order], header, assumed)


def _frame_files(document: Document) -> tuple[list[tuple[int, Path]], tuple[str, ...]]:
    """The JSON files of a folder with the frames' numbers, which are the last numbers in their names, and
    what was assumed. Where most have one, the others are left out; where most have none, all are counted from
    1. Raises InputError for files of several sequences."""
    files = document.files(".json")
    found = [(_last_number(file.stem), file) for file in files]
    numbered = [(match, file) for match, file in found if match]
    others = [shown(file.name) for match, file in found if not match]
    more = f" and {len(others) - 1} more have no number in their names"
    which = f"{others[0]}{more if len(others) > 1 else ' has no number in its name'}" if others else ""
    if others and len(others) >= len(numbered):
        said = f"{which}: frames are counted from 1, by the names"
        return list(enumerate(files, 1)), (said,) if len(files) > 1 else ()
    around = {(file.stem[: match.start()], file.stem[match.end() :]) for match, file in numbered}
    if len(around) > 1:
        first, second = ("..".join(each) for each in sorted(around)[:2])
        raise InputError(
            f"{shown(document.path)}: its frames belong to several clips ({first} and {second}, for "
            "example); give each its own folder"
        )
    return [(int(match[0]), file) for match, file in numbered], (f"{which}: left out",) if others else ()


def _last_number(text: str) -> re.Match[str] | None:
    match = _LAST_NUMBER.search(text[-300:])
    return match if match and len(match[0]) <= LIMITS.number_digits else None


def _digits(key: Any) -> bool:
    return isinstance(key, str) and key.isascii() and key.isdigit() and len(key) <= LIMITS.number_digits


def _number_of(key: Any) -> int | None:
    """The frame that a key counts, or whose picture it names."""
    if _digits(key):
        return int(key)
    stem = key.rpartition(".")[0] if isinstance(key, str) and key.lower().endswith(_PICTURES) else ""
    return _number_in({"frame": stem}) if stem else None


def _number_in(content: Any) -> int | None:
    """The number of a frame that tells its own; a text's last number, as of a picture's name."""
    of = keyed(content)
    for value in (of[key] for key in _FRAME if key in of):
        if isinstance(value, str) and (match := _last_number(value)):
            return int(match[0])
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        if abs(value) <= LARGEST_WHOLE and value == int(value):
            return int(value)
    return None


def size_in(header: Mapping[str, Any]) -> tuple[int, int] | None:
    """The pictures' size as plain keys tell it; None where they do not."""
    images = header.get("images")
    pictures = keyed(images[0]) if isinstance(images, list) and images else {}
    for of, before in ((header, ""), (header, "canvas"), (pictures, "")):
        sides = of.get(f"{before}width"), of.get(f"{before}height")
        if all(type(side) is int and 0 < side < 1 << 24 for side in sides):
            return sides  # type: ignore[return-value]
    return None


# Hands


class JsonHand(NamedTuple):
    """One hand of one frame, or people's both, as it is told."""

    side: Side | None
    score: float
    """NaN: not told"""
    points: np.ndarray
    """(N, 4) x, y, z, and how sure it is, in the file's order; NaN: not told"""
    world: np.ndarray
    """(N, 3) metres; NaN: not told"""
    named: bool
    """Whether its points are named, and stand in MediaPipe's order"""
    mirrored: bool | None
    """Whether the side counts for mirrored pictures; None: not known"""


def hands_in(content: Any, columns: Mapping[int, str], depth: int = 0) -> Iterator[JsonHand]:
    """The hands of one frame's JSON. `columns`: what stands in lists of so many numbers, of x, y, z and c,
    the confidence. Raises ValueError and TypeError for what is no list of points."""
    if depth > 4 or content is None:
        return
    if isinstance(content, list):
        if is_hand(content):
            yield from _several([content], [], [], {}, columns, mirrored=None)
        else:
            for each in content[: LIMITS.hands]:
                yield from hands_in(each, columns, depth + 1)
        return
    of = keyed(content)
    named = False
    for side in SIDES:
        # Holistic's and OpenPose's hands are those of the person that is seen.
        for key in (name.format(side) for name in _OF_SIDE):
            if of.get(key):
                named = True
                inner = keyed(of[key])
                points = next((inner[k] for k in _PICTURE if k in inner), of[key])
                world = next((inner[k] for k in _WORLD if k in inner), of.get(f"{side}handworldlandmarks"))
                yield from _several([points], [world], [side], inner, columns, mirrored=False)
    if named:
        return
    key = next((key for key in _PICTURE if key in of), None)
    world_key = next((key for key in _WORLD if key in of), None)
    if key is None and world_key is None:
        if is_hand(content):
            yield from _several([content], [], [_sides_in(of)], of, columns, mirrored=None)
        else:
            within = next((of[key] for key in _WITHIN if of.get(key)), None)
            yield from hands_in(within, columns, depth + 1)
        return
    points, world = (_as_hands(of.get(k)) if k else [] for k in (key, world_key))
    newer = {"handlandmarks", "handednesses"} & set(of)
    mirrored = True if key == "multihandlandmarks" else False if newer else None
    yield from _several(points, world, _sides_in(of), of, columns, mirrored=mirrored)


def _sides_in(of: Mapping[str, Any]) -> list[Any]:
    """What is told of each hand's side. Only Apple's chirality tells it by a number: others count hands."""
    for key in _SIDE:
        told = of.get(key)
        labels = told if isinstance(told, list) else [told]
        if key == "chirality":
            labels = [_CHIRALITY.get(label, label) if type(label) is int else label for label in labels]
        if any(label is not None and not isinstance(label, int | float) for label in labels):
            return labels
    return []


def _several(
    points: list[Any],
    world: list[Any],
    labels: list[Any],
    of: Mapping[str, Any],
    columns: Mapping[int, str],
    *,
    mirrored: bool | None,
) -> Iterator[JsonHand]:
    score = next((of[key] for key in _SCORE if isinstance(of.get(key), int | float)), np.nan)
    count = max(len(points), len(world))
    for where, space, label in zip_longest(points, world, labels[:count]):
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
        yield JsonHand(side, score if sure is None else sure, seen, there[:, :3], named, mirrored)


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
    several = isinstance(value, list) and not is_hand(value) and not _flat(value)
    return value[: LIMITS.hands] if several else [value] if value else []


def _flat(value: list[Any]) -> bool:
    """True if numbers of points follow one another without lists; some may be null."""
    return any(isinstance(each, int | float) for each in value[:9])


def is_hand(value: Any) -> bool:
    """Whether this is one hand rather than a list of hands."""
    if isinstance(value, Mapping):
        return "landmark" in value or sum(_place(key) is not None for key in value) >= NUM_KEYPOINTS // 2
    if not isinstance(value, list) or not value:
        return False
    first = value[0]
    if _flat(value):
        return len(value) >= 40 and width_of(len(value), (2, 3, 4)) > 0
    if isinstance(first, Mapping):
        return {"x", "y"} <= {key.lower() for key in first if isinstance(key, str)}
    return isinstance(first, list) and 2 <= len(first) <= 4 and all(isinstance(n, int | float) for n in first)


def _place(key: str) -> int | None:
    """Which of the 21 points a key names or counts."""
    if _digits(key):
        return int(key) if int(key) < NUM_KEYPOINTS else None
    return point_named(key)


def _numbers(hand: Any, columns: Mapping[int, str]) -> tuple[np.ndarray, bool]:
    """(N, 4) x, y, z and how sure it is, of whatever stands for points, and whether their names tell which
    they are. Raises ValueError, TypeError."""
    if isinstance(hand, Mapping) and "landmark" in hand:
        hand = hand["landmark"]
    if isinstance(hand, list) and hand and all(isinstance(each, Mapping) for each in hand):
        names = [each.get("name", each.get("part")) for each in hand]
        if all(isinstance(name, str) for name in names):
            hand = dict(zip(names, hand, strict=True))
    named = False
    if isinstance(hand, Mapping):
        places = {place: value for key, value in hand.items() if (place := _place(key)) is not None}
        named = not all(map(_digits, hand))
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
    return np.array([_point(value, columns) for value in hand], dtype=np.float64).reshape(-1, 4), named


def _point(value: Any, columns: Mapping[int, str]) -> list[Any]:
    """x, y, z and how sure it is; None: not told."""
    if value is None:
        return [None] * 4
    if isinstance(value, list):
        if len(value) not in columns:
            raise ValueError(f"a point of {len(value)} numbers; expected {' or '.join(columns.values())}")
        told = dict(zip(columns[len(value)], value, strict=True))
        return [told.get(axis) for axis in "xyzc"]
    of = keyed(value)
    inner = of.get("location") or of.get("position")
    place = _point(inner, columns)[:3] if inner is not None else [of.get(axis) for axis in "xyz"]
    return [*place, next((of[key] for key in ("confidence", "score") if of.get(key) is not None), None)]
