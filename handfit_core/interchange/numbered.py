"""Frames of JSON: a file a frame in a folder, or all in one file."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sized
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.doors.values import LARGEST_WHOLE
from handfit_core.errors import InputError
from handfit_core.files import shown
from handfit_core.interchange.document import Document
from handfit_core.interchange.settings import LIMITS
from handfit_core.skeleton import Side

_LAST_NUMBER: Final = re.compile(r"\d+(?!.*\d)")
_LISTS: Final = ("frames", "results", "data", "predictions", "detections", "annotations", "instanceinfo")


def check_count(document: Document, frames: Sized) -> None:
    """Raises InputError for more than `LIMITS.frames` frames."""
    if len(frames) > LIMITS.frames:
        raise InputError(
            f"{shown(document.path)}: it has {len(frames)} frames, and at most {LIMITS.frames} are read; cut "
            "it into parts"
        )


def told_twice(twice: Mapping[Side, int]) -> list[str]:
    """Phrases for the frames in which a hand of a side came after another one of it, and was left out."""
    return [
        f"{count} {'frame has' if count == 1 else 'frames have'} several {side} hands: the first was taken"
        for side, count in twice.items()
    ]


def plain(key: str) -> str:
    """A JSON key without its case and the signs between its words."""
    return re.sub(r"[^a-z0-9]", "", key.lower())


def keyed(content: Any) -> dict[str, Any]:
    """An object's values by their plain keys; nothing for anything else."""
    return {plain(key): value for key, value in content.items()} if isinstance(content, Mapping) else {}


@dataclass(frozen=True, eq=False)
class JsonFrames:
    """T frames of a document, in order."""

    numbers: np.ndarray
    """(T,) int, increasing"""
    contents: list[Any]
    """(T) what the JSON has for each"""
    header: dict[str, Any]
    """What stands beside the frames, by plain keys"""
    assumed: tuple[str, ...] = ()


def frame_files(document: Document) -> tuple[list[tuple[int, Path]], tuple[str, ...]]:
    """The JSON files of a folder with the frames' numbers, which are the last numbers in their names, and
    what was assumed. Where most have one, the others are left out; where most have none, all are counted from
    1. Raises InputError for files of several sequences."""
    files = document.files(".json")
    numbered = [(match, file) for file in files if (match := _number_of(file))]
    assumed: tuple[str, ...] = ()
    if others := [file for file in files if not _number_of(file)]:
        which = f"{shown(others[0].name)} has no number in its name"
        if len(others) > 1:
            which = f"{shown(others[0].name)} and {len(others) - 1} more have no number in their names"
        if len(others) >= len(numbered):
            said = f"{which}: frames are counted from 1, by the names"
            return list(enumerate(files, 1)), (said,) if len(files) > 1 else ()
        assumed = (f"{which}: left out",)
    around = {(file.stem[: match.start()], file.stem[match.end() :]) for match, file in numbered}
    if len(around) > 1:
        raise InputError(f"{shown(document.path)}: {several_clips(around)}; give each its own folder")
    return sorted((int(match[0]), file) for match, file in numbered), assumed


def _number_of(file: Path) -> re.Match[str] | None:
    """The last number in its name."""
    match = _LAST_NUMBER.search(file.stem)
    return match if match and len(match[0]) <= LIMITS.number_digits else None


def several_clips(around: Collection[tuple[str, ...]]) -> str:
    """What is wrong with names that differ in more than their numbers, by what stands around these."""
    first, second = ("..".join(each) for each in sorted(around)[:2])
    return f"its frames belong to several clips ({first} and {second}, for example)"


def first_content(document: Document) -> Any:
    """What a document's JSON is, or that of a folder's first JSON file, of those with a number if there are
    any; None without one."""
    if not document.is_folder:
        return document.json if document.json is not None else document.lines
    files = document.files(".json")
    return Document(min(files, key=lambda file: not _number_of(file))).json if files else None


def some_contents(document: Document) -> Iterator[Any]:
    """A document's JSON, or that of a folder's first files, as those of frames without anybody say little."""
    if not document.is_folder:
        yield first_content(document)
    else:
        for file in document.files(".json")[: LIMITS.looked_at]:
            yield Document(file).json


def frames_of(document: Document) -> JsonFrames:
    """The frames of a folder of JSON files, of a list, of an object with a list or with frames by their
    numbers, or of a single frame. Raises InputError."""
    if document.is_folder:
        files, assumed = frame_files(document)
        contents = []
        for _, file in files:
            content = Document(file).json
            if content is None:
                raise InputError(f"{shown(file)}: this file of the sequence is no JSON, or a damaged one")
            contents.append(content)
        numbers = np.array([number for number, _ in files])
        return _in_order(document, numbers, contents, {}, assumed)
    content = first_content(document)
    header = keyed(content)
    if isinstance(content, Mapping):
        listed = next((header[key] for key in _LISTS if isinstance(header.get(key), list | dict)), None)
        if listed is not None:
            content = listed
            header = {key: value for key, value in header.items() if not isinstance(value, list | dict)}
    if isinstance(content, Mapping) and content and all(_digits(key) for key in content):
        numbers = np.array([int(key) for key in content])
        return _in_order(document, numbers, list(content.values()), header, ())
    if isinstance(content, Mapping):
        match = _LAST_NUMBER.search(document.path.stem)
        number = int(match[0]) if match and len(match[0]) <= LIMITS.number_digits else 1
        return _in_order(document, np.array([_number_in(content) or number]), [content], header, ())
    if not isinstance(content, list) or not content:
        raise InputError(f"{shown(document.path)}: there is no frame in it")
    told = [_number_in(each) for each in content]
    if any(number is None for number in told):
        assumed = ("its frames have no numbers: they are counted from 1",) if len(content) > 1 else ()
        return _in_order(document, np.arange(1, len(content) + 1), content, header, assumed)
    return _in_order(document, np.array(told), content, header, ())


def _in_order(
    document: Document,
    numbers: np.ndarray,
    contents: list[Any],
    header: dict[str, Any],
    assumed: tuple[str, ...],
) -> JsonFrames:
    """Frames by their numbers. Raises InputError where one comes twice."""
    order = np.argsort(numbers, kind="stable")
    numbers = numbers[order]
    twice = np.flatnonzero(np.diff(numbers) == 0)
    if len(twice):
        raise InputError(f"{shown(document.path)}: frame {numbers[twice[0]]} is there twice")
    return JsonFrames(numbers, [contents[i] for i in order], header, assumed)


def size_in(header: Mapping[str, Any], before: str = "") -> tuple[int, int] | None:
    """The pictures' size as plain keys tell it; None where they do not."""
    width, height = header.get(f"{before}width"), header.get(f"{before}height")
    if type(width) is int and type(height) is int and 0 < width < 1 << 24 and 0 < height < 1 << 24:
        return width, height
    return None


def _digits(key: Any) -> bool:
    return isinstance(key, str) and key.isascii() and key.isdigit() and len(key) <= LIMITS.number_digits


def _number_in(content: Any) -> int | None:
    """The number of a frame that tells its own; a text's last number, as of a picture's name."""
    of = keyed(content)
    for key in ("frame", "frameid", "framenumber", "frameindex", "frameidx", "frameno", "imageid"):
        value = of.get(key)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, int) and not isinstance(value, bool) and abs(value) <= LARGEST_WHOLE:
            return value
        if (
            isinstance(value, str)
            and (match := _LAST_NUMBER.search(value[:300]))
            and len(match[0]) <= LIMITS.number_digits
        ):
            return int(match[0])
    return None
