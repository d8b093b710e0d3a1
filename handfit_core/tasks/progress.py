"""The progress of a batch: a bar on a terminal, a line for each input, or a JSON object a line for
programs."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, TextIO

from handfit_core.common.errors import HandfitError
from handfit_core.tasks.exporting import Exports
from handfit_core.tasks.record import Result
from handfit_core.tasks.report import line, read_results, write_report
from handfit_core.tasks.task import Task

_OFTEN: Final = 1.0
"""The least seconds between two reports"""
_SHARE: Final = 20.0
"""How many times the seconds that the last report took must pass before the next: a large one is written less
often"""


class Progress:
    """The teller of a batch's progress: it reports each input that is over, and keeps the report up to
    date."""

    def __init__(self, output: Path, tasks: Sequence[Task], style: str) -> None:
        self._output, self._style, self._tasks = output, style, tasks
        self.results = {task.key: Result(task.shown, task.name, id=task.key) for task in tasks}
        """For each task, by its key, the result of its input so far"""
        self.trouble = ""
        """The reason why the report could not be written the last time; else empty"""
        self._over, self._next = 0, 0.0
        self._exported = set[str]()
        """Keys of the tasks of whose takes files were made in this run, or could not be"""
        self._bar: Any = None
        if style == "text" and sys.stderr.isatty():
            with contextlib.suppress(ImportError):
                from tqdm import tqdm

                self._bar = tqdm(total=len(self._tasks), unit="input", file=sys.stderr, dynamic_ncols=True)

    def ended(self, task: Task, result: Result) -> None:
        """Note and tell that an input is over."""
        self.results[task.key] = result
        self._over += 1
        if self._style == "json":
            said = {"task": task.key, "name": task.name, "status": result.status, "error": result.error}
            event = {"event": "ended", **said, "done": self._over, "total": len(self._tasks)}
            say(json.dumps(event), sys.stdout)
        elif self._bar is not None:
            self._bar.clear()
            say(line(result), sys.stdout)
            self._bar.update()
        elif self._style == "text":
            say(f"[{self._over}/{len(self._tasks)}] {line(result)}", sys.stdout)
        if time.monotonic() > self._next:
            self.write()

    def exported(self, task: Task, result: Result) -> None:
        """Note the report's entry of a task: files were made of its take, or could not be."""
        self.results[task.key] = result
        self._exported.add(task.key)
        status, error = result.status, result.error
        if self._bar is not None:
            self._bar.clear()
        if self._style == "json":
            said = {"task": task.key, "name": task.name, "status": status, "error": error}
            say(json.dumps({"event": "exported", **said}), sys.stdout)
        elif self._style == "text":
            say(f"failed: {task.shown}: {error}" if error else f"exported: {task.shown}", sys.stdout)

    def write(self) -> None:
        """Write the reports; where that cannot be, what is left to do may still succeed."""
        began = time.monotonic()
        try:
            write_report(self._output, list(self.results.values()))
            self.trouble = ""
        except HandfitError as error:
            if str(error) != self.trouble:
                say(f"error: {' '.join(str(error).split())}", sys.stderr)
            self.trouble = str(error)
        self._next = time.monotonic() + max(_OFTEN, _SHARE * (time.monotonic() - began))

    def catch_up(self, exports: Exports | None) -> None:
        """Note what a stop kept from being told: processes may have finished tasks all the same."""
        unknown = [task for task in self._tasks if self.results[task.key].status == "pending"]
        self.results |= {r.id: r for r in read_results(self._output, unknown) if r.status == "ok"}
        for task in self._tasks:
            if exports and self.results[task.key].status == "ok" and task.key not in self._exported:
                self.results[task.key] = exports.entry(task, self._output)

    def close(self) -> None:
        """Write the reports a last time, and leave the terminal as it was."""
        if self._bar is not None:
            self._bar.close()
        self.write()


def say(text: str, stream: TextIO) -> None:
    """Print a text at once; where nobody reads it any more, the batch goes on in silence."""
    try:
        print(text, file=stream, flush=True)
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
