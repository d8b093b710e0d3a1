"""One task: capture an input, and write what became of it."""

from __future__ import annotations

import contextlib
import logging
import os
import platform
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from handfit_core.capturing.options import VIEW_OPTIONS, CaptureOptions
from handfit_core.capturing.pipeline import capture, write_copies
from handfit_core.common.errors import HandfitError, InputError, OptionError, OutputError
from handfit_core.common.version import __version__
from handfit_core.take import Take
from handfit_core.take.sheet import write_sheet
from handfit_core.tasks.inputs import PAIRS
from handfit_core.tasks.record import Attempt, Record, Result, move_results, results_folder
from handfit_core.tasks.report import result_of
from handfit_core.tasks.task import Task, fingerprint

_log = logging.getLogger("handfit")


class InputChanged(InputError):
    """An input that has changed, or is gone, since its task was made."""


@dataclass(frozen=True)
class Settings:
    """The settings that all tasks of a command have in common; they can be pickled."""

    options: Mapping[str, Any] = field(default_factory=dict)
    """The captures' options, as `CaptureOptions.to_message` gives them"""
    sheet: bool = True
    """True if contact sheets are wanted"""
    timeout: float | None = None
    """Seconds that one input may take; the process that needs more is ended"""
    again: bool = False
    """True if what is done already is to be done again"""
    run: str = ""
    """A text that stands for the command, which does not make the results again that it has made"""
    version: str = __version__


def run_task(task: Task, output: Path, settings: Settings) -> Result:
    """Capture one input, and write its take, its contact sheet and last its record.

    A failure is a result, too; only MemoryError is raised, and OptionError in a process of another version.
    """
    if settings.version != __version__:
        raise OptionError(
            f"{platform.node()} has version {__version__} of handfit_core, and the batch was started by "
            f"version {settings.version}; use the same version on all machines"
        )
    known = Record.read(task.record(output))
    earlier = result_of(task, known, task.folder(output))
    if known is not None and known.key == task.key and known.run == settings.run:
        return earlier  # whoever did it died before he could tell
    if not settings.again and earlier.status == "ok":
        return earlier
    result, started = Result(task.shown, task.name, id=task.key, host=platform.node()), time.perf_counter()
    try:
        with _ended_in_time(task, output, settings), _warnings_in(result), results_folder(output) as part:
            _capture(task, output, part, settings, result)
            result.status, result.seconds = "ok", round(time.perf_counter() - started, 3)
            files = {path.name: path.stat().st_size for path in sorted(part.iterdir())}
            result.files += [task.folder(output).joinpath(n).relative_to(output).as_posix() for n in files]
            Record(task.key, result, files, run=settings.run).write(part / task.record(output).name)
            if known is not None and known.key != task.key:
                task.record(output).unlink(missing_ok=True)  # it says nothing of what comes in its place
            move_results(part, task.folder(output))
    except MemoryError:
        raise
    except Exception as error:
        kind, message = type(error).__name__, " ".join(str(error).split())
        if not isinstance(error, HandfitError):
            message = f"unexpected {kind}: {message}"
        tried = [Attempt.now(message, kind, time.perf_counter() - started)]
        return note_failure(task, output, settings, tried, result.warnings)
    return result


def note_failure(
    task: Task,
    output: Path,
    settings: Settings,
    attempts: Sequence[Attempt],
    warnings: Sequence[str] = (),
) -> Result:
    """Note in the record of a task, if it can be written, that it has failed in these attempts. What an
    earlier run has made of it stays noted there."""
    known = Record.read(task.record(output))
    files = known.files if known is not None and known.key == task.key else {}
    result = result_of(task, known).failed(attempts, warnings)
    with contextlib.suppress(OutputError):
        Record(task.key, result, files, run=settings.run).write(task.record(output))
    return result


def _capture(task: Task, output: Path, part: Path, settings: Settings, result: Result) -> None:
    """Write the take and its sheet into the folder `part`. Raises HandfitError."""
    if task.error:
        raise InputError(task.error)
    _check_input(task, "since the batch was started")
    told = dict(settings.options)
    if told.get("view") == PAIRS:
        told = {name: value for name, value in told.items() if task.view or name not in VIEW_OPTIONS}
        told |= {"view": task.view} if task.view else {}
    options = CaptureOptions.of_message(told)
    if task.take:
        take = Take.load(task.take)
    else:
        take = capture(task.source[0] if len(task.source) == 1 else list(task.source), options)
        _check_input(task, "while it was read: if it is still being copied, wait until it is complete")
    if not _is_same(task.take, task.take_path(output)):
        take.save(part / task.take_path(output).name)
    result.describe(take)
    with contextlib.suppress(ImportError):  # takes may be used where nothing can draw
        write_copies(take, options.max_megapixels)
    if settings.sheet:
        try:
            write_sheet(take, part / task.sheet(output).name, max_megapixels=options.max_megapixels)
        except OutputError:
            raise
        except (HandfitError, ImportError) as error:
            result.warnings += [] if task.take else [f"there is no contact sheet of it: {error}"]


def _is_same(given: str, path: Path) -> bool:
    """True if the take that is the input is the very file to which it would be copied."""
    with contextlib.suppress(OSError):
        return bool(given) and path.samefile(given)
    return False


def _check_input(task: Task, when: str) -> None:
    """Raise InputChanged where the input's files are not those that the task is for."""
    files = task.files
    if task.made_of == fingerprint(files):
        return
    if not files or not all(file.exists() for file in files):
        raise InputChanged(f"{task.shown}: is gone; bring it back, or start the batch again without it")
    raise InputChanged(f"{task.shown}: has changed {when}, and start the batch again")


@contextlib.contextmanager
def _ended_in_time(task: Task, output: Path, settings: Settings) -> Iterator[None]:
    """End this process, with the reason in the task's record, where the task takes too long."""
    if settings.timeout is None:
        yield
        return

    def overrun() -> None:
        message = f"{task.shown}: took longer than {settings.timeout:g} seconds (--timeout), and was ended"
        note_failure(task, output, settings, [Attempt.now(message, "Timeout", settings.timeout or 0.0)])
        os._exit(1)

    timer = threading.Timer(settings.timeout, overrun)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextlib.contextmanager
def _warnings_in(result: Result) -> Iterator[None]:
    """Collect the core's warnings, instead of printing them."""

    class Handler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            result.warnings.append(record.getMessage())

    before, propagate = _log.handlers, _log.propagate
    _log.handlers, _log.propagate = [Handler(logging.WARNING)], False
    try:
        yield
    finally:
        _log.handlers, _log.propagate = before, propagate
