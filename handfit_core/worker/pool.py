"""Several processes that do requests at the same time, each with one thread."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor
from concurrent.futures import wait as futures_wait
from multiprocessing import get_context, parent_process
from typing import Any

from handfit_core.errors import Cancelled
from handfit_core.worker.runner import THREAD_VARIABLES, Answer, Event, Runner, error_fields, run_request


class Pool(Runner):
    """Does as many requests at a time as it has processes; they start with the first requests.

    What a request says on the way is heard together with its end. Fields of requests and answers may be
    whatever can be pickled.
    """

    def __init__(self, processes: int, make_answer: Callable[[], Answer]) -> None:
        """`make_answer` is called once in each process, which has to find it by its module's name."""
        super().__init__()
        self._executor = ProcessPoolExecutor(
            processes, get_context("spawn"), initializer=_set_up, initargs=(make_answer,)
        )
        self._running: dict[Future[list[Event]], int] = {}

    def submit(self, kind: str, /, **fields: Any) -> int:
        """Hand a request to the next process that is free."""
        number = self._register(kind)
        with _one_thread_per_child():
            future = self._executor.submit(_do, {**fields, "request": kind})
        self._running[future] = number
        return number

    def cancel(self, request: int) -> None:
        """Take out a request that waits; one that is worked on goes on to its end."""
        for future, number in self._running.items():
            if number == request:
                future.cancel()

    def stop(self) -> None:
        """Take out everything that waits, and wait for what is worked on."""
        self._executor.shutdown(cancel_futures=True)
        self._collect(0.0)

    def _collect(self, wait: float) -> None:
        if wait:
            futures_wait(self._running, wait, FIRST_COMPLETED)
        for future in [future for future in self._running if future.done()]:
            self._finish(self._running.pop(future), _future_events(future))


def _future_events(future: Future[list[Event]]) -> list[Event]:
    """The events of a request that is over."""
    if future.cancelled():
        return [{"event": "error", **error_fields(Cancelled("cancelled before it was begun"))}]
    error = future.exception()
    if error is None:
        return future.result()
    if not isinstance(error, Exception):  # Ctrl-C reaches the children, too
        error = Cancelled("interrupted")
    return [{"event": "error", **error_fields(error), "exception": error}]


@contextlib.contextmanager
def _one_thread_per_child() -> Iterator[None]:
    """Processes started within get one thread each: more threads than cores mostly wait for each other.
    Libraries read these variables when they load."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


_answer: Answer | None = None
"""What this process does with requests, where it is one of a pool's"""


def _set_up(make_answer: Callable[[], Answer]) -> None:
    """Make a new process ready for requests."""
    global _answer
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _answer = make_answer()


def _end_with_parent() -> None:
    """A killed parent tells its children nothing: they would wait for work for ever."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _do(message: dict[str, Any]) -> list[Event]:
    """Do one request in a process of the pool; its events."""
    assert _answer is not None
    return run_request(_answer, message)
