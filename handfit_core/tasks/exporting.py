"""The second step of a batch: Blenders make files of takes, and NAME.export.json, which is written last, says
which. Whoever gives the same command again makes only what is missing."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from handfit_core.common.errors import OutputError
from handfit_core.common.files import shown
from handfit_core.tasks.arguments import EXPORTED, BatchOptions
from handfit_core.tasks.record import Attempt, Record, Result, remove_abandoned, said_of_changed
from handfit_core.tasks.report import result_of
from handfit_core.tasks.task import Task
from handfit_core.tasks.workers import ProcessDied, Workers


@dataclass(frozen=True)
class Exports:
    """The files that are to be made of all takes of a batch, and the Blender that makes them."""

    command: Sequence[str]
    """The command that starts a Blender that makes files"""
    environment: Mapping[str, str]
    """Variables of that Blender's Python, which this process's Python does not have"""
    given: Mapping[str, Any]
    """The fields that this Blender is told about all takes, as JSON can hold them"""
    formats: Sequence[str]
    key: str
    """A key that changes with what decides the files of a take, beside the options of the capture"""
    options: BatchOptions
    debug: bool = False
    """True if what the Blenders say on stderr is shown"""

    def entry(self, task: Task, output: Path, *, again: bool = False) -> Result:
        """Return the report's entry of a task, which is pending while formats are missing; with `again` all
        of them count as missing."""
        result = result_of(task, Record.read(task.record(output)), task.folder(output))
        if result.status == "ok":
            exported = Exported(task, output, self.key)
            exported.fill_in(result)
            try:
                left = exported.left(self.formats, again=again, overwrite=self.options.overwrite)
            except OutputError as error:
                return replace(result, status="failed", error=str(error))
            result.status = "pending" if left else "ok"
        return result


class Exported:
    """The files that were made of one task's take."""

    def __init__(self, task: Task, output: Path, options: str) -> None:
        """Read the record of a task's files. `output`: the folder of all results. `options`: the key of the
        exports' options."""
        self.folder, self._prefix = task.folder(output), "" if task.flat else f"{task.name}/"
        self._path = self.folder / f"{task.name}.export.json"
        self._key = hashlib.sha256(f"{task.key} {options}".encode()).hexdigest()[:16]
        self.result = Result(task.shown, task.name, status="ok", id=task.key)
        """The result of the export, with its `warnings`, `character` and `seconds`"""
        self.formats: dict[str, dict[str, int]] = {}
        """For each format, the names of the files that are there, with their sizes in bytes"""
        self._of_others, self._changed = list[str](), list[str]()
        if (record := Record.read(self._path)) is None:
            return
        missing, self._changed = record.missing_and_changed(self.folder)
        if record.key != self._key:
            self._of_others = [name for name in record.files if name not in missing]
            return
        self.result = record.result
        for fmt, names in record.formats.items():
            if not any(name in missing for name in names):
                self.formats[fmt] = {name: record.files.get(name, -1) for name in names}

    def left(self, formats: Sequence[str], *, again: bool, overwrite: bool) -> list[str]:
        """Return the formats that have to be made, with `again` all of them. Raises OutputError where files
        of other options are there, unless `overwrite`."""
        if self._of_others and not overwrite:
            raise OutputError(
                f"{shown(self.folder / self._of_others[0])}: is there already, made with other options; "
                "--overwrite replaces it"
            )
        return [fmt for fmt in formats if again or fmt not in self.formats]

    def begin(self, formats: Sequence[str]) -> None:
        """Forget what was made of these formats; where nothing else is left, also the warnings and the
        character."""
        self.formats = {fmt: files for fmt, files in self.formats.items() if fmt not in formats}
        if not self.formats:
            self.result = replace(self.result, warnings=[], seconds=0.0, character=None)

    def save(self, answer: Mapping[str, Any], seconds: float) -> None:
        """Add what a Blender says that it has made, and write the record. Raises OutputError."""
        self.formats |= answer["made"]
        self.result.seconds += round(seconds, 3)
        self.result.warnings = list(dict.fromkeys([*self.result.warnings, *answer["warnings"]]))
        self.result.character = answer["character"] or self.result.character
        if self.formats:
            files = {name: size for sizes in self.formats.values() for name, size in sizes.items()}
            formats = {fmt: list(sizes) for fmt, sizes in self.formats.items()}
            Record(self._key, self.result, files, formats).write(self._path)

    def fill_in(self, entry: Result) -> None:
        """Add what was made to an entry of the report."""
        made = [name for files in self.formats.values() for name in files]
        entry.files += [f"{self._prefix}{name}" for name in made]
        entry.warnings += self.result.warnings
        if changed := [name for name in made if name in self._changed]:
            entry.warnings.append(said_of_changed(changed))
        entry.character = self.result.character
        entry.seconds = round(entry.seconds + self.result.seconds, 3)


