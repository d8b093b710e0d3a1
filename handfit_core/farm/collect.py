"""What came of all tasks of a folder of results, at any time, also while they run: report.json for programs,
and overview.html for people."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from handfit_core.errors import HandfitError, OutputError
from handfit_core.farm.overview import write_overview
from handfit_core.farm.plan import FOLDER, Plan, Task, files_of, plans_in
from handfit_core.farm.report import Result, write_report
from handfit_core.files import shown

NAME: Final = "report.json"
OVERVIEW: Final = "overview.html"
_OFTEN: Final = 1.0
"""seconds between two reports at least"""
_SHARE: Final = 20.0
"""Times the seconds that the last one took: a large one is written less often"""


class Report:
    """The state of every task of some plans. Of tasks of one name it is the one that has begun in their
    folder, or the latest plan's."""

    def __init__(self, plans: Iterable[Plan]) -> None:
        """`plans`: those of one folder, the oldest first."""
        self._tasks: dict[str, tuple[Plan, Task]] = {}
        self._results: dict[str, Result] = {}
        self._ours: set[str] = set()
        """The tasks of which this process knows best"""
        self._next, self._is_new = 0.0, True
        self._add(plans)

    def _add(self, plans: Iterable[Plan]) -> None:
        for plan in plans:
            self.output, self._latest = plan.output, plan.created
            for task in plan.tasks:
                if task.of:  # parts of clips are nobody's results
                    continue
                _, known = self._tasks.get(task.name, (plan, task))
                folder = plan.folder(task)
                if known.id == task.id or folder.holds(task.id) or not folder.holds(known.id):
                    self._tasks[task.name] = plan, task

    def has(self, task: Task) -> bool:
        """Whether it is the task that its name stands for."""
        return bool(task.of) or self._tasks[task.name][1].id == task.id

    def look(self) -> None:
        """Take in what the folders of all tasks say that are not done here, and of plans made since."""
        with contextlib.suppress(HandfitError):
            self._add(plans_in(self.output))
        for name, (plan, task) in list(self._tasks.items()):
            if name not in self._ours:
                self._results[name] = state(plan, task)
                if plan.created < self._latest and _is_gone(task, self._results[name]):
                    del self._tasks[name]

    def set(self, result: Result) -> None:
        """Take in what has become of a task; a part of a clip has no place of its own."""
        self._results[result.name], self._is_new = result, True
        self._ours.add(result.name)

    @property
    def results(self) -> list[Result]:
        """What became of each task."""
        return [
            self._results.get(name) or Result(task.shown, name, id=task.id)
            for name, (_, task) in self._tasks.items()
        ]

    def write(self, *, now: bool = True) -> None:
        """Write report.json and overview.html; unless `now`, only where there is news and they are old
        enough. Raises OutputError."""
        began = time.monotonic()
        if now or (self._is_new and began > self._next):
            if not (self.output / FOLDER).is_dir():  # nothing may be written where its disk was
                raise OutputError(
                    f"{shown(self.output)}: the folder of results is gone, and the report with it"
                )
            self._is_new = False
            results = self.results
            write_report(self.output / NAME, results)
            write_overview(self.output / OVERVIEW, [vars(result) for result in results])
            took = time.monotonic() - began
            self._next = time.monotonic() + max(_OFTEN, _SHARE * took)


def _is_gone(task: Task, result: Result) -> bool:
    """Whether a task of an earlier plan has nothing to show, and its input was renamed or taken away: its
    folder is there, so that no disk is."""
    if result.status not in ("pending", "failed") or result.files:
        return False
    files = [Path(task.take)] if task.take else files_of(task.source)
    return not any(file.exists() for file in files) and all(file.parent.is_dir() for file in files)


def state(plan: Plan, task: Task) -> Result:
    """What a task's folder says of it."""
    folder = plan.folder(task)
    known: Mapping[str, object] | None = folder.sealed(task.id) or folder.failures(task.id)
    entry = known.get("result") if known is not None else None
    result = Result.of_entry(entry) if isinstance(entry, dict) else Result(task.shown, task.name, id=task.id)
    if result.status in ("pending", "failed") and (host := folder.worked_on):
        result.status, result.host = "running", host
    return result
