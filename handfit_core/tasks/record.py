"""NAME.json: what became of one input, written last; and the folders in which results come into being."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import shutil
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from handfit_core.errors import OutputError
from handfit_core.files import PART, read_file, shown, why, written_whole
from handfit_core.version import __version__

_LARGEST: Final = 16 << 20
_KINDS: Final = {"key": str, "status": str, "result": dict, "files": dict}


def read_record(path: Path) -> dict[str, Any] | None:
    """What a record says; None where there is none that can be understood."""
    try:
        record = json.loads(read_file(path, _LARGEST), parse_int=_whole)
        json.dumps(record, allow_nan=False)
    except (OSError, ValueError, RecursionError):
        return None
    fits = isinstance(record, dict) and all(isinstance(record.get(n), kind) for n, kind in _KINDS.items())
    return record if fits else None


def _whole(digits: str) -> int:
    """A whole number, as far as floats can tell it from others."""
    if len(digits) > 16:
        raise ValueError(f"{digits[:16]}... is too large")
    return int(digits)


def write_record(
    path: Path, key: str, result: Mapping[str, Any], files: Mapping[str, int], run: str = ""
) -> None:
    """Write a record whole. `result` is the input's entry of report.json, `files` gives the bytes of each
    file beside the record, and `run` says which command did it. Raises OutputError."""
    status = "done" if result["status"] == "ok" else "failed"
    record = {"key": key, "status": status, "result": dict(result), "files": dict(files)}
    record |= {"versions": {"manient": __version__}, "seconds": result["seconds"], "run": run}
    with written_whole(path) as beside:
        beside.write_text(json.dumps(record, indent=1) + "\n", encoding="ascii")


def missing_and_changed(folder: Path, record: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """The files of a record that are gone, and the ones that somebody has changed since."""
    missing, changed = [], []
    for name, size in record["files"].items():
        try:
            found = (folder / Path(name).name).stat().st_size
        except (OSError, ValueError):
            missing.append(name)
        else:
            if found != size:
                changed.append(name)
    return missing, changed


@contextlib.contextmanager
def results_folder(output: Path) -> Iterator[Path]:
    """A new folder in the folder of results, for what is not whole yet; it is removed at the end. Raises
    OutputError."""
    path = output / f"{_begin()}{os.getpid()}-{uuid.uuid4().hex[:8]}"
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


def remove_abandoned(output: Path) -> None:
    """Take away the unfinished results of processes of this machine that were killed."""
    with contextlib.suppress(OSError):
        for path in output.glob(f"{_begin()}*"):
            pid = path.name.removeprefix(_begin()).partition("-")[0]
            if pid.isdecimal() and not _lives(int(pid)):
                shutil.rmtree(path, ignore_errors=True)


def _begin() -> str:
    return f"{PART}{platform.node()[:40]}-"


def _lives(pid: int) -> bool:
    if os.name == "nt":  # where asking a process so would end it
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True
