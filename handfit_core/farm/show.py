"""How far a batch is, for people before a terminal and for programs that read what is printed."""

from __future__ import annotations

import json
import os
import sys
import time
import unicodedata
from dataclasses import dataclass
from typing import Final, TextIO

from handfit_core.errors import HandfitError
from handfit_core.farm.collect import Report
from handfit_core.farm.plan import FINDING, Task
from handfit_core.farm.pool import Listener
from handfit_core.farm.report import Result, line

STYLES: Final = ("text", "json", "openjd", "none")
"""text: a line for each input, and on a terminal bars; json: an object a line; openjd: Open Job
Description's lines, which other farms pass over"""
_EVERY: Final = {"bars": 0.2, "json": 1.0, "openjd": 10.0, "text": 30.0}
"""seconds between two of them; farms take what is silent for minutes for dead"""
_FITTING: Final = 0.6
"""What fitting is of a task's cost behind finding hands; files are made in the rest"""
_TRUST: Final = 5.0
"""seconds of work after which what was measured counts as much as what was guessed"""


@dataclass
class _AtHand:
    """A task that is being done."""

    task: Task
    began: float
    stage: str = ""
    done: int = 0
    total: int = 0

    @property
    def share(self) -> float:
        """How much of it is done, 0 to 1."""
        finding = 1.0 if self.task.of else 0.0 if self.task.needs else FINDING
        before, most = (finding, _FITTING * (1.0 - finding)) if self.stage == "fit" else (0.0, finding)
        return before + (most * min(self.done / self.total, 1.0) if self.total else 0.0)

    @property
    def left(self) -> float:
        """Of the task's cost."""
        return self.task.cost * (1.0 - self.share)

    @property
    def told(self) -> str:
        """What it is at."""
        return f"{self.stage} {self.done}/{self.total or '?'}" if self.stage else "starting"


