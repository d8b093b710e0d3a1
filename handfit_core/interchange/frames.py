"""The frames of a file of points, whatever holds them: JSON, lines of it, a folder, a table or arrays. Each
becomes objects as JSON has them, from which `json_hands` takes the hands."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.errors import InputError
from handfit_core.common.files import shown
from handfit_core.common.skeleton import NUM_KEYPOINTS
from handfit_core.common.values import LARGEST_WHOLE
from handfit_core.geometry.camera import Intrinsics
from handfit_core.interchange.document import Document
from handfit_core.interchange.json_hands import PICTURE, WORLD, is_hand, keyed
from handfit_core.interchange.orders import HANDS, WHOLE_BODIES, width_of
from handfit_core.interchange.point_names import KEYS, side_named
from handfit_core.interchange.settings import LIMITS

_LAST_NUMBER: Final = re.compile(r"\d+(?!.*\d)")
_LISTS: Final = "frames samples results data predictions detections annotations instanceinfo".split()
_PICTURES: Final = (".jpg", ".jpeg", ".png", ".bmp")


@dataclass(frozen=True, eq=False)
class Frames:
    """The T frames of a file of points, in order."""

    numbers: np.ndarray
    """(T,) int, increasing: the frames' numbers"""
    contents: list[Any]
    """For each of the T frames what the file has about it, as JSON values"""
    header: dict[str, Any] = field(default_factory=dict)
    """The values that stand beside the frames in the file, by plain keys"""
    assumed: tuple[str, ...] = ()
    intrinsics: Intrinsics | None = None
    order: str = ""
    """The order of the points, a key of `ORDERS`, as the file tells it; empty where it does not"""
    in_space: bool = False
    """True if points are in space, rather than in the picture plane with a depth"""
    mirrored: bool = False
    """True if the file's sides hold for mirrored pictures, so that left and right must be swapped"""
    halved: bool = False
    """True if parts of the picture's size go from -1 to 1, rather than from 0 to 1"""
    guessed: bool = False
    """True if which hand is the left one is guessed by its place in a list"""

    @property
    def fps(self) -> float:
        """Frames per second, by the header or the frames' times; 0 where the file does not tell."""
        for key in ("fps", "framerate", "framespersecond"):
            told = self.header.get(key)
            if isinstance(told, int | float) and not isinstance(told, bool) and 1e-3 < told < 1e6:
                return float(told)
        of = [keyed(content) for content in self.contents]
        for key in KEYS["time"]:
            times = [each.get(key) for each in of]
            if all(isinstance(time, int | float) and abs(time) < 1e300 for time in times):
                return rate_of(self.numbers, np.array(times, dtype=float))
        return 0.0

    @property
    def size(self) -> tuple[int, int] | None:
        """The pictures' (width, height) in pixels, by the header or the first frame; None where the file does
        not tell."""
        images = self.header.get("images")
        picture = keyed(images[0]) if isinstance(images, list) and images else {}
        for of in (self.header, picture, keyed(self.contents[0])):
            for before in ("", "canvas"):
                size = of.get(f"{before}width"), of.get(f"{before}height")
                if all(type(side) is int and 0 < side < 1 << 24 for side in size):
                    return size  # type: ignore[return-value]
        return None


def rate_of(frames: np.ndarray, times: np.ndarray) -> float:
    """Return frames per second of frame numbers (N,) at times (N,) in seconds, or in milli-, micro- or
    nanoseconds, whichever makes the rate 1 or more; 0 where they tell none."""
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


# JSON


def some_contents(document: Document) -> Iterator[Any]:
    """Yield the JSON content of a document, or of several of a folder's first files, as frames in which
    nobody is seen say little."""
    files = document.files(".json")[: LIMITS.looked_at]
    return (each.json for each in (map(Document, files) if document.is_folder else [document]))


def objects_in(content: Any, most: int = 2000) -> Iterator[Mapping[str, Any]]:
    """Yield the objects in JSON, each before those within it, among the first `most` values."""
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


