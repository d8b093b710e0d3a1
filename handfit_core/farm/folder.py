"""The folder of one task: its results, the seal that says they are whole, and who is at it.

    done.json       written last, once every result is in its place: what is sealed is never done again
    failed.json     every attempt that failed, and what of the results is there all the same
    running.json    whose turn it is: made by one alone, and touched every few seconds while he lives

Results come into being in a part folder beside it, as deep as the folder itself so that relative paths in
them stay right, and are moved file by file. Nothing here relies on clocks of different machines agreeing,
nor on locks, which network disks have or have not.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import hashlib
import json
import os
import platform
import shutil
import time
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePath
from typing import Any, Final

from handfit_core.errors import HandfitError, OutputError
from handfit_core.files import PART, flush, is_file, read_file, shown, why
from handfit_core.version import __version__

BEAT: Final = 10.0
"""seconds between two signs of life"""
STALE: Final = 60.0
"""seconds without one, on the clock of who looks, after which a task is anybody's again"""

_FORMAT: Final = "manient-task"
_VERSION: Final = 1
_LARGEST: Final = 16 << 20
_CHUNK: Final = 1 << 20
_NO_LINKS: Final = {errno.EPERM, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL, errno.EMLINK}
_REFUSED: Final = {errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG}

Files = Mapping[str, Mapping[str, Any]]
"""Names relative to the task's folder, each with its `size` in bytes and `sha256`"""


class Lost(HandfitError):
    """Somebody else has taken a task over, or the folder of results is gone."""


_held: set[str] = set()
"""Tokens of the claims of this process; nobody is at what has another one, though it comes from here"""