class Exporters(Workers):
    """The Blenders of this machine that make files, each of one take after another; a thread waits for each
    Blender. A take at which a Blender dies is tried once more, alone."""

    tries = 2
    are_others = True
    death = "Blender crashed while it made files of it"

    def __init__(self, output: Path, exports: Exports, jobs: int) -> None:
        self.output, self._exports, self.room = output, exports, jobs
        self._threads = ThreadPoolExecutor(jobs)
        self._idle, self._busy = list[subprocess.Popen[str]](), list[subprocess.Popen[str]]()
        self._closing = False

    def submit(self, task: Task) -> Future[Result]:
        """Have files made of a task's take; the future holds the task's entry of the report."""
        return self._threads.submit(self._export, task)

    def told(self, task: Task) -> None:
        """Return None: what a Blender has made before it died is made again."""

    def lost(self, task: Task, tried: Sequence[Attempt]) -> Result:  # noqa: ARG002
        """Return the entry of a task at which a Blender has died each time."""
        why = "Blender crashed twice while it made files of it; try again with --debug"
        return replace(self._exports.entry(task, self.output), status="failed", error=why)

    def close(self) -> None:
        """End the Blenders, those at work at once."""
        self._closing = True
        for child in list(self._busy):
            child.kill()
        self._threads.shutdown()
        for child in self._idle:
            child.communicate()

    def _export(self, task: Task) -> Result:
        exports = self._exports
        exported, began = Exported(task, self.output, exports.key), time.perf_counter()
        try:
            again, overwrite = exports.options.again, exports.options.overwrite
            left = exported.left(exports.formats, again=again, overwrite=overwrite)
            exported.begin(left)
            remove_abandoned(exported.folder)
            model = exports.given["model"] if task.take else None
            wanted = {"folder": str(exported.folder), "name": task.name, "model": model, "formats": left}
            answer = self._answer(wanted)
            exported.save(answer, time.perf_counter() - began)
            error = answer["error"]
        except (OutputError, TimeoutError) as problem:
            error = str(problem)
        entry = exports.entry(task, self.output)
        return replace(entry, status="failed", error=error) if error else entry

    def _answer(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Have a Blender make files; returns what it says that it has made. Raises ProcessDied, and
        TimeoutError once it was ended."""
        try:  # Another thread may take the last idle one.
            child = self._idle.pop()
        except IndexError:
            child = self._start()
        self._busy.append(child)
        assert child.stdin is not None
        assert child.stdout is not None
        late, limit = threading.Event(), self._exports.options.timeout
        timer = threading.Timer(limit or 0.0, lambda: (late.set(), child.kill()))
        if limit:
            timer.start()
        if self._closing:
            child.kill()
        said = ""
        with contextlib.suppress(OSError):  # it has died
            child.stdin.write(json.dumps(wanted) + "\n")
            child.stdin.flush()
            said = next((line for line in child.stdout if line.startswith(EXPORTED)), "")
        timer.cancel()
        self._busy.remove(child)
        if late.is_set():
            child.wait()
            raise TimeoutError(f"to make files of it took longer than {limit:g} seconds (--timeout)")
        if not said:
            child.kill()
            child.wait()
            raise ProcessDied
        self._idle.append(child)
        return json.loads(said.removeprefix(EXPORTED))

    def _start(self) -> subprocess.Popen[str]:
        """Start a Blender that waits for takes; it ends with its stdin, and so with this process."""
        environment = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
        child = subprocess.Popen(
            self._exports.command,
            env=environment | dict(self._exports.environment),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=None if self._exports.debug else subprocess.DEVNULL,
            encoding="ascii",
            errors="replace",
        )
        assert child.stdin is not None
        with contextlib.suppress(OSError):
            child.stdin.write(json.dumps(self._exports.given) + "\n")
        return child
