"""The tasks of a batch done by workers: what is done is passed over, and what dies is tried again."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future
from contextlib import ExitStack
from queue import SimpleQueue

from handfit_core.common.errors import OptionError
from handfit_core.tasks.record import Attempt, Result, remove_abandoned
from handfit_core.tasks.task import Task
from handfit_core.tasks.workers import ProcessDied, SchedulerGone, Workers, interrupted_by_waking


def run_tasks(tasks: Sequence[Task], workers: Workers) -> Iterator[tuple[Task, Result]]:
    """Do all of these tasks, the longest first; yields each with its result as it ends.

    A task whose process dies is tried again, the last time with nothing beside it, and has failed then.
    Raises OptionError where nobody can do any.
    """
    waiting, last = deque(sorted(tasks, key=lambda task: -task.frames)), list[Task]()
    attempts = defaultdict[str, list[Attempt]](list)
    """For each task, by its key, the attempts in which its process has died"""
    running, ended = dict[Future[Result], Task](), SimpleQueue[Future[Result] | None]()

    def next_ended() -> Future[Result]:
        if (future := ended.get()) is None:
            raise KeyboardInterrupt
        return future

    remove_abandoned(workers.output)
    with ExitStack() as stack:
        stack.callback(remove_abandoned, workers.output)
        stack.callback(workers.close)
        if workers.are_others:
            stack.enter_context(interrupted_by_waking(lambda: ended.put(None)))
        while waiting or last or running:
            while not running or (waiting and len(running) < workers.room):
                task = waiting.popleft() if waiting else last.pop()
                try:
                    future = workers.submit(task)
                except BrokenExecutor:  # a process has died while it was idle, or those at hand tell
                    waiting.appendleft(task)
                    if running:
                        break
                    workers.renew()
                else:
                    running[future] = task
                    future.add_done_callback(ended.put)
            over = [next_ended()]
            if isinstance(_error(over[0]), BrokenExecutor):
                # One has died, and with it the others.
                over += [next_ended() for _ in range(len(running) - 1)]
                workers.renew()
            results = [(task := running.pop(f), f, _result(task, f, workers)) for f in over]
            overran = "Timeout" in [r.attempts[-1].kind for *_, r in results if r and r.attempts]
            for task, future, result in results:
                tried = attempts[task.key]
                if result is not None:
                    result.attempts = [*tried, *result.attempts]
                    yield task, result
                    continue
                if not overran:
                    tried.append(_death(future, workers))
                if len(tried) >= workers.tries:
                    yield task, workers.lost(task, tried)
                elif len(tried) == workers.tries - 1:
                    last.append(task)
                else:
                    waiting.append(task)


def _error(future: Future[Result]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _result(task: Task, future: Future[Result], workers: Workers) -> Result | None:
    """Return what came of a task, None where its process has died before it could tell."""
    error = _error(future)
    if error is None:
        return future.result()
    if isinstance(error, CancelledError):
        raise SchedulerGone
    if isinstance(error, OptionError):
        raise error
    return workers.told(task)


def _death(future: Future[Result], workers: Workers) -> Attempt:
    """Return the attempt in which the process of this future has died."""
    error = _error(future)
    if isinstance(error, BrokenExecutor | ProcessDied) or type(error).__name__ == "KilledWorker":
        return Attempt.now(workers.death, "WorkerDied")
    said = "memory ran out" if isinstance(error, MemoryError) else f"Dask could not have it done: {error}"
    return Attempt.now(said, type(error).__name__)
