"""Who does requests: a child process, this process, or several processes. All are asked and heard alike.

A request has a kind and fields, and `submit` gives it a number. `events` tells what has become of it since:
`progress` and `warning` while it is worked on, and last `done` or `error`, as docs/worker-protocol.md lists
them. `Worker` (client.py) has one child process do captures and re-fits, `InProcess` this one, and `Pool`
(pool.py) several at a time.
"""

from __future__ import annotations

import contextlib
import logging
import sys
import time
import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Final, Self

from handfit_core import errors
from handfit_core.errors import Cancelled, HandfitError

_POLL_SECONDS: Final = 0.05
"""seconds that one look at a runner waits for news"""

THREAD_VARIABLES: Final = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
"""What OpenMP, MKL, OpenBLAS, torch and OpenCV look at when they load"""

Event = dict[str, Any]
"""What has become of a request: its `id`, the kind of `event`, and the fields of that kind"""

OnProgress = Callable[[str, int, int], None]
"""Takes a stage's name, how much of it is done, and how much there is"""

Answer = Callable[[Mapping[str, Any], Callable[[], bool], OnProgress], dict[str, Any]]
"""Does the request of a message, which has its kind as `request`; returns the fields of the `done` event. It
asks now and then whether to stop, and then raises Cancelled or returns what is finished."""


class WorkerError(HandfitError):
    """The process that captures could not be started, is the wrong one, or died.

    `details` has what it said last, for a bug report.
    """

    def __init__(self, message: str, details: str = "") -> None:
        super().__init__(message)
        self.details = details


class WorkerDied(WorkerError):
    """The process that captures worked, and then died: another one may do better."""


class MemoryRanOut(WorkerDied):
    """There was not enough memory: alone on its machine, it may be enough."""


_WORKER_ERRORS: Final = {"WorkerDied": WorkerDied, "MemoryRanOut": MemoryRanOut, "MemoryError": MemoryRanOut}
"""the errors of `error` events that are defined here, not in errors.py"""


class Runner(ABC):
    """Does requests one at a time or several at once, and tells of them."""

    def __init__(self) -> None:
        self._number = 0
        self._open: dict[int, str] = {}
        """Number -> kind of the requests that have had no last event"""
        self._events: deque[Event] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def busy(self) -> bool:
        """Whether a request has not been answered, or an answer was not taken yet."""
        return bool(self._open or self._events)

    @abstractmethod
    def submit(self, kind: str, /, **fields: Any) -> int:
        """Ask for something; returns the number that its events carry as `id`. Raises HandfitError where it
        cannot even be tried."""

    @abstractmethod
    def cancel(self, request: int) -> None:
        """Have a request stopped as soon as it can be; its last event still comes. Does nothing to one that
        is over."""

    @abstractmethod
    def stop(self) -> None:
        """End everything; open requests get an `error` of type Cancelled."""

    @abstractmethod
    def _collect(self, wait: float) -> None:
        """Take in what has happened; where nothing has, wait for it up to `wait` seconds."""

    def events(self, *ids: int, wait: float = 0.0) -> list[Event]:
        """The events since the last call, in order; where there are none, it waits up to `wait` seconds.

        With `ids` only those of these requests; the others are kept for who asks for them.
        """
        self._collect(0.0)
        found = self._take_events(ids)
        if not found and wait and self._open:
            self._collect(wait)
            found = self._take_events(ids)
        return found

    def results(self, *requests: int) -> Iterator[Event]:
        """The `done` events of these requests as they come, whichever ends first. Raises the first error."""
        left = set(requests)
        while left:
            for event in self.events(*left, wait=_POLL_SECONDS):
                if event["event"] == "error":
                    raise _raised(event)
                if event["event"] == "done":
                    left.discard(event["id"])
                    yield event

    def wait(
        self, request: int, on_event: Callable[[Event], None] | None = None, timeout: float | None = None
    ) -> Event:
        """Block until a request is done; returns its `done` event. `on_event` gets the events before.

        Raises the HandfitError that the request ended in (InputError, NoHandFoundError, Cancelled, ...) or
        WorkerError. After `timeout` seconds everything is ended, and with it every open request.
        """
        kind = self._open.get(request, "request")
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            for event in self.events(request, wait=_POLL_SECONDS):
                if event["event"] == "done":
                    return event
                if event["event"] == "error":
                    raise _raised(event)
                if on_event:
                    on_event(event)
            if request not in self._open:
                raise ValueError(f"request {request} does not exist, or was answered before")
            if deadline is not None and time.monotonic() > deadline:
                self._give_up(
                    f"the {kind} took longer than {timeout:g} seconds and was stopped; allow it more time, "
                    "or give it fewer frames"
                )

    def _give_up(self, why: str, kind: str = WorkerError.__name__) -> None:
        """End everything and answer every open request with an error of this kind."""
        self._fail_all(kind, why, "")
        self.stop()

    def _fail_all(self, kind: str, message: str, details: str) -> None:
        for request in self._open:
            fields = {"type": kind, "message": message, "details": details}
            self._events.append({"event": "error", "id": request, **fields})
        self._open.clear()

    def _register(self, kind: str) -> int:
        """The number of a new request."""
        self._number += 1
        self._open[self._number] = kind
        return self._number

    def _finish(self, number: int, events: Iterable[Event]) -> None:
        """Take in the events of a request that is over."""
        del self._open[number]
        self._events += ({**event, "id": number} for event in events)

    def _take_events(self, ids: tuple[int, ...]) -> list[Event]:
        """Take out and return the events of these requests, of all where none are named."""
        found = [event for event in self._events if not ids or event["id"] in ids]
        if found:
            self._events = deque(event for event in self._events if ids and event["id"] not in ids)
        return found


