"""How far a batch is, for people before a terminal and for farms that read what is printed."""

from __future__ import annotations

import json
import sys
import time
from typing import Final

from handfit_core.errors import HandfitError
from handfit_core.farm.collect import Report
from handfit_core.farm.plan import Task
from handfit_core.farm.pool import Listener
from handfit_core.farm.report import Result, line

STYLES: Final = ("text", "json", "openjd", "none")
"""text: a line for each input, and on a terminal a bar; json: an object a line; openjd: Open Job
Description's lines, which other farms pass over"""
_EVERY: Final = 0.2
_EVERY_IN_LOGS: Final = 30.0
"""seconds between two lines about the whole; farms take what is silent for minutes for dead"""
_WIDTH: Final = 20


class Shown(Listener):
    """Prints what happens to the tasks of a run, and keeps a report up to date."""

    def __init__(self, tasks: list[Task], style: str = "text", report: Report | None = None) -> None:
        self._tasks, self._style, self._report = tasks, style, report
        self._left = {task.id: task.cost for task in tasks}
        self._all = sum(self._left.values())
        self._skipped = 0.0
        self._at: dict[str, float] = {}
        self._what: dict[str, str] = {}
        self._started, self._last, self._bar = time.monotonic(), time.monotonic(), False
        self.trouble = ""
        """Why the report could not be written the last time"""

    def began(self, task: Task) -> None:
        """A task is being done."""
        self._at[task.id], self._what[task.id] = 0.0, task.name

    def progress(self, task: Task, stage: str, done: int, total: int) -> None:
        """So much of it is done: detecting takes most of the time."""
        share = done / total if total else 0.0
        self._at[task.id] = 0.9 * share if stage == "detect" else 0.9 + 0.1 * share
        self._what[task.id] = f"{task.name} {stage} {done}/{total or '?'}"

    def ended(self, task: Task, result: Result) -> None:
        """A task is over."""
        begun = self._at.pop(task.id, None)
        self._what.pop(task.id, None)
        cost = self._left.pop(task.id)
        if begun is None:  # it was sealed, or is somebody else's
            self._skipped += cost
        number = len(self._tasks) - len(self._left)
        self._clear()
        if self._style == "json":
            print(json.dumps({"event": "ended", "task": task.id, "status": result.status}), flush=True)
        elif self._style != "none":
            print(f"[{number}/{len(self._tasks)}] {line(result)}", flush=True)
        if self._report is not None:
            self._report.set(result)
            self._write(now=not self._left)

    def turn(self) -> None:
        """Draw the bar, or print a line now and then."""
        now = time.monotonic()
        terminal = self._style == "text" and sys.stderr.isatty()
        if now - self._last < (_EVERY if terminal else _EVERY_IN_LOGS) or self._style == "none":
            return
        self._last = now
        if self._report is not None:
            self._write(now=False)
        done = self._share()
        left = _time(self._seconds_left())
        what = "; ".join(self._what.values())
        if terminal:
            filled = "#" * round(_WIDTH * done)
            text = f"[{filled:.<{_WIDTH}}] {done:4.0%}, {left} left  {what}"[:110]
            print(f"\r{text:<110}", end="", file=sys.stderr, flush=True)
            self._bar = True
        elif self._style == "openjd":
            print(f"openjd_progress: {100 * done:.1f}\nopenjd_status: {what or 'waiting'}", flush=True)
        elif self._style == "json":
            print(json.dumps({"event": "progress", "share": round(done, 4), "at": what}), flush=True)
        else:
            print(f"{done:.0%}, {left} left: {what or 'waiting'}", file=sys.stderr, flush=True)

    def interrupted(self, why: str = "") -> None:
        """It was stopped: tasks at hand are left to the next run."""
        if self._report is not None:
            for task in self._tasks:
                if task.id in self._at:
                    result = Result(task.shown, task.name, "interrupted", id=task.id)
                    result.error = why or "stopped by the user"
                    self._report.set(result)
            self._write(now=True)

    def close(self) -> None:
        """Leave the terminal as it was."""
        self._clear()

    def _clear(self) -> None:
        if self._bar:
            print("\r" + " " * 110 + "\r", end="", file=sys.stderr, flush=True)
            self._bar = False

    def _share(self) -> float:
        """How much of the work is done, 0 to 1."""
        left = sum(cost * (1.0 - self._at.get(id, 0.0)) for id, cost in self._left.items())
        return 1.0 - left / self._all if self._all else 1.0

    def _seconds_left(self) -> float | None:
        """By how long the work so far has taken; None while nobody can say."""
        done = self._share() * self._all - self._skipped
        left = (1.0 - self._share()) * self._all
        return (time.monotonic() - self._started) * left / done if done > 0.02 * self._all else None

    def _write(self, *, now: bool) -> None:
        """Write the report; what is left to do may still succeed where it cannot be written."""
        assert self._report is not None
        try:
            self._report.write(now=now)
            self.trouble = ""
        except HandfitError as error:
            if str(error) != self.trouble:
                self._clear()
                print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
            self.trouble = str(error)


def _time(seconds: float | None) -> str:
    if seconds is None:
        return "?"
    hours, rest = divmod(round(seconds), 3600)
    return f"{hours}:{rest // 60:02}:{rest % 60:02}" if hours else f"{rest // 60}:{rest % 60:02}"