class TaskFolder:
    """Where the results of the task called `name` go: a folder of its own, or `flat` the common one."""

    def __init__(self, output: Path, name: str, flat: bool = False) -> None:
        self.output, self.name, self.flat = output, name, flat
        self.path = output if flat else output / name
        before = f"{name}." if flat else ""
        self.done, self.failed, self.running = (
            self.path / f"{before}{what}.json" for what in ("done", "failed", "running")
        )

    def relative(self, file: str) -> str:
        """A result's name relative to the folder of all results."""
        return file if self.flat else f"{self.name}/{file}"

    def sealed(self, id: str) -> dict[str, Any] | None:
        """The seal of that task, where all that it names is there; None: it is still to be done.

        A result that somebody has changed since is his work by now: then the task is done, whatever else is
        missing, and a warning of its result says so.
        """
        seal = self._known(self.done, id)
        if seal is None:
            return None
        result = seal["result"] = {**seal["result"], "status": "ok"}
        missing, changed = [], []
        try:
            for name, known in seal["files"].items():
                try:
                    if (self.path / name).stat().st_size != known["size"]:
                        changed.append(name)
                except FileNotFoundError:
                    missing.append(name)
            if changed:
                said = f"{', '.join(changed)}: changed since the batch wrote it, and left alone"
                said += f"; {', '.join(missing)}: gone" if missing else ""
                before = result.get("warnings")
                warnings = [*(before if isinstance(before, list) else []), f"{said}; --again makes all anew"]
                result["warnings"] = warnings
                return seal
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None
        return None if missing else seal

    def failures(self, id: str) -> dict[str, Any] | None:
        """What is known of a task that failed: its `result`, and the `files` that are there all the same."""
        known = self._known(self.failed, id)
        return known if known and known["result"].get("status") in ("failed", "pending") else None

    def _known(self, file: Path, id: str) -> dict[str, Any] | None:
        """What a file says of that task, whose `result` has this task's name whatever is written there."""
        known = _read(file)
        if known is None or known.get("id") != id or not isinstance(known.get("files"), dict):
            return None
        if not isinstance(known.get("result"), dict) or not all(lies_within(name) for name in known["files"]):
            return None
        return {**known, "result": {**known["result"], "name": self.name, "id": id}}

    def kept(self, id: str) -> dict[str, Path]:
        """The results that a failed attempt at that task has left, as they were then, by their names."""
        found = {}
        for name, known in (self.failures(id) or {}).get("files", {}).items():
            with contextlib.suppress(OSError, ValueError, TypeError):
                # One of another size need not be read, nor waited for what is no file.
                same = is_file(path := self.path / name) and path.stat().st_size == known["size"]
                if same and files_in(self.path, [name])[name] == known:
                    found[name] = path
        return found

    def holds(self, id: str) -> bool:
        """Whether what lies here is that task's: done, failed, or begun."""
        return any((_read(f) or {}).get("id") == id for f in (self.done, self.failed, self.running))

    @property
    def worked_on(self) -> str:
        """The host of who seems to be at the task: the sign is there, and not of a process that has gone.
        Empty where nobody is."""
        sign = _read(self.running)
        return "" if sign is None or _lives(sign) is False else str(sign.get("host") or "another host")

    @property
    def owner(self) -> str | None:
        """The id of the task whose results lie here, empty where nobody knows whose they are. None: other
        results may go here, since there is nothing, or what tells of a failure."""
        for file in (self.done, self.failed, self.running):
            if (known := _read(file)) is None:
                continue
            taken = {
                self.done: True,
                self.failed: known.get("files"),
                self.running: _lives(known) is not False,
            }
            return str(known.get("id", "")) if taken[file] else None
        try:
            return "" if any(self.path.iterdir()) else None
        except FileNotFoundError:
            return None
        except OSError:
            return ""

    # Results

    def part(self) -> Path:
        """A new folder for results that are not whole yet; with `flat` the common one, whose files are each
        written beside their place, so that an older seal does not hold any more. Raises OutputError."""
        if self.flat:
            self._unseal()
            return self.path
        path = self.beside()
        try:
            path.mkdir()
        except OSError as error:
            raise _not_written(path, error) from error
        return path

    @property
    def parts(self) -> str:
        """What its parts' names begin with; the task's own name may be too long, and begin another's."""
        return f"{PART}{hashlib.sha256(os.fsencode(self.name)).hexdigest()[:10]}-"

    def beside(self) -> Path:
        """A new name for something that is not whole yet."""
        return self.output / f"{self.parts}{platform.node()[:40]}-{os.getpid()}-{uuid.uuid4().hex[:8]}"

    def remove_parts(self) -> None:
        """Take away what those left behind who ended in the middle; nobody else may be at the task."""
        for name in parts_in(self.output):
            if name.startswith(self.parts):
                path = self.output / name
                shutil.rmtree(path, ignore_errors=True) if path.is_dir() else _remove(path)

    def take_in(self, part: Path, files: Files) -> None:
        """Move results from their part folder into their place, where no seal is any more. Raises
        OutputError, before anything is touched where one of them is not as long as it was."""
        try:
            to_move = [name for name in files if part != self.path and (part / name).exists()]
            for name, known in files.items():
                if name in to_move or part == self.path:
                    same = (part / name).stat().st_size == known["size"]
                else:  # an earlier call has moved it, before something went wrong
                    same = files_in(self.path, [name])[name] == known
                if not same:
                    raise OutputError(f"{shown(part / name)}: has changed since it was written; try again")
            self._make()
            self._unseal()
            for name in to_move:
                place = self.path / name
                place.parent.mkdir(exist_ok=True)
                (part / name).replace(place)
            _flush_folder(self.path)
        except OSError as error:
            raise _not_written(self.path, error) from error

    def seal(self, id: str, result: Mapping[str, Any], files: Files, seconds: float) -> None:
        """Say that the task is done. Raises OutputError."""
        seal = {"result": dict(result), "files": dict(files), "versions": {"manient": __version__}}
        self._write(self.done, id, **seal, host=platform.node(), seconds=round(seconds, 3))
        _remove(self.failed)

    def _unseal(self) -> None:
        try:
            self.done.unlink(missing_ok=True)
        except OSError as error:
            raise _not_written(self.done, error) from error

    def discard(self, id: str) -> None:
        """Remove the results of a task that nobody needs any more, and what tells of it."""
        for file in (self.done, self.failed):
            if (known := self._known(file, id)) is not None:
                for path in (*(self.path / name for name in known["files"]), file):
                    if path.parent.resolve().is_relative_to(self.path.resolve()):
                        _remove(path)
        if not self.flat:
            with contextlib.suppress(OSError):
                self.path.rmdir()

    def fail(self, id: str, result: Mapping[str, Any], files: Files) -> None:
        """Tell of a task that failed. Raises OutputError."""
        self._make()
        self._write(self.failed, id, result=dict(result), files=dict(files))

    def _write(self, path: Path, id: str, **content: Any) -> None:
        try:
            aside = self.aside(json.dumps(_content(id, **content), indent=1) + "\n")
            try:
                flush(aside)
                aside.replace(path)
            finally:
                _remove(aside)
        except OSError as error:
            raise _not_written(path, error) from error

    def aside(self, text: str) -> Path:
        """A new file with this text, to take its place at once; what is left of it is taken away with the
        parts. Raises OSError."""
        path = self.beside()
        try:
            path.write_text(text, encoding="ascii")
        except OSError:
            _remove(path)
            raise
        return path

    def _make(self) -> None:
        try:
            self.path.mkdir(exist_ok=True)
        except OSError as error:
            raise _not_written(self.path, error) from error


