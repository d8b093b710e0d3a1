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
from handfit_core.worker.runner import THREAD_VARIABLES, Answer, Runner, answered, error_fields


class Pool(Runner):
    """Does as many requests at a time as it has processes; they start with the first requests.

    Fields of requests and answers may be whatever can be pickled.
    """

    def __init__(self, processes: int, make_answer: Callable[[], Answer]) -> None:
        """`make_answer` is called once in each process, which has to find it by its module's name."""
        super().__init__()
        context = get_context("spawn")
        self._said: Any = context.SimpleQueue()
        self._executor = ProcessPoolExecutor(
            processes, context, initializer=_set_up, initargs=(make_answer, self._said)
        )
        self._running: dict[Future[dict[str, Any]], int] = {}

    def submit(self, kind: str, /, **fields: Any) -> int:
        """Hand a request to the next process that is free."""
        number = self._opened(kind)
        with _one_thread_per_child():
            future = self._executor.submit(_do, number, {**fields, "request": kind})
        self._running[future] = number
        return number

    def cancel(self, request: int) -> None:
        """Take out a request that waits; one that is worked on goes on to its end."""
        for future, number in self._running.items():
            if number == request:
                future.cancel()

    def stop(self) -> None:
        """Take out everything that waits, and wait for what is worked on."""
        self._executor.shutdown(wait=False, cancel_futures=True)
        while not all(future.done() for future in self._running):
            self._collect(0.05)  # a process that has much to say waits until it is heard
        self._executor.shutdown()
        self._collect(0.0)

    def _collect(self, wait: float) -> None:
        if wait:
            futures_wait(self._running, wait, FIRST_COMPLETED)
        ended = [future for future in self._running if future.done()]
        while not self._said.empty():  # before the ends: a request has said everything when it ends
            self._events.append(self._said.get())
        for future in ended:
            number = self._running.pop(future)
            del self._open[number]
            self._events.append({"id": number, **_ending(future)})


def _ending(future: Future[dict[str, Any]]) -> dict[str, Any]:
    """The last event of a request."""
    if future.cancelled():
        return {"event": "error", **error_fields(Cancelled("cancelled before it was begun"))}
    error = future.exception()
    if error is None:
        return {"event": "done", **future.result()}
    if not isinstance(error, Exception):  # Ctrl-C reaches the children, too
        error = Cancelled("interrupted")
    return {"event": "error", **error_fields(error), "exception": error}


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
_queue: Any = None
"""Takes what a request says on the way"""


def _set_up(make_answer: Callable[[], Answer], said: Any) -> None:
    """Make a new process ready for requests."""
    global _answer, _queue
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _answer, _queue = make_answer(), said


def _end_with_parent() -> None:
    """A killed parent tells its children nothing: they would wait for work for ever."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _do(number: int, message: dict[str, Any]) -> dict[str, Any]:
    """Do one request in a process of the pool."""
    assert _answer is not None
    return answered(_answer, message, lambda kind, said: _queue.put({"event": kind, "id": number, **said}))
