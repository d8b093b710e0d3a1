"""Running hostile cases: one at a time, in a child process that may die of them.

A child (child.py) is kept as long as it behaves and is started anew after a crash, a limit, or when it has
grown. The kernel watches the limits, so that native code cannot escape them: the peak of resident memory,
which it counts, and time. How fast a machine is decides no case: the limits of time are many times what any
case needs, and only end what would never end.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import select
import shutil
import signal
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.conftest import ROOT

SEED = "handfit-hostile-1"
CPU_SECONDS = 120.0
"""After so much computing without an answer, a case is taken for an endless loop."""
SILENT_SECONDS = 1200.0
"""After so long on the clock without an answer, a case is taken to wait for what never comes."""
MOST_BYTES = 1_000_000_000
"""Peak of resident memory, the libraries' own included."""
_GROWN_BYTES = 650_000_000
"""A child that is as large after a case is started anew, so that no case pays for the ones before it."""
RESULTS = "result"
"""The only folder of a case in which anything may appear or change."""
ODD: dict[str, Callable[[Path], object]] = {
    "pipe": os.mkfifo,
    "socket": lambda path: os.mknod(path, stat.S_IFSOCK | 0o600),
    "folder": Path.mkdir,
    "folder-with-pipe": lambda path: (path.mkdir(), os.mkfifo(path / f"MANO_RIGHT{path.suffix}")),
    "zeros": lambda path: path.symlink_to("/dev/zero"),
    "memory": lambda path: path.symlink_to("/proc/self/mem"),
    "circle": lambda path: path.symlink_to(path.name),
    "circle-of-folders": lambda path: (path.mkdir(), (path / "in").symlink_to(path.parent)),
    "link": lambda path: path.symlink_to("../../kept.npz"),
    "gone": lambda path: path.symlink_to("nowhere"),
    "unreadable": lambda path: (path.write_bytes(b"x"), path.chmod(0)),
    "sparse": lambda path: (path.touch(), os.truncate(path, 1 << 36)),
}
"""What may lie in the place of a file"""


@dataclass(frozen=True)
class Place:
    """Where a case is made: its folder, its own random numbers, and the port that nobody may connect to."""

    folder: Path
    rng: random.Random
    port: int

    def write(self, name: str, data: bytes) -> Path:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return path


@dataclass(frozen=True)
class Case:
    """One hostile input. Its name is all that is needed to make it again."""

    name: str
    door: str
    """`core.take`: the door `take` of core.py."""
    make: Callable[[Place], dict[str, Any]]
    """Writes the files of the case and returns the door's arguments."""
    refused: bool = False
    """Whether a result, however sane, is a failure."""
    known: bool = False
    """Whether it stands for something that once went wrong: those are always in the quick part."""

    @property
    def quick(self) -> bool:
        return self.known or random.Random(f"{SEED} quick {self.name}").random() < 0.04


def file_case(
    name: str,
    door: str,
    file: str,
    data: Callable[[Place], bytes],
    *,
    refused: bool = False,
    known: bool = False,
    **arguments: Any,
) -> Case:
    """A case that is one file: the door gets its path, and `arguments`."""

    def make(place: Place) -> dict[str, Any]:
        return {"path": str(place.write(file, data(place))), **arguments}

    return Case(name, door, make, refused, known)


def table(
    stem: str,
    door: str,
    file: str | Callable[[str], str],
    contents: Mapping[str, Callable[[], bytes]],
    *,
    known: Collection[str] = (),
    **options: Any,
) -> Iterator[Case]:
    """A `file_case` for each of `contents`, named STEM-NAME; `file` may depend on the name. `known`: names."""
    for name, data in contents.items():
        called = file if isinstance(file, str) else file(name)
        made = lambda _, data=data: data()  # noqa: E731
        yield file_case(f"{stem}-{name}", door, called, made, known=name in known, **options)


