"""Running hostile cases: one at a time, in a child process that may die of them.

A child (child.py) is kept as long as it behaves and is started anew after a crash, a limit, or when it has
grown. The limits are watched from outside, so that native code cannot escape them: the peak of resident memory,
which the kernel counts, and time. How fast a machine is decides no case: the limits of time are many times
what any case needs, and only end what would never end.
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
import time
from collections.abc import Callable
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
_KILL_BYTES = 1_400_000_000
_GROWN_BYTES = 650_000_000
"""A child that is as large after a case is started anew, so that no case pays for the ones before it."""
RESULTS = "result"
"""The only folder of a case in which anything may appear or change."""


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
    """`core.take`: the door `take` of core_doors.py."""
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
            child = self._child(case.door.partition(".")[0])
            faults = self._watched(child, case, folder, arguments)
            after = _contents(folder)
            for name in sorted(before.keys() | after.keys()):
                if before.get(name) != after.get(name):
                    what = "lost" if name not in after else "changed" if name in before else "left behind"
                    faults.append(f"{what}: {name!r}")
            return faults
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _child(self, kind: str) -> _Child:
        child = self._children.get(kind)
        if child is None or not child.fresh():
            if child is not None:
                child.kill()
            child = self._children[kind] = _Child(kind, self._base)
        return child

    def _watched(self, child: _Child, case: Case, folder: Path, arguments: dict[str, Any]) -> list[str]:
        child.ask(case.door.partition(".")[2], folder, arguments)
        faults: list[str] = []
        answer: dict[str, Any] | None = None
        cpu, until = child.cpu(), time.monotonic() + SILENT_SECONDS
        while answer is None and not faults:
            ready, _, _ = select.select([child.answers, self._listener], [], [], 0.02)
            if self._listener in ready:
                faults += self._connected()
            elif ready:
                line = child.answers.readline()
                answer = json.loads(line) if line.endswith(b"\n") else None
                if answer is None:
                    faults.append(f"the process ended {child.ending()}: {child.said()[-300:]!r}")
            elif child.memory("VmHWM") > _KILL_BYTES:
                faults.append("memory beyond all bounds")
            elif child.cpu() - cpu > CPU_SECONDS:
                faults.append(f"computes for more than {CPU_SECONDS:g} s")
            elif time.monotonic() > until:
                faults.append(f"hangs: no answer within {SILENT_SECONDS:g} s")
        faults += self._connected()
        # Without the pages of libraries, which differ by a hundred MB with how the system happens to map them.
        if (peak := child.memory("VmHWM") - child.memory("RssFile")) > MOST_BYTES:
            faults.append(f"memory: {peak // 1_000_000} MB")
        if answer is None:
            child.kill()
            return faults
        if answer["verdict"] == "fault":
            faults.append(answer["text"])
        elif answer["verdict"] == "sentence" and not _is_sentence(answer["text"]):
            faults.append(f"no sentence: {answer['text'][:300]!r}")
        elif answer["verdict"] == "result" and case.refused:
            faults.append("accepted, although it must be refused")
        said = child.said()
        if "Traceback (most recent call last)" in said or "Fatal Python error" in said:
            faults.append(f"stderr: {said[-600:]}")
        return faults

    def _connected(self) -> list[str]:
        count = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                connection, _ = self._listener.accept()
                connection.close()
                count += 1
        return ["opened a connection"] if count else []


class _Child:
    """A process of child.py."""

    def __init__(self, kind: str, base: Path) -> None:
        self._log = open(base / f"{kind}.log", "a+b")  # appended to, so that it can be cut between cases
        environment = {
            **os.environ,
            **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"),
            "PYTHONPATH": str(ROOT),
            "PYTHONFAULTHANDLER": "1",
            "TMPDIR": str(base),
        }
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.hostile.child", f"tests.hostile.{kind}_doors"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            cwd=ROOT,
            env=environment,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests, self.answers = self._process.stdin, self._process.stdout
        if self.answers.readline() != b'"ready"\n':
            raise RuntimeError(f"the child {kind!r} did not start: {self.said()}")

    def fresh(self) -> bool:
        """Whether it lives and is no larger than a child that has just begun to work."""
        return self._process.poll() is None and self.memory("VmRSS") < _GROWN_BYTES

    def ask(self, door: str, folder: Path, arguments: dict[str, Any]) -> None:
        self._log.truncate(0)
        Path(f"/proc/{self._process.pid}/clear_refs").write_text("5")  # the peak begins anew
        ask = {"door": door, "folder": str(folder), "arguments": arguments}
        self._requests.write(json.dumps(ask).encode("ascii") + b"\n")
        self._requests.flush()

    def memory(self, field: str) -> int:
        """Bytes of a field of /proc/PID/status; 0 once it is gone."""
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/{self._process.pid}/status").read_text().splitlines():
                if line.startswith(field):
                    return int(line.split()[1]) * 1024
        return 0

    def cpu(self) -> float:
        """Seconds that it and its ended children have computed."""
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
            return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
        return 0.0

    def said(self) -> str:
        """What it wrote on stderr during this case."""
        self._log.seek(0)
        return self._log.read().decode("utf-8", errors="replace")

    def ending(self) -> str:
        code = self._process.wait()
        return f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for stream in (self._requests, self.answers, self._log):
            with contextlib.suppress(BrokenPipeError):
                stream.close()


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