def frames_of_json(document: Document, *, grouped: bool) -> Frames:
    """Return the frames of a folder of JSON files, of a list, of an object with a list or with frames by
    their numbers, or of a single frame. `grouped`: what has the same number belongs to one frame. Raises
    InputError."""
    path = shown(document.path)
    if document.is_folder:
        files, assumed = _frame_files(document)
        contents = [Document(file).json for _, file in files]
        for (_, file), content in zip(files, contents, strict=True):
            if content is None:
                raise InputError(f"{shown(file)}: this file of the sequence is no JSON, or a damaged one")
        return in_order(document, [number for number, _ in files], contents, assumed=assumed)
    content = next(some_contents(document))
    header = keyed(content)
    listed = next((header[key] for key in _LISTS if isinstance(header.get(key), list | dict)), None)
    # Where more hands stand beside one another than a picture has, they are one hand's frames.
    many = (header[key] for key in (*PICTURE, *WORLD) if isinstance(header.get(key), list))
    listed = listed or next((each for each in many if len(each) > 8 and all(map(is_hand, each))), None)
    if listed is not None:
        content = listed
        header = {k: v for k, v in header.items() if k == "images" or not isinstance(v, list | dict)}
    # MMPose's persons stand in a list without a frame about it.
    persons = isinstance(content, list) and content and "keypointscores" in keyed(content[0])
    alone = persons or is_hand(content)
    numbers = [_counted(key) for key in content] if isinstance(content, Mapping) and not alone else []
    if isinstance(content, Mapping) and numbers and None not in numbers:
        of = next(iter(content.values()))
        if isinstance(of, Mapping) and of and all(map(_digits, of)):
            if len(content) > 1:
                some = ", ".join(list(content)[:5])
                raise InputError(f"{path}: it has {len(content)} clips ({some} ..); give each its own file")
            content, numbers = of, [int(key) for key in of]
        return in_order(document, numbers, list(content.values()), header)
    if isinstance(content, Mapping) or alone:
        number = number_in(content) or number_in({"frame": document.path.stem}) or 1
        return in_order(document, [number], [content], header)
    told = [number_in(each) for each in content or ()]
    if None not in told:
        return in_order(document, told, content, header, grouped=grouped)
    assumed = ("its frames have no numbers: they are counted from 1",) if len(content) > 1 else ()
    return in_order(document, range(1, len(content) + 1), content, header, assumed)


def in_order(
    document: Document,
    told: Collection[Any],
    contents: list[Any],
    header: dict[str, Any] | None = None,
    assumed: tuple[str, ...] = (),
    *,
    grouped: bool = False,
) -> Frames:
    """Return the frames sorted by their numbers. Raises InputError where a number comes twice, or there are
    no frames or too many."""
    if not len(told):
        raise InputError(f"{shown(document.path)}: there is no frame in it ({document.found})")
    if grouped and len(set(told)) < len(told):
        together: dict[int, list[Any]] = {}
        for number, content in zip(told, contents, strict=True):
            together.setdefault(number, []).append(content)
        told, contents = list(together), list(together.values())
    LIMITS.check(document.path, len(contents))
    numbers = np.array([*told], dtype=np.int64)
    by_number = np.argsort(numbers, kind="stable")
    numbers = numbers[by_number]
    twice = np.flatnonzero(np.diff(numbers) == 0)
    if len(twice):
        raise InputError(f"{shown(document.path)}: frame {numbers[twice[0]]} is there twice")
    return Frames(numbers, [contents[i] for i in by_number], header or {}, assumed)


def _frame_files(document: Document) -> tuple[list[tuple[int, Path]], tuple[str, ...]]:
    """Return a folder's JSON files with the frames' numbers, which are the last numbers in their names, and
    phrases about what was assumed. Where most have one, the others are left out; where most have none, all
    are counted from 1. Raises InputError for files of several sequences."""
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