class Doorkeeper:
    """Runs cases and tells what went wrong in each."""

    def __init__(self) -> None:
        self._base = Path(tempfile.mkdtemp(prefix="handfit-hostile-"))
        self._children: dict[str, _Child] = {}
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]

    def close(self) -> None:
        for child in self._children.values():
            child.kill()
        self._listener.close()
        shutil.rmtree(self._base, ignore_errors=True)

    def run(self, case: Case) -> list[str]:
        """What went wrong, in words; nothing where all is well."""
        folder = Path(tempfile.mkdtemp(dir=self._base))
        try:
            (folder / RESULTS).mkdir()
            (folder / "kept.npz").write_bytes(b"a good file of the artist's")
            place = Place(folder, random.Random(f"{SEED} {case.name}"), self.port)
            arguments = case.make(place)
            before = _contents(folder)
            faults = [*self._asked(case, folder, arguments), *self._connected()]
            after = _contents(folder)
            for name in sorted(before.keys() | after.keys()):
                if before.get(name) != after.get(name):
                    what = "lost" if name not in after else "changed" if name in before else "left behind"
                    faults.append(f"{what}: {name!r}")
            return faults
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _asked(self, case: Case, folder: Path, arguments: dict[str, Any]) -> Iterator[str]:
        kind, _, door = case.door.partition(".")
        if kind not in self._children:
            self._children[kind] = _Child(kind, self._base)
        child, text = self._children[kind], ""
        try:
            answer = child.ask(door, folder, arguments)
            text = answer["text"]
            if answer["peak"] > MOST_BYTES:
                yield f"memory: {answer['peak'] // 1_000_000} MB"
            if answer["verdict"] == "fault":
                yield text
            elif answer["verdict"] == "sentence" and not _is_sentence(text):
                yield f"no sentence: {text[:300]!r}"
            elif answer["verdict"] == "result" and case.refused:
                yield "accepted, although it must be refused"
            if answer["now"] > _GROWN_BYTES:
                self._children.pop(kind).kill()
        except EOFError as error:
            self._children.pop(kind).kill()
            yield f"{error}: {child.said()[-300:]!r}"
        said = child.said()
        if "Traceback (most recent call last)" in said or "Fatal Python error" in said:
            yield f"stderr: {said[-600:]}"

    def _connected(self) -> Iterator[str]:
        with contextlib.suppress(BlockingIOError):
            self._listener.accept()[0].close()
            yield "opened a connection"
            yield from self._connected()


class _Child:
    """A process of child.py."""

    def __init__(self, kind: str, base: Path) -> None:
        self._log = base / f"{kind}.log"
        environment = {
            **os.environ,
            **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"),
            "PYTHONPATH": str(ROOT),
            "PYTHONFAULTHANDLER": "1",
            "TMPDIR": str(base),
        }
        with self._log.open("ab") as log:  # appended to, so that it can be cut between cases
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.hostile.child", f"tests.hostile.{kind}"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                cwd=ROOT,
                env=environment,
                start_new_session=True,
            )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests, self._answers = self._process.stdin, self._process.stdout
        if self._answers.readline() != b'"ready"\n':
            raise RuntimeError(f"the child {kind!r} did not start: {self.said()}")

    def ask(self, door: str, folder: Path, arguments: dict[str, Any]) -> dict[str, Any]:
        """The child's answer; EOFError, with what became of it, where there is none."""
        os.truncate(self._log, 0)
        ask = {"door": door, "folder": str(folder), "arguments": arguments, "cpu_seconds": CPU_SECONDS}
        self._requests.write(json.dumps(ask).encode("ascii") + b"\n")
        self._requests.flush()
        if not select.select([self._answers], [], [], SILENT_SECONDS)[0]:
            raise EOFError(f"hangs: no answer within {SILENT_SECONDS:g} s")
        line = self._answers.readline()
        if not line.endswith(b"\n"):
            code = self._process.wait()
            how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
            raise EOFError(f"the process ended {how}")
        return json.loads(line)

    def said(self) -> str:
        """What it wrote on stderr during this case."""
        return self._log.read_text("utf-8", errors="replace")

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._requests.close()
        self._answers.close()


def _is_sentence(text: str) -> bool:
    return 0 < len(text.strip()) < 10_000 and "\n" not in text.strip() and "Traceback" not in text


def _contents(folder: Path) -> dict[str, str]:
    """Name -> what is there, for everything but the results."""
    found: dict[str, str] = {}
    for parent, folders, files in os.walk(folder):
        if Path(parent) == folder:
            folders.remove(RESULTS)
        for name in (*folders, *files):
            path = Path(parent, name)
            mode = path.lstat().st_mode
            kind = stat.filemode(mode)
            if stat.S_ISREG(mode) and os.access(path, os.R_OK):
                with path.open("rb") as stream:  # of sparse giants the beginning, and how long they are
                    kind += f"{path.stat().st_size} {hashlib.sha256(stream.read(20_000_000)).hexdigest()}"
            found[os.path.relpath(path, folder)] = kind
    return found