class InProcess(Runner):
    """Does its requests in this process, in order: one at each look at its events, which lasts as long.

    What a request says on the way is heard together with its end.
    """

    def __init__(self, answer: Answer) -> None:
        super().__init__()
        self._answer = answer
        self._waiting: deque[tuple[int, dict[str, Any]]] = deque()

    def submit(self, kind: str, /, **fields: Any) -> int:
        """Note a request; nothing is done yet."""
        number = self._register(kind)
        self._waiting.append((number, {**fields, "request": kind}))
        return number

    def cancel(self, request: int) -> None:
        """Take out a request that waits."""
        for number, message in self._waiting:
            if number == request:
                self._waiting.remove((number, message))
                cancelled = Cancelled("cancelled before it was begun")
                self._finish(number, [{"event": "error", **error_fields(cancelled)}])
                return

    def stop(self) -> None:
        """Take out everything that waits."""
        self._waiting.clear()
        self._fail_all(Cancelled.__name__, "stopped before it was finished", "")

    def _collect(self, wait: float) -> None:  # noqa: ARG002 - the request itself is what it waits for
        if self._waiting:
            number, message = self._waiting.popleft()
            self._finish(number, run_request(self._answer, message))


def run_request(answer: Answer, message: Mapping[str, Any]) -> list[Event]:
    """Do a request in this process; its events without ids: progress, warnings, and last `done` or
    `error`."""
    events: list[Event] = []

    def say(kind: str, /, **fields: Any) -> None:
        events.append({"event": kind, **fields})

    try:
        with log_warnings_to(lambda text: say("warning", message=text)):
            done = answer(
                message,
                lambda: False,
                lambda stage, done, total: say("progress", stage=stage, done=done, total=total),
            )
    except Exception as error:
        say("error", **error_fields(error), exception=error)
    else:
        say("done", **done)
    return events


@contextlib.contextmanager
def log_warnings_to(say: Callable[[str], None]) -> Iterator[None]:
    """Within, `say` gets each warning that the core logs, as one line of text."""
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: say(" ".join(record.getMessage().split()))
    log = logging.getLogger("handfit")
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


def error_fields(error: Exception) -> dict[str, str]:
    """The fields of the `error` event of a request that ended in this exception: `message` is one sentence,
    `details` the traceback, which nobody needs of a Cancelled."""
    message, kind = str(error), type(error).__name__
    details = "" if isinstance(error, Cancelled) else "".join(traceback.format_exception(error))
    if isinstance(error, ImportError):
        message = (
            f"the Python {sys.executable} lacks what capturing needs ({error}); install handfit-core's "
            "requirements into it, or choose another Python"
        )
    elif isinstance(error, MemoryError):
        message = "memory ran out; capture fewer frames at a time, or smaller pictures"
        kind = MemoryError.__name__  # NumPy has one of its own
    elif not isinstance(error, HandfitError):
        message = f"unexpected error: {type(error).__name__}: {error}; the details say where"
    return {"type": kind, "message": " ".join(message.split()), "details": details}


def as_error(event: Event) -> HandfitError:
    """An `error` event as the exception that it was in the other process, with its details as a note."""
    message, details = str(event.get("message") or "the request failed"), str(event.get("details") or "")
    kind = getattr(errors, str(event.get("type")), None)
    if isinstance(kind, type) and issubclass(kind, HandfitError):
        error = kind(message)
    else:
        error = _WORKER_ERRORS.get(str(event.get("type")), WorkerError)(message, details)
    if details:
        error.add_note(details)
    return error


def _raised(event: Event) -> Exception:
    """The exception itself where it was raised in this process or came back whole."""
    return event.get("exception") or as_error(event)
