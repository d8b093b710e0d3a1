"""The report about each input: report.json for programs, overview.html for people, and a line on the console.

Nothing here needs SciPy or OpenCV, so that Blender writes the reports anew once it has made its files.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from handfit_core.common.files import written_whole
from handfit_core.take.fit_quality import NOT_KNOWN
from handfit_core.tasks.overview import scale_and_error, write_overview
from handfit_core.tasks.record import Hand, Record, Result, move_results, results_folder, said_of_changed

if TYPE_CHECKING:
    from handfit_core.tasks.task import Task

REPORT: Final = "report.json"
OVERVIEW: Final = "overview.html"


def result_of(task: Task, record: Record | None, folder: Path | None = None) -> Result:
    """Return the result of a task by its record; pending where it is another task's, or where files of it
    that should lie in `folder` are gone. Files that somebody has changed since are his work by now, and a
    warning says so."""
    pending = Result(task.shown, task.name, id=task.key)
    if record is None or record.key != task.key:
        return pending
    result = replace(record.result, input=task.shown, name=task.name, id=task.key)
    if folder is not None and result.status == "ok":
        missing, changed = record.missing_and_changed(folder)
        if changed:
            result.warnings.append(said_of_changed(changed))
        elif missing:
            return pending
    return result


def read_results(output: Path, tasks: Sequence[Task]) -> list[Result]:
    """Return the results of all tasks by their records, in the order of the tasks."""
    return [result_of(t, Record.read(t.record(output)), t.folder(output)) for t in tasks]


def write_report(output: Path, results: Sequence[Result]) -> None:
    """Write report.json and overview.html. Raises OutputError."""
    report = {"format": "handfit-batch", "version": 1, "inputs": [asdict(r) for r in results]}
    with results_folder(output) as part:
        with written_whole(part / REPORT) as beside:
            text = json.dumps(report, indent=2, ensure_ascii=False) + "\n"
            # Of a name that is no UTF-8 an escape is left, which says the same in JSON.
            beside.write_text(text, encoding="utf-8", errors="backslashreplace")
        write_overview(part / OVERVIEW, output.absolute().name, results)
        move_results(part, output)


def line(result: Result) -> str:
    """Return one line about one input, for people."""
    if result.status != "ok":
        named = "" if result.error.startswith(result.input) else f"{result.input}: "
        return f"{result.status}: {named}{result.error}"
    hands = ", ".join(
        f"{hand.side} hand in {hand.detected} of {result.frames} frames{_error(hand)}"
        for hand in result.hands
    )
    warnings = f", {len(result.warnings)} warnings" if result.warnings else ""
    return f"ok: {result.input}: {hands}{warnings}, {result.seconds:.1f} s"


def _error(hand: Hand) -> str:
    if not hand.error_known:
        return f" ({NOT_KNOWN})"
    scale, error = scale_and_error(hand)
    return f" ({scale.title.lower()} {scale.said(error)}, {scale.quality(error)})" if scale else ""
