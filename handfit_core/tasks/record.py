"""NAME.json: what became of one input, written last; and the folders in which results come into being."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import platform
import shutil
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final, Self

from handfit_core.common.errors import OutputError
from handfit_core.common.files import part_of, read_file, shown, why, written_whole
from handfit_core.take import Take
from handfit_core.take.fit_quality import error_is_known, mean_expected_error, mean_relative_error

_LARGEST: Final = 16 << 20
FINAL: Final = ("InputError", "NoHandFoundError", "TakeError")
"""Kinds of errors that lie in an input: it is tried again only where somebody asks for it"""


@dataclass
class Result:
    """One entry of report.json, as docs/batch.md describes its fields."""

    input: str
    name: str
    status: str = "pending"
    """pending, ok or failed"""
    seconds: float = 0.0
    frames: int = 0
    hands: list[dict[str, Any]] = field(default_factory=list)
    views: dict[str, str] | None = None
    """The verdict on two views"""
    character: dict[str, Any] | None = None
    files: list[str] = field(default_factory=list)
    """relative to the report's folder"""
    warnings: list[str] = field(default_factory=list)
    error: str = ""
    id: str = ""
    """of the task"""
    host: str = ""
    """where it was done"""
    attempts: list[dict[str, Any]] = field(default_factory=list)
    """what went wrong before, or at last"""

    @classmethod
    def of_entry(cls, entry: Mapping[str, Any], **known: Any) -> Self:
        """From an entry of a record, with some fields as they are `known`."""
        found: dict[str, Any] = {each.name: entry.get(each.name) for each in fields(cls)}
        return cls(**found | known)

    def describe(self, take: Take) -> None:
        """Fill in `frames`, `views` and `hands`."""
        self.frames = len(take.frame_numbers)
        if take.verdict is not None:
            self.views = {**vars(take.verdict)}
            self.warnings += [] if take.verdict.agreement == "good" else [take.verdict.text]
        for track in take.hands:
            error = track.reprojection_error[track.detected]
            share, likely = mean_relative_error(track, take.intrinsics), mean_expected_error(track)
            self.hands.append(
                {
                    "side": track.side,
                    "detected": int(track.detected.sum()),
                    "doubtful": None if track.doubtful is None else int(track.doubtful.sum()),
                    "mean_reprojection_error_px": round(float(error.mean()), 3) if len(error) else None,
                    "mean_error_of_hand": None if share is None else round(share, 4),
                    "mean_expected_error": None if likely is None else round(likely, 5),
                    "error_known": error_is_known(track),
                }
            )

    def failed(self, attempts: Sequence[dict[str, Any]], warnings: Sequence[str]) -> Self:
        """The result after these attempts, of which the last one failed, too."""
        said = {"error": attempts[-1]["error"], "seconds": attempts[-1]["seconds"]}
        return replace(self, status="failed", attempts=[*attempts], warnings=[*warnings], **said)

    @property
    def is_final(self) -> bool:
        """Whether it failed for a reason that lies in its input."""
        return self.status == "failed" and bool(self.attempts) and self.attempts[-1]["kind"] in FINAL


def attempt(error: str, kind: str, seconds: float) -> dict[str, Any]:
    """An entry of `attempts`: what went wrong, where, when, after how long."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    said = {"error": error, "kind": kind, "host": platform.node()}
    return {**said, "seconds": round(seconds, 3), "at": now}


_NUMBER: Final = int | float
_HAND: Final = {"side": str, "detected": _NUMBER, "error_known": bool} | dict.fromkeys(
    ("doubtful", "mean_reprojection_error_px", "mean_error_of_hand", "mean_expected_error"), _NUMBER | None
)
_ATTEMPT: Final = {"error": str, "kind": str, "host": str, "seconds": _NUMBER}
_RECORD: Final[Mapping[str, Any]] = {
    "key": str,
    "run": str,
    "files": dict,
    "formats": dict,
    "result": {
        **dict.fromkeys(("input", "name", "status", "error", "id", "host"), str),
        **dict.fromkeys(("seconds", "frames"), _NUMBER),
        **{"files": [str], "warnings": [str], "hands": [_HAND], "attempts": [_ATTEMPT]},
        **dict.fromkeys(("views", "character"), dict | None),
    },
}
"""What records hold; a list has elements of one kind"""


def _fits(value: Any, kind: Any) -> bool:
    if isinstance(kind, list):
        return isinstance(value, list) and all(_fits(each, kind[0]) for each in value)
    if isinstance(kind, Mapping):
        return isinstance(value, dict) and all(
            name in value and _fits(value[name], k) for name, k in kind.items()
        )
    return isinstance(value, kind)


def read_record(path: Path) -> dict[str, Any] | None:
    """What a record says; None where there is none that can be understood."""
    try:
        # More digits no float could tell.
        record = json.loads(read_file(path, _LARGEST), parse_int=lambda digits: int(digits[:16]))
        json.dumps(record, allow_nan=False)
    except (OSError, ValueError, RecursionError):
        return None
    return record if _fits(record, _RECORD) else None


def write_record(
    path: Path,
    key: str,
    result: Result,
    files: Mapping[str, int],
    *,
    run: str = "",
    formats: Mapping[str, Sequence[str]] = {},
) -> None:
    """Write a record whole. `files` gives the bytes of each file beside it, `run` says which command did it,
    and `formats` which of the files are of which format. Raises OutputError."""
    record = {"key": key, "run": run, "result": vars(result), "files": files, "formats": formats}
    with written_whole(path) as beside:
        beside.write_text(json.dumps(record, indent=1) + "\n", encoding="ascii")


def missing_and_changed(folder: Path, record: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """The files of a record that are gone, and the ones that somebody has changed since."""
    missing, changed = [], []
    for name, size in record["files"].items():
        try:
            if (folder / Path(name).name).stat().st_size != size:
                changed.append(name)
        except (OSError, ValueError):
            missing.append(name)
    return missing, changed


def said_of_changed(names: Sequence[str]) -> str:
    """The warning about files that somebody has changed."""
    return f"{', '.join(names)}: changed since the batch wrote it, and left alone; --again makes all anew"


@contextlib.contextmanager
def results_folder(output: Path) -> Iterator[Path]:
    """A new folder in the folder of results, for what is not whole yet; it is removed at the end. Raises
    OutputError."""
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
    """Move all files of such a folder to their place, at once where there is nothing yet. Raises
    OutputError."""
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