def _counted(key: Any) -> int | None:
    """Return the number of the frame that a key counts, or whose picture it names; None where it does
    neither."""
    if _digits(key):
        return int(key)
    is_picture = isinstance(key, str) and key.lower().endswith(_PICTURES)
    return number_in({"frame": key.rpartition(".")[0]}) if is_picture else None


def number_in(content: Any) -> int | None:
    """Return the number of a frame that tells its own: of a text its last number, as in a picture's name;
    None where there is none."""
    of = keyed(content)
    for value in (of[key] for key in KEYS["frame"] if key in of):
        if isinstance(value, str) and (match := _last_number(value)):
            return int(match[0])
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        if abs(value) <= LARGEST_WHOLE and value == int(value):
            return int(value)
    return None


# Arrays


def points_among(arrays: Mapping[str, np.ndarray | None]) -> dict[str, np.ndarray]:
    """Return those of the arrays that may be hands' points, as (T, P, K, D): T frames of P hands or persons
    with K points of D numbers each."""
    return {name: laid for name, array in arrays.items() if (laid := _laid_out(array)) is not None}


def _laid_out(array: np.ndarray | None) -> np.ndarray | None:
    """Return an array as (T, P, K, D): frames, hands or persons, points, numbers; None for one that can be no
    points of hands."""
    counts = HANDS | set(WHOLE_BODIES)
    if array is None:
        return None
    if array.ndim == 2 and array.shape[0] in counts and array.shape[1] in (2, 3, 4):
        return array[None, None]
    if array.ndim == 2 and array.shape[1] in (2, 3) and array.size and len(array) % NUM_KEYPOINTS == 0:
        return array.reshape(-1, 1, NUM_KEYPOINTS, array.shape[1])
    if array.ndim == 2 and array.size:
        if len(array) > 1 and (np.diff(array[:, 0]) == 1.0).all():
            array = array[:, 1:]  # The first column counts frames.
        width = width_of(array.shape[1], (2, 3, 4))
        fits = width and array.shape[1] // width in counts
        return array.reshape(len(array), 1, -1, width) if fits else None
    if array.ndim == 3:
        array = array[:, None]
    fits = array.size and array.ndim == 4 and array.shape[2] in counts and array.shape[3] in (2, 3, 4)
    return array if fits and 0 < array.shape[1] < 20 else None


def frames_of_arrays(
    document: Document, arrays: Mapping[str, np.ndarray | None], first: int
) -> Frames | None:
    """Return the frames, counted from `first`, of arrays of points in a document; None where none are among
    them. Raises ValueError."""
    arrays = points_among(arrays)
    widest = max((array.shape[-1] for array in arrays.values()), default=0)
    arrays = {name: array for name, array in arrays.items() if array.shape[-1] == widest}
    if not arrays:
        return None
    if len(arrays) > 1 and not all(map(side_named, arrays)):
        raise ValueError(
            f"it has several arrays of points ({', '.join(arrays)[:200]}); save the right one as .npy, or "
            "both hands' as left and right"
        )
    count, people = next(iter(arrays.values())).shape[:2]
    if len({(len(array), array.shape[2]) for array in arrays.values()}) > 1:
        raise ValueError("its arrays have different numbers of frames, hands or points")
    LIMITS.check(document.path, count, people * 2)
    contents: list[Any] = [[] for _ in range(count)]
    for number, (name, array) in enumerate(arrays.items()):
        points = np.full((*array.shape[:3], 4), np.nan)
        points[..., :widest] = array
        x, third = (np.nan_to_num(points[..., axis]) for axis in (0, 2))
        if widest == 3 and third.min(initial=1.0) >= 0.0 and third.max(initial=0.0) <= 1.0 < x.max() / 10.0:
            points[..., 3], points[..., 2] = third, np.nan
        for frame, hands in zip(contents, points, strict=True):
            frame += [
                {"side": side_named(name), "handnumber": number * people + person, "points": hand}
                for person, hand in enumerate(hands)
            ]
    return in_order(document, range(first, first + count), contents)