def kind_of(error: Exception) -> str:
    """What kind of error it is, for `attempt`: a folder that must not be written is no disk that is full."""
    cause = error.__cause__
    refused = isinstance(error, OutputError) and isinstance(cause, OSError) and cause.errno in _REFUSED
    return "OutputRefused" if refused else type(error).__name__


def attempt(error: str, kind: str, seconds: float) -> dict[str, Any]:
    """An entry of `attempts`: what went wrong, where, when, after how long."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {
        "error": error,
        "kind": kind,
        "host": platform.node(),
        "seconds": round(seconds, 3),
        "at": now,
    }


def parts_in(output: Path) -> list[str]:
    """The names of what is not whole yet, or was left behind."""
    with contextlib.suppress(OSError), os.scandir(output) as entries:
        return [entry.name for entry in entries if entry.name.startswith(PART)]
    return []


def lies_within(name: str) -> bool:
    """Whether a result's name leads nowhere but below the folder of its task; others may write what it
    says."""
    path = PurePath(name)
    return not path.anchor and ".." not in path.parts and "\0" not in name


def files_in(part: Path, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The sizes and hashes of files. Raises OSError."""
    found = {}
    for name in names:
        digest = hashlib.sha256()
        with (part / name).open("rb") as stream:
            while block := stream.read(_CHUNK):
                digest.update(block)
        found[name] = {"size": (part / name).stat().st_size, "sha256": digest.hexdigest()}
    return found


@dataclass
class _Sign:
    """What running.json looked like when it last changed."""

    looks: tuple[str, int]
    since: float


class Watch:
    """Who is at which tasks, as far as this process has seen."""

    def __init__(self) -> None:
        self._signs: dict[Path, _Sign] = {}

    def claim(self, folder: TaskFolder, id: str) -> Claim | None:
        """Take a task; None where somebody is at it. Raises OutputError."""
        try:
            for _ in range(3):  # again where another one was quicker, or the folder went with its last claim
                folder._make()
                with contextlib.suppress(FileNotFoundError):
                    looks = self._looks_of_a_dead(folder)
                    if looks is None:
                        return None
                    if (claim := _created(folder, id, looks)) is not None:
                        self._signs.pop(folder.running, None)
                        return claim
        except OSError as error:
            raise _not_written(folder.running, error) from error
        return None

    def _looks_of_a_dead(self, folder: TaskFolder) -> str | None:
        """What the sign of who is at the task looks like, if he is gone: for certain where it was a process
        of this machine, else after a time without a sign; empty where there is none any more, None while he
        seems to live."""
        try:  # in this order: opening a file has network disks ask how old it is
            looks = (_text(folder.running), folder.running.stat().st_mtime_ns)
        except FileNotFoundError:
            return ""
        alive = _lives(_read(folder.running) or {})
        sign = self._signs.setdefault(folder.running, _Sign(looks, time.monotonic()))
        if sign.looks != looks:
            sign.looks, sign.since = looks, time.monotonic()
        dead = time.monotonic() - sign.since > STALE if alive is None else not alive
        return looks[0] if dead else None


@dataclass
class Claim:
    """A task that is ours, as long as signs of life are given."""

    folder: TaskFolder
    content: Mapping[str, Any]
    """What running.json says"""
    inherited: bool
    """Whether somebody has left it, perhaps with parts of results"""
    last: float = field(default_factory=time.monotonic)
    """When a sign was given, on this machine's clock"""

    def beat(self) -> None:
        """Give a sign of life where one is due. Raises Lost where it is somebody else's task by now, or the
        folder has been gone for so long that it may be."""
        now = time.monotonic()
        if now - self.last <= BEAT:
            return
        try:
            self.check()
            os.utime(self.folder.running)
            self.last = now
        except OSError as error:  # a disk that is away for a moment may come back
            if now - self.last > STALE:
                raise Lost(
                    f"{shown(self.folder.path)}: the folder of results is gone ({why(error)})"
                ) from error

    def check(self) -> None:
        """Raises Lost where it is somebody else's task, and OSError where that cannot be told."""
        try:
            found = _read(self.folder.running, missing_ok=False)
        except FileNotFoundError:
            # Taken for one that is left behind: it is his whose sign is there first, unless it is done.
            if not self.folder.done.exists() and _put(self.folder, self.content):
                return
            found = None
        if found is None or found.get("token") != self.content["token"]:
            raise Lost(f"{self.folder.name}: another process has taken this task over")

    def release(self) -> None:
        """Leave the task to others."""
        _held.discard(self.content["token"])
        with contextlib.suppress(Lost, OSError):
            self.check()
            _remove(self.folder.running)
        if not self.folder.flat:
            with contextlib.suppress(OSError):
                self.folder.path.rmdir()  # only where nothing was written


