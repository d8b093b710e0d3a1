"""The tasks of a batch: for each input the name of its results, and the key that says what they are."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path
from typing import Final

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.files import is_file, is_folder, read_file, samples
from handfit_core.common.version import __version__
from handfit_core.detect.landmark_model import TASK
from handfit_core.hand_model.files import files_of_model
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import PHOTO_SUFFIXES, is_pattern, matching
from handfit_core.take.sheet import SUFFIX
from handfit_core.tasks.inputs import PAIRS, Input, expand, paired
from handfit_core.tasks.record import Record

TAKE_SUFFIX: Final = ".take.npz"
_READ_WHOLE: Final = 4 << 20
"""Bytes that an input's files may have together for their contents to be compared. Of larger ones names,
sizes, times and samples are: to read a thousand clips costs hours"""
_READ_NAMED: Final = 64 << 20
"""Bytes of each file that the options name, such as a hand model, that are compared whole"""
_MOST_FILES: Final = 100_000
"""Files of a folder and its folders that are looked at"""
_BYTES_OF_FRAME: Final = 15_000
"""Bytes of a video's frame, roughly"""


@dataclass(frozen=True)
class Task:
    """One input, and what its results are called."""

    name: str
    key: str
    """A text that changes with the options, the version and what the input's files hold"""
    shown: str
    """The input as people are shown it"""
    source: tuple[str, ...] = ()
    """The paths of what to capture, in full, or a pattern"""
    view: str = ""
    """The full path of the second view in a batch of `PAIRS`; else empty"""
    take: str = ""
    """The path of the take that is the input: it is copied, and nothing is captured; else empty"""
    error: str = ""
    """The reason why the input cannot even be tried; else empty"""
    made_of: str = ""
    """The `fingerprint` of the input's files"""
    frames: float = 0.0
    """How many frames it may have, by its files' sizes: long inputs are begun first"""
    flat: bool = False
    """True if the results of all tasks lie in one folder"""

    def folder(self, output: Path) -> Path:
        """Return the folder in which the task's results lie, within the folder of all results."""
        return output if self.flat else output / self.name

    def record(self, output: Path) -> Path:
        """Return the path of the file that is written last, and says what became of the input."""
        return self.folder(output) / f"{self.name}.json"

    def take_path(self, output: Path) -> Path:
        """Return the path of the take, also where it is a copy of the input."""
        return self.folder(output) / f"{self.name}{TAKE_SUFFIX}"

    def sheet(self, output: Path) -> Path:
        """Return the path of the contact sheet."""
        return self.folder(output) / f"{self.name}{SUFFIX}"

    @property
    def files(self) -> list[Path]:
        """The files that the input has now."""
        return [Path(self.take)] if self.take else _files_of(self.source, self.view)


def make_tasks(
    inputs: Iterable[str],
    options: CaptureOptions,
    output: Path,
    *,
    grouping: str | None = None,
    sheet: bool = True,
    flat: bool = False,
    overwrite: bool = False,
) -> list[Task]:
    """Make the tasks of what a user names, in its order. `grouping` is as in `expand`; `sheet`: whether
    contact sheets are wanted.

    An input's own name is its results' name, unless that is taken: by another input, or by results of other
    tasks in `output`, which `overwrite` replaces. Then it gets -2, -3, ..., upper and lower case being equal.
    """
    wanted = {name: value for name, value in options.to_message().items() if name != "processes"}
    named = [fingerprint(_files_at(file), _READ_NAMED) for file in _files_named(options)]
    common = [__version__, wanted, sheet, named]
    names, keys, tasks = _Names(output, flat, overwrite), set[str](), list[Task]()
    expanded = [each for text in inputs for each in expand(text, grouping)]
    for each in paired(expanded) if options.view == PAIRS else expanded:
        files = [each.take] if each.take else _files_of(each.source, each.view)
        made_of = fingerprint(files)
        key = _key(common, each, made_of, files, keys)
        keys.add(key)
        name = names.free(each.name if each.name not in ("", ".", "..") else "input", key)
        source = tuple(str(Path(part).absolute()) for part in each.source)
        view = str(Path(each.view).absolute()) if each.view else ""
        take = str(each.take.absolute()) if each.take else ""
        frames = 0.0 if take else _frames(files, options.frames or FrameRange())
        tasks.append(Task(name, key, each.shown, source, view, take, each.error, made_of, frames, flat))
    return tasks


