"""The tasks of a batch done by workers: what is done is passed over, and what dies is tried again."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from handfit_core.errors import OptionError
from handfit_core.tasks.capture import Settings, fail
from handfit_core.tasks.record import read_record, remove_abandoned
from handfit_core.tasks.report import Result, attempt, result_of
from handfit_core.tasks.task import Task
from handfit_core.tasks.workers import SchedulerGone, Workers


@dataclass(eq=False)
class _Try:
    """A task that is not over, and how often its process has died."""

    task: Task
    attempts: list[dict[str, Any]] = field(default_factory=list)


def run_tasks(
    tasks: Sequence[Task], output: Path, settings: Settings, workers: Workers
) -> Iterator[tuple[Task, Result]]:
    """Do all of these tasks, the longest first; gives each with its result as it ends.

    A task whose process dies is tried again, the last time with nothing beside it, and has failed then.
    Raises OptionError where nobody can do any.
    """
    waiting = deque(map(_Try, sorted(tasks, key=lambda task: -task.frames)))
    last: list[_Try] = []
    running: dict[Future[Result], _Try] = {}
    remove_abandoned(output)
    try:
        while waiting or last or running:
            _hand_out(waiting, last, running, output, settings, workers)
            ended = wait(running, return_when="FIRST_COMPLETED").done
            if any(isinstance(_error(future), BrokenExecutor) for future in ended):
                ended = wait(running).done  # one has died, and the others were ended with it
                workers.renew()
            over = [(running.pop(future), future) for future in ended]
            results = [(this, future, _result(this.task, future, output, settings)) for this, future in over]
            overran = any(result is not None and _overran(result) for *_, result in results)
            for this, future, result in results:
                if result is None and not overran:
                    this.attempts.append(_death(future))
                if result is not None:
                    result.attempts = [*this.attempts, *result.attempts]
                elif len(this.attempts) >= workers.tries:
                    result = _lost(this, output, settings)
                if result is not None:
                    yield this.task, result
                elif len(this.attempts) == workers.tries - 1:
                    last.append(this)
                else:
                    waiting.append(this)
    finally:
        workers.close()
        remove_abandoned(output)


def _hand_out(
    waiting: deque[_Try],
    last: list[_Try],
    running: dict[Future[Result], _Try],
    output: Path,
    settings: Settings,
    workers: Workers,
) -> None:
    """Hand out as many tasks as there is room for; the last tries once nothing else is left."""
    room = workers.room
    while not running or (waiting and len(running) < room):
        this = waiting[0] if waiting else last[-1]
        try:
            running[workers.submit(this.task, output, settings)] = this
        except BrokenExecutor:  # a process has died while it was idle, or those at hand tell
            if running:
                return
            workers.renew()
        else:
            waiting.popleft() if waiting else last.pop()


def _error(future: Future[Result]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _result(task: Task, future: Future[Result], output: Path, settings: Settings) -> Result | None:
    """What came of a task, None where its process has died before it could tell."""
    error = _error(future)
    if error is None:
        return future.result()
    if isinstance(error, CancelledError):
        raise SchedulerGone
    if isinstance(error, OptionError):
        raise error
    record = read_record(task.record(output))
    if record is not None and record["key"] == task.key and record.get("run") == settings.run:
        return result_of(task, record)
    return None


def _overran(result: Result) -> bool:
    return bool(result.attempts) and result.attempts[-1].get("kind") == "Timeout"


def _death(future: Future[Result]) -> dict[str, Any]:
    """The attempt that ended so."""
    error = _error(future)
    if isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker":
        return attempt("the process that captured it died", "WorkerDied", 0.0)
    said = "memory ran out" if isinstance(error, MemoryError) else f"Dask could not have it done: {error}"
    return attempt(said, type(error).__name__, 0.0)


def _lost(this: _Try, output: Path, settings: Settings) -> Result:
    """A task is given up."""
    *before, last = this.attempts
    result = Result(this.task.shown, this.task.name, id=this.task.key, attempts=before)
    times = f" {len(this.attempts)} times" if before else ""
    sentence = f"{this.task.shown}: {last['error']}{times}; the input is damaged, or needs more memory"
    fail(this.task, output, result, {**last, "error": sentence}, settings)
    return result