def _created(folder: TaskFolder, id: str, dead: str) -> Claim | None:
    """Make running.json, as the only one, or in the place of a `dead` one; None where another is there.
    Raises OSError."""
    content = _content(id, token=uuid.uuid4().hex, **_this_process())
    _held.add(content["token"])
    try:
        if _put(folder, content, dead):
            return Claim(folder, content, bool(dead))
    except OSError:
        _held.discard(content["token"])
        raise
    _held.discard(content["token"])
    return None


def _put(folder: TaskFolder, content: Mapping[str, Any], dead: str = "") -> bool:
    """Make running.json; whether there was none. Raises OSError, as where the folder is gone."""
    text = json.dumps(content)
    aside = folder.aside(text)
    try:
        if dead:
            # At no moment is there none: results that a killed process has moved would be nobody's. Of two
            # who come at once the second has it, and the first finds that out before it moves anything.
            if _text(folder.running) != dead:
                return False
            aside.replace(folder.running)
            return True
        os.link(aside, folder.running)
    except FileExistsError:
        return False
    except FileNotFoundError:
        if folder.path.is_dir():  # whoever is at the task has taken it for something left behind
            return False
        raise
    except OSError as error:
        if error.errno not in _NO_LINKS:
            raise
        try:
            with folder.running.open("x", encoding="ascii") as stream:
                stream.write(text)
        except FileExistsError:
            return False
    finally:
        _remove(aside)
    return True


@cache
def _boot() -> str:
    """Which start of which machine this is, and which of its worlds of process numbers; empty where the
    system does not tell."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot} {Path('/proc/self/ns/pid').readlink()}"
    except OSError:
        return ""


def _started(pid: object) -> str:
    """When a process was started, in the machine's own count: numbers of processes are used again. Empty
    where there is none that runs: one that has ended may be there until its parent asks for it."""
    with contextlib.suppress(OSError, IndexError, ValueError):
        fields = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
        return "" if fields[0] in "ZX" else fields[19]
    return ""


def _this_process() -> dict[str, Any]:
    pid = os.getpid()
    return {"host": platform.node(), "pid": pid, "boot": _boot(), "started": _started(pid)}


def _lives(sign: Mapping[str, Any]) -> bool | None:
    """Whether the process that gave it is at the task; None where that cannot be told from here."""
    mine = _this_process()
    if {**sign, **mine} == sign:
        return sign.get("token") in _held
    if not _boot() or (sign.get("boot"), sign.get("host")) != (_boot(), mine["host"]):
        return None
    return _started(sign.get("pid")) == sign.get("started")


def _read(path: Path, *, missing_ok: bool = True) -> dict[str, Any] | None:
    """What a file of ours says; None where it says nothing that can be understood. Raises OSError unless
    `missing_ok`."""
    try:
        content = json.loads(read_file(path, _LARGEST))
    except OSError:
        if missing_ok:
            return None
        raise
    except (ValueError, RecursionError):
        return None
    known = isinstance(content, dict) and content.get("format") == _FORMAT
    return content if known and content.get("version") == _VERSION else None


def _text(path: Path) -> str:
    """Whatever a file holds. Raises OSError, also for what is no file, or larger than any of ours."""
    return read_file(path, _LARGEST).decode("utf-8", "replace")


def _content(id: str, **more: Any) -> dict[str, Any]:
    return {"format": _FORMAT, "version": _VERSION, "id": id, **more}


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)


def _flush_folder(path: Path) -> None:
    """Have the system write out which names the folder has, where it can."""
    with contextlib.suppress(OSError):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _not_written(path: Path, error: OSError) -> OutputError:
    return OutputError(f"{shown(path)}: could not be written ({why(error)})")
