"""The record of what became of one input, NAME.json, written last; and the folders in which results come into
being."""
# ruff: noqa: RUF009 (what a dataclass's default calls here makes a field)

from __future__ import annotations

import contextlib
import datetime
import json
import os
import platform
import shutil
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

from handfit_core.common.arrays import object_of, value
from handfit_core.common.errors import HandfitError, OutputError
from handfit_core.common.files import part_of, read_file, shown, why, written_whole
from handfit_core.common.values import any_text, dict_of, flag, list_of, number, one_of, or_none, whole
from handfit_core.take import Take
from handfit_core.take.fit_quality import error_is_known, mean_expected_error, mean_relative_error

_LARGEST: Final = 16 << 20
FINAL: Final = ("InputError", "NoHandFoundError", "TakeError")
"""Kinds of errors that lie in an input: it is tried again only where somebody asks for it"""


@dataclass
class Hand:
    """A hand of a result; docs/batch.md describes its fields."""

    side: str = value(any_text)
    detected: int = value(whole)
    error_known: bool = value(flag)
    doubtful: int | None = value(or_none(whole), None)
    mean_reprojection_error_px: float | None = value(or_none(number), None)
    mean_error_of_hand: float | None = value(or_none(number), None)
    mean_expected_error: float | None = value(or_none(number), None)


@dataclass
class Attempt:
    """A try that went wrong: what it ended in, where, after how many seconds, and when."""

    error: str = value(any_text)
    kind: str = value(any_text)
    """The name of the error's class"""
    host: str = value(any_text)
    seconds: float = value(number)
    at: str = value(any_text, "")

    @classmethod
    def now(cls, error: str, kind: str, seconds: float = 0.0) -> Self:
        """Make an attempt that has ended at this moment on this machine, after so many seconds."""
        at = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        return cls(error, kind, platform.node(), round(seconds, 3), at)


@dataclass
class Result:
    """One entry of report.json, as docs/batch.md describes its fields."""

    input: str = value(any_text)
    name: str = value(any_text)
    status: str = value(one_of("pending", "ok", "failed"), "pending")
    seconds: float = value(number, 0.0)
    frames: int = value(whole, 0)
    hands: list[Hand] = value(list_of(object_of(Hand)), list)
    views: dict[str, str] | None = value(or_none(dict_of(any_text)), None)
    """The verdict on two views, as the take has it; None where there is only one"""
    character: dict[str, Any] | None = value(or_none(dict_of(lambda _name, held: held)), None)
    files: list[str] = value(list_of(any_text), list)
    """The result's files, relative to the report's folder"""
    warnings: list[str] = value(list_of(any_text), list)
    error: str = value(any_text, "")
    id: str = value(any_text, "")
    """The key of the task"""
    host: str = value(any_text, "")
    """The name of the machine on which the task was done"""
    attempts: list[Attempt] = value(list_of(object_of(Attempt)), list)
    """The tries that went wrong before, or at last"""

    def describe(self, take: Take) -> None:
        """Fill in `frames`, `views` and `hands` from a take."""
        self.frames = len(take.frame_numbers)
        if take.verdict is not None:
            self.views = {**vars(take.verdict)}
            self.warnings += [] if take.verdict.agreement == "good" else [take.verdict.text]
        for track in take.hands:
            error = track.reprojection_error[track.detected]
            share, likely = mean_relative_error(track, take.intrinsics), mean_expected_error(track)
            self.hands.append(
                Hand(
                    track.side,
                    int(track.detected.sum()),
                    error_is_known(track),
                    None if track.doubtful is None else int(track.doubtful.sum()),
                    round(float(error.mean()), 3) if len(error) else None,
                    None if share is None else round(share, 4),
                    None if likely is None else round(likely, 5),
                )
            )

    def failed(self, attempts: Sequence[Attempt], warnings: Sequence[str]) -> Self:
        """Return the result after these attempts, of which the last one failed, too."""
        said = {"error": attempts[-1].error, "seconds": attempts[-1].seconds}
        return replace(self, status="failed", attempts=[*attempts], warnings=[*warnings], **said)

    @property
    def is_final(self) -> bool:
        """True if it failed for a reason that lies in its input."""
        return self.status == "failed" and bool(self.attempts) and self.attempts[-1].kind in FINAL


@dataclass
class Record:
    """What became of one input, or what was made of its take, with the key that says by which options."""

    key: str = value(any_text)
    result: Result = value(object_of(Result))
    files: dict[str, int] = value(dict_of(whole), dict)
    """For each file beside the record, its size in bytes"""
    formats: dict[str, list[str]] = value(dict_of(list_of(any_text)), dict)
    """For each format, the names of its files"""
    run: str = value(any_text, "")
    """A text that stands for the command that made the record"""

    @classmethod
    def read(cls, path: Path) -> Self | None:
        """Read a record from a file; None where there is none that can be understood."""
        try:
            content = json.loads(read_file(path, _LARGEST))
            json.dumps(content, allow_nan=False)
            return object_of(cls)("record", content)
        except (OSError, ValueError, RecursionError, HandfitError):
            return None

    def write(self, path: Path) -> None:
        """Write the record into a file, whole or not at all. Raises OutputError."""
        with written_whole(path) as beside:
            beside.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="ascii")

    def missing_and_changed(self, folder: Path) -> tuple[list[str], list[str]]:
        """Return the files that are gone from their folder, and the ones that somebody has changed since."""
        missing, changed = [], []
        for name, size in self.files.items():
            try:
                if (folder / Path(name).name).stat().st_size != size:
                    changed.append(name)
            except (OSError, ValueError):
                missing.append(name)
        return missing, changed


def said_of_changed(names: Sequence[str]) -> str:
    """Return the warning about files that somebody has changed."""
    return f"{', '.join(names)}: changed since the batch wrote it, and left alone; --again makes all anew"


@contextlib.contextmanager
def results_folder(output: Path) -> Iterator[Path]:
    """Make a new folder in the folder of results, for files that are not whole yet; it is removed at the end.
    Raises OutputError."""
    path = output / f"{part_of(os.getpid())}{uuid.uuid4().hex[:8]}"
    try:
        path.mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"{shown(output)}: cannot write here ({why(error)})") from error
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)


def move_results(part: Path, folder: Path) -> None:
    """Move all files of a folder of `results_folder` to their place, at once where there is nothing yet.
    Raises OutputError."""
    try:
        if not folder.exists():
            with contextlib.suppress(OSError):
                part.rename(folder)
                return
        folder.mkdir(exist_ok=True)
        for file in sorted(part.iterdir(), key=lambda file: file.suffix == ".json"):  # the record comes last
            file.replace(folder / file.name)
    except OSError as error:
        raise OutputError(f"{shown(folder)}: could not be written ({why(error)})") from error


def remove_abandoned(folder: Path) -> None:
    """Take away the unfinished results of processes of this machine that were killed."""
    with contextlib.suppress(OSError):
        for path in folder.glob(f"{part_of('*')}*"):
            pid = path.name.removeprefix(part_of("").removesuffix("-")).partition("-")[0]
            if pid.isdecimal() and not _lives(int(pid)):
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)


def _lives(pid: int) -> bool:
    if os.name == "nt":  # where asking a process so would end it
        return True
    with contextlib.suppress(OSError):
        # One that has ended lives on as a zombie until it is asked for, in containers often never.
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True
