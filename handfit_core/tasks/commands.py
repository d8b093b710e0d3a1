"""The command `batch`: capture many inputs."""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import sys
import uuid
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import check_options
from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.common.files import check_writable
from handfit_core.common.machine import usable_cores, usable_jobs
from handfit_core.tasks.arguments import EXPORTS, WITH_PARENT, BatchOptions, add_batch_arguments
from handfit_core.tasks.capture import Settings
from handfit_core.tasks.exporting import Exporters, Exports
from handfit_core.tasks.inputs import PAIRS
from handfit_core.tasks.progress import Progress
from handfit_core.tasks.record import Result
from handfit_core.tasks.report import REPORT, read_results
from handfit_core.tasks.run import run_tasks
from handfit_core.tasks.task import Task, make_tasks
from handfit_core.tasks.workers import (
    DaskWorkers,
    LocalProcesses,
    Workers,
    end_after,
    terminated_as_interrupted,
)

_MOST_A_CORE: Final = 4
"""Processes that --jobs may ask for: more would only fill the memory and wait for each other"""
EXIT_SOME_FAILED: Final = 1
EXIT_USAGE: Final = 2


def add_batch_command(commands: Any) -> None:
    """Add `batch`, which sets `handler`, called as handler(args) -> exit code."""
    parser = commands.add_parser("batch", help="capture many inputs, and go on where it was stopped")
    parser.set_defaults(handler=_batch)
    add_batch_arguments(parser)
    parser.add_argument(WITH_PARENT, action="store_true", help=argparse.SUPPRESS)
    parser.add_argument(EXPORTS, type=json.loads, help=argparse.SUPPRESS)


def _batch(args: argparse.Namespace) -> int:
    with terminated_as_interrupted():
        if args.with_parent:
            end_after(lambda: os.read(0, 1))
        try:
            return _run(args)
        except OptionError as error:
            args.reporter.error("OptionError", str(error))
            return EXIT_USAGE


def _run(args: argparse.Namespace) -> int:
    """Do what is left of a batch. Returns the exit code. Raises OptionError where nothing can be tried."""
    options, output = CaptureOptions.of_arguments(args), args.output.absolute()
    batch = BatchOptions.of_arguments(args)
    tasks = make_tasks(
        args.inputs,
        options,
        output,
        grouping=args.grouping,
        sheet=not batch.no_sheet,
        flat=batch.flat,
        overwrite=batch.overwrite,
    )
    if not all(task.take for task in tasks):  # takes need nothing that captures
        _check_packages()
        check_options(options)
    exports = None
    if args.exports is not None:
        exports = Exports(**args.exports, options=batch, debug=args.debug)
    found = list(zip(tasks, read_results(output, tasks), strict=True))
    left = [task for task, result in found if _is_left(result, batch)]
    jobs = min(batch.jobs or usable_jobs(), _MOST_A_CORE * usable_cores(), max(1, len(left)))
    if batch.dry_run:
        return _tell(found, exports, jobs, output, batch)
    try:
        check_writable(output / REPORT)
    except HandfitError as error:
        raise OptionError(str(error)) from error
    message = options.to_message()
    for name in ("model", "keypoints", "landmark_model", "view", "cameras"):
        if message.get(name, PAIRS) != PAIRS:  # workers may have been started in another folder
            message[name] = str(Path(message[name]).expanduser().absolute())
    if batch.scheduler not in (None, "local"):  # what cores there are nobody knows here
        message["processes"] = options.processes or 1
    elif jobs > 1 or batch.scheduler is not None:  # each capture has its share of the cores
        message["processes"] = options.processes or max(1, usable_cores() // jobs)
    settings = Settings(message, not batch.no_sheet, batch.timeout, batch.again, uuid.uuid4().hex)
    with closing(Progress(output, tasks, args.progress)) as progress:
        for task, result in found:
            if not _is_left(result, batch):
                progress.ended(task, result)
        try:
            if left:
                for task, result in run_tasks(
                    left, _workers(output, settings, batch, jobs, alone=exports is None)
                ):
                    progress.ended(task, result)
            if exports is not None:
                _export(tasks, output, exports, progress)
        finally:
            progress.catch_up(exports)
    done = all(result.status == "ok" for result in progress.results.values())
    return 0 if done and not progress.trouble else EXIT_SOME_FAILED


def _export(tasks: Sequence[Task], output: Path, exports: Exports, progress: Progress) -> None:
    """Have files made of the takes that lack some, and tell of each."""
    left = []
    for task in tasks:
        if progress.results[task.key].status != "ok":
            continue
        entry = exports.entry(task, output, again=exports.options.again)
        if entry.status == "failed":
            progress.exported(task, entry)
        elif entry.status == "pending":
            left.append(task)
    if left:
        jobs = min(exports.options.jobs or usable_jobs(), _MOST_A_CORE * usable_cores(), len(left))
        for task, result in run_tasks(left, Exporters(output, exports, jobs)):
            progress.exported(task, result)


def _check_packages() -> None:
    """Raise OptionError where this Python lacks what every capture needs."""
    missing = [name for name in ("cv2", "scipy") if importlib.util.find_spec(name) is None]
    if missing:
        raise OptionError(
            f"the Python {sys.executable} cannot capture, as it has no {' and no '.join(missing)}: install "
            "them there, or choose another Python"
        )


def _is_left(result: Result, batch: BatchOptions) -> bool:
    if batch.again or (result.status == "failed" and batch.retry_failed):
        return True
    return result.status != "ok" and not result.is_final


def _workers(output: Path, settings: Settings, batch: BatchOptions, jobs: int, *, alone: bool) -> Workers:
    """Choose who captures: this process, processes of this machine, or a Dask cluster; `alone`: nothing comes
    after it. Raises OptionError."""
    if batch.scheduler is not None:
        return DaskWorkers(output, settings, batch.scheduler, jobs)
    # A process that dies or takes too long must not be this one, unless somebody wants it so.
    lacks_loky = batch.jobs is None and importlib.util.find_spec("loky") is None
    if batch.timeout is None and (lacks_loky or (alone and batch.jobs == 1)):
        return Workers(output, settings)
    return LocalProcesses(output, settings, jobs)


def _tell(
    found: Sequence[tuple[Task, Result]],
    exports: Exports | None,
    jobs: int,
    output: Path,
    batch: BatchOptions,
) -> int:
    """Print what the batch would do, without doing it; returns the exit code."""
    count = 0
    for task, result in found:
        status, said = "to do", task.error
        if not _is_left(result, batch):
            if result.status == "ok" and exports is not None:
                result = exports.entry(task, output, again=batch.again)
            status, said = {"ok": "done", "pending": "to do"}.get(result.status, "failed"), result.error
            said += "; --retry-failed tries it again" if result.is_final else ""
        count += status == "to do"
        print(f"{status:8} {task.shown} -> {task.folder(output)}{said and f': {said}'}")
    print(f"{count} of {len(found)} to do, {jobs} at a time")
    return 0