class ProgressReporter(Listener):
    """Prints what happens to the tasks of a run, and keeps a report up to date."""

    def __init__(self, tasks: list[Task], style: str = "text", report: Report | None = None) -> None:
        self._style, self._report = style, report
        if style == "text" and sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
            self._style = "bars"
            if sys.platform == "win32":
                os.system("")  # has Windows' own console understand what moves its cursor
        self._count, self._ended = len(tasks), 0
        self._all = sum(task.cost for task in tasks) or 1.0
        self._left = self._all
        """Costs of what is not over"""
        self._worked, self._cost = _TRUST, _TRUST
        """seconds that tasks have taken here, and what they were guessed to take"""
        self._at: dict[str, _AtHand] = {}
        self._most = 1
        """Tasks that were done at the same time"""
        self._last = time.monotonic()
        self.trouble = ""
        """Why the report could not be written the last time"""

    def began(self, task: Task) -> None:
        """A task is being done."""
        self._at[task.id] = _AtHand(task, time.monotonic())
        self._most = max(self._most, len(self._at))
        if self._report is not None:
            self._report.set(Result(task.shown, task.name, "running", id=task.id))

    def progress(self, task: Task, stage: str, done: int, total: int) -> None:
        """So much of a stage is done."""
        at = self._at[task.id]
        at.stage, at.done, at.total = stage, done, total

    def ended(self, task: Task, result: Result) -> None:
        """A task is over."""
        at = self._at.pop(task.id, None)
        if at is not None and result.status == "ok":  # else it was done before, or tells nothing of the rest
            self._worked += time.monotonic() - at.began
            self._cost += task.cost
        self._left -= task.cost
        self._ended += 1
        self.close()
        if self._style == "json":
            self._say("ended", task=task.id, name=task.name, status=result.status, error=result.error)
        elif self._style != "none":
            _tell(f"[{self._ended}/{self._count}] {line(result)}", sys.stdout)
        if self._style == "openjd" and result.status == "failed":
            _tell(f"openjd_fail: {result.error}", sys.stdout)
        if self._report is not None:
            self._report.set(result)
            if self._ended == self._count:  # others may have been at work beside
                self._report.look()
            self._write(now=self._ended == self._count)

    def turn(self) -> None:
        """Tell now and then how far it is."""
        now = time.monotonic()
        if self._report is not None:
            self._write(now=False)
        if self._style == "none" or now - self._last < _EVERY[self._style]:
            return
        self._last = now
        share, at = 1.0 - self._cost_left() / self._all, self._at.values()
        if self._style == "bars":
            self._draw(share)
            return
        what = "; ".join(f"{each.task.name} {each.told}" for each in at) or "waiting"
        if self._style == "json":
            told = {"share": round(share, 4), "seconds_left": round(self._seconds_left())}
            tasks = [
                {"task": e.task.id, "name": e.task.name, "stage": e.stage, "done": e.done, "total": e.total}
                for e in at
            ]
            self._say("progress", **told, tasks=tasks)
        elif self._style == "openjd":
            _tell(f"openjd_progress: {100 * share:.1f}\nopenjd_status: {what}", sys.stdout)
        else:
            _tell(f"{share:.0%}, {self._overall()}: {what}", sys.stderr)

    def interrupted(self, why: str = "") -> None:
        """It was stopped: tasks at hand are left to the next run."""
        if self._report is not None:
            for at in self._at.values():
                result = Result(at.task.shown, at.task.name, "interrupted", id=at.task.id)
                result.error = why or "stopped by the user"
                self._report.set(result)
            self._report.look()
            self._write(now=True)

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._style == "bars":
            _tell("\r\x1b[J", sys.stderr, end="")

    def _draw(self, share: float) -> None:
        """A bar for the whole, and below it one for each task, as many as fit; the cursor stays above them,
        so that whatever else is printed replaces them."""
        width, height = _terminal()
        bar = max(0, min(20, width - 50))
        rows = [f"{_bar(share, bar)}{share:4.0%}  {self._overall()}"]
        pace = self._pace()
        named = max((_columns(at.task.name) for at in self._at.values()), default=0)
        named = min(named, 40, max(8, width - bar - 40))
        for at in list(self._at.values())[: height - 2]:
            name = _cut(at.task.name, named)
            text = f"{_bar(at.share, bar)}{at.share:4.0%}  {name}{' ' * (named - _columns(name))}"
            rows.append(f"{text}  {clock(at.left * pace)} left  {at.told}")
        text = "\n".join(_cut(row, width - 1) for row in rows)
        up = f"\x1b[{len(rows) - 1}A" if len(rows) > 1 else ""
        _tell(f"\r\x1b[J{text}\r{up}", sys.stderr, end="")

    def _overall(self) -> str:
        return f"{self._ended} of {self._count} done, {clock(self._seconds_left())} left"

    def _cost_left(self) -> float:
        return max(0.0, self._left - sum(at.task.cost - at.left for at in self._at.values()))

    def _pace(self) -> float:
        """How many seconds a task takes for each that was guessed, by those that were done and those at hand
        that tell how far they are."""
        now = time.monotonic()
        telling = [at for at in self._at.values() if at.share > 0.0]
        worked = self._worked + sum(now - at.began for at in telling)
        return worked / (self._cost + sum(at.task.cost - at.left for at in telling))

    def _seconds_left(self) -> float:
        """Of as many tasks at a time as there were, and of the longest at hand, which nobody can share."""
        longest = max((at.left for at in self._at.values()), default=0.0)
        return self._pace() * max(self._cost_left() / self._most, longest)

    def _say(self, event: str, **fields: object) -> None:
        _tell(json.dumps({"event": event, **fields}), sys.stdout)

    def _write(self, *, now: bool) -> None:
        """Write the report; what is left to do may still succeed where it cannot be written."""
        assert self._report is not None
        try:
            self._report.write(now=now)
            self.trouble = ""
        except HandfitError as error:
            if str(error) != self.trouble:
                self.close()
                _tell(f"error: {' '.join(str(error).split())}", sys.stderr)
            self.trouble = str(error)


def _tell(text: str, stream: TextIO, end: str = "\n") -> None:
    """Print at once; where nobody reads it any more, the batch goes on in silence."""
    try:
        print(text, end=end, file=stream, flush=True)
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def _terminal() -> tuple[int, int]:
    """Columns and rows of the terminal of stderr; some tell 0."""
    try:
        size = os.get_terminal_size(sys.stderr.fileno())
    except (OSError, ValueError):
        size = os.terminal_size((0, 0))
    return size.columns or 80, size.lines or 24


def _bar(share: float, width: int) -> str:
    return f"[{'#' * round(width * share):.<{width}}] " if width else ""


def _columns(text: str) -> int:
    """How many columns of a terminal a text takes."""
    return sum(2 if unicodedata.east_asian_width(c) in "WF" else 1 for c in text)


def _cut(text: str, columns: int) -> str:
    """As much of a text as fits; what would move the cursor is replaced."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    while _columns(text) > columns:
        text = text[:-1]
    return text


def clock(seconds: float) -> str:
    """Seconds as hours, minutes and seconds: 1:02:03 or 2:03."""
    hours, rest = divmod(round(seconds), 3600)
    return f"{hours}:{rest // 60:02}:{rest % 60:02}" if hours else f"{rest // 60}:{rest % 60:02}"