def _key(common: list, each: Input, made_of: str, files: Sequence[Path], keys: set[str]) -> str:
    """Return the key of an input's results; where the same input comes a second time it gets another one."""
    what = [*common, each.name, made_of, bool(each.take), each.error, "" if files else each.shown]
    texts = (json.dumps([*what, again], sort_keys=True) for again in count())
    found = (hashlib.sha256(text.encode()).hexdigest()[:16] for text in texts)
    return next(key for key in found if key not in keys)


class _Names:
    """The names that results can still be given."""

    def __init__(self, output: Path, flat: bool, overwrite: bool) -> None:
        self._output, self._flat, self._overwrite = output, flat, overwrite
        self._there = {path.name.lower(): path.name for path in output.iterdir()} if output.is_dir() else {}
        self._taken = {"report"} if flat else {"report.json", "overview.html"}
        self._first: dict[str, int] = {}
        """For each name, the lowest number that may be free"""

    def free(self, name: str, key: str) -> str:
        """Return the name, or the first of those with numbers, that is free for the task of that key."""
        for number in count(self._first.get(name.lower(), 1)):
            found = name if number == 1 else f"{name}-{number}"
            if found.lower() in self._taken:
                self._first[name.lower()] = number + 1
            elif self._is_free(found, key):
                self._taken.add(found.lower())
                return found
        raise AssertionError

    def _is_free(self, name: str, key: str) -> bool:
        if self._flat:  # the record of x.export would be what tells of the exports of x
            return not name.lower().endswith(".export")
        there = self._there.get(name.lower())
        if there is None or self._overwrite:
            return True
        folder = self._output / there
        record = Record.read(folder / f"{name}.json") if there == name else None
        if record is not None:
            return record.key == key or not record.files
        return there == name and folder.is_dir() and not any(folder.iterdir())


def _files_named(options: CaptureOptions) -> list[Path]:
    """Return the files, and folders with keypoints, that the options of a capture name or their defaults
    mean."""
    found = [*files_of_model(Path(options.model).expanduser())] if options.model else []
    found += [Path(options.landmark_model or os.environ.get(TASK.variable) or "").expanduser()]
    named = [path for path in found if is_file(path)]
    told = (options.keypoints, options.view, options.cameras)
    named += [path for path in (Path(each).expanduser() for each in told if each) if path.exists()]
    return named


def _files_of(source: Sequence[str], view: str = "") -> list[Path]:
    """Return the files of an input: of a pattern, those that match it now."""
    (first, *_) = source or ("",)
    if view:
        return [Path(first), Path(view)]
    if len(source) == 1 and is_pattern(first) and not Path(first).exists():
        return matching(Path(first))[0]
    return _files_at(first) if len(source) == 1 else [Path(part) for part in source]


def _files_at(path: str | Path) -> list[Path]:
    """Return a file, or what lies in another program's folder and its folders, in the same order on any disk;
    links to folders are not followed."""
    if not is_folder(path):
        return [Path(path)]
    below = (Path(where, name) for where, _, names in os.walk(path) for name in names)
    return sorted(islice(filter(is_file, below), _MOST_FILES))


def fingerprint(files: Sequence[Path], read_whole: int = _READ_WHOLE) -> str:
    """What files hold, in short: the same for the same, and another once one of them has changed, as far as
    that can be told without reading those that have more than `read_whole` bytes together."""
    found = [(file.name, *_size_and_time(file)) for file in files]
    digest = hashlib.sha256()
    if sum(size for _, size, _ in found) <= read_whole and all(size >= 0 for _, size, _ in found):
        for file in files:
            try:
                digest.update(read_file(file, read_whole))
            except (OSError, ValueError) as error:
                digest.update(str(error).encode("utf-8", "replace"))
        found = [(name, size, 0) for name, size, _ in found]
    else:
        with contextlib.suppress(OSError):
            for sample in samples(files, [size for _, size, _ in found]):
                digest.update(sample)
    digest.update(json.dumps(found).encode())
    return digest.hexdigest()[:32]


def _size_and_time(file: Path) -> tuple[int, int]:
    """Return a file's bytes and its time in milliseconds, which all file systems can hold; -1, 0 where there
    is no such file."""
    try:
        found = file.stat()
    except (OSError, ValueError):
        return -1, 0
    return found.st_size, found.st_mtime_ns // 1_000_000


def _frames(files: Sequence[Path], wanted: FrameRange) -> float:
    """Estimate how many frames of some files may be wanted; those of videos by the files' sizes."""
    there = 0.0
    for file in files:
        claimed = 1
        if file.suffix.lower() not in PHOTO_SUFFIXES:
            claimed = _size_and_time(file)[0] / _BYTES_OF_FRAME
        there += max(claimed, 0)
    return len(wanted.within(1, round(there))) or there
