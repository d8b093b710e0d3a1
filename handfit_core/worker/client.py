"""Starts the process that captures, handfit_core's worker, and talks to it.

Capturing needs MediaPipe, OpenCV and SciPy, which Blender's own process must not import.
docs/worker-protocol.md lists the messages.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from handfit_core.common.errors import Cancelled
from handfit_core.common.version import __version__
from handfit_core.worker.events import Event, WorkerError, encode
from handfit_core.worker.interpreter import (
    EXIT_UNFIT,
    PYTHON_VARIABLE,
    find_python,
    is_current_interpreter,
    worker_command,
    worker_environment,
)
from handfit_core.worker.process import ChildProcess

_START_SECONDS = 60.0
"""seconds until a started process must have said that it is ready"""
_STOP_SECONDS = 0.03
"""seconds that Blender's main thread gives a process to end by itself; one that has loaded torch needs some
0.1, all of it to give back memory"""
CHOOSE_PYTHON = "choose a Python that has SciPy, OpenCV and MediaPipe"
"""The advice about a Python that cannot capture; where it is chosen follows in the sentence"""
ENDED = (
    "the capturing process ended unexpectedly: try again, and if it happens again, with fewer frames or "
    "smaller pictures"
)
"""The sentence about a process that dies; what it said last becomes the error's details"""


class Worker:
    """One process that captures. It starts with the first request; after a crash the next one starts another.

    Nothing blocks, but `stop` for a moment. No thread runs for it: what the process says is taken in by
    `events`, and it works on only as long as somebody calls that.
    """

    def __init__(
        self,
        python: str | None = None,
        threads: int | None = None,
        debug: bool = False,
        *,
        advice: str = f"{CHOOSE_PYTHON} with --python or in ${PYTHON_VARIABLE}",
        bytecode: Path | None = None,
    ) -> None:
        """`python`: the interpreter, as `find_python` takes it. `threads`: how many it may use, None for
        its own choice. `debug`: its stderr, with tracebacks, is repeated on ours. `advice`: what to do about
        a Python that cannot capture, part of a sentence. `bytecode`: where the Python that runs here keeps
        what it compiles for the process; None: nowhere."""
        self.python = find_python(python)
        self._threads = threads
        self._debug = debug
        self._advice = advice
        self._bytecode = bytecode if is_current_interpreter(self.python) else None
        self._child: ChildProcess | None = None
        self.ready: Event | None = None
        """The process's `ready` event, with its versions; None until `events` has seen it"""
        self._start_deadline = 0.0
        self._number = 0
        self._open: dict[int, str] = {}
        """For each request that has had no last event, its number and its kind"""
        self._events: list[Event] = []

    @property
    def busy(self) -> bool:
        """True if a request has not been answered, or an answer was not taken yet."""
        return bool(self._open or self._events)

    def start(self) -> None:
        """Start the process unless it runs; returns at once. Raises WorkerError."""
        self._collect()
        if self._child is not None:
            return
        command = worker_command(self.python)
        if self._threads:
            command += ["--threads", str(self._threads)]
        if self._debug:
            command.append("--debug")
        try:
            self._child = ChildProcess(
                command, worker_environment(self.python, self._bytecode), echo=self._debug
            )
        except OSError as error:
            raise WorkerError(self._unfit(f"cannot be started ({error.strerror or error})")) from error
        self.ready = None
        self._start_deadline = time.monotonic() + _START_SECONDS

    def submit(self, kind: str, /, **fields: Any) -> int:
        """Ask for something; returns the number that its events carry as `id`.

        Starts the process if need be. Raises WorkerError when it cannot be started; ProtocolError for values
        that JSON cannot hold.
        """
        line = encode({"id": self._number + 1, "request": kind, **fields})
        self.start()
        assert self._child is not None
        self._child.send(line)
        self._number += 1
        self._open[self._number] = kind
        return self._number

    def cancel(self, request: int) -> None:
        """Have a request stopped as soon as it can be; its last event still comes. Does nothing to one that
        is over."""
        if request in self._open and self._child is not None:
            self._child.send(encode({"request": "cancel", "job": request}))

    def abandon(self, request: int) -> None:
        """Have a request stopped as soon as it can be, and throw away what it answers."""
        self.cancel(request)
        self._open.pop(request, None)
        self.events(request)

    def tell(self, request: int, kind: str, /, **fields: Any) -> None:
        """Say something to a request that runs (`live-record`, `live-calibrate`); nothing to one that is
        over."""
        if request in self._open and self._child is not None:
            self._child.send(encode({"request": kind, "job": request, **fields}))

    def events(self, *ids: int) -> list[Event]:
        """Return the events since the last call, in order.

        With `ids` only those of these requests; the others are kept for who asks for them. Where the process
        has died, every open request gets an `error`.
        """
        self._collect()
        found = [event for event in self._events if not ids or event["id"] in ids]
        self._events = [event for event in self._events if ids and event["id"] not in ids]
        return found

    def stop(self, seconds: float = _STOP_SECONDS) -> None:
        """End the process; open requests get an `error` of type Cancelled.

        One that has not ended after `seconds` is killed. A take is written whole or not at all; of what
        was being written a temporary file may stay beside it.
        """
        child, self._child, self.ready = self._child, None, None
        if child is not None:
            child.stop(seconds)
        self._fail_all(Cancelled.__name__, "stopped before it was finished", "")

    def _collect(self) -> None:
        """Take in what the process said since the last time."""
        child = self._child
        if child is None:
            return
        child.exchange()
        ended = child.ended()
        for message in child.received():
            if self.ready is None:
                self._receive_first(message)
            elif message["id"] in self._open:
                self._receive(message)
            if self._child is None:
                return
        if ended:
            self._give_up(self._end_at_start(child) if self.ready is None else ENDED)
        elif self.ready is None and time.monotonic() > self._start_deadline:
            said = f"the Python '{self.python}' did not answer within {_START_SECONDS:g} seconds: try again"
            self._give_up(said)

    def _receive_first(self, message: Event) -> None:
        """Take in a process's `ready` event; gives up on a process of another version."""
        if message.get("version") == __version__:
            self.ready = message
        else:
            self._give_up(
                f"the add-on was updated from version {__version__} to {message.get('version')} while "
                "Blender was running; restart Blender"
            )

    def _receive(self, message: Event) -> None:
        """Take in an event of a request that is open."""
        kind = message["event"]
        if kind in ("done", "error"):
            del self._open[message["id"]]
        if kind == "error" and message["type"] in ("ModuleNotFoundError", "ImportError"):
            message = {
                **message,
                "type": WorkerError.__name__,
                "message": self._unfit(f"cannot capture ({message['message']})"),
            }
        if kind == "live":  # only the newest pose is of use, and the newest picture
            same = [(e["event"], e["id"]) == ("live", message["id"]) for e in self._events]
            pictures = [e["picture"] for e, is_same in zip(self._events, same, strict=True) if is_same]
            if pictures and message["picture"] is None:
                message = {**message, "picture": pictures[-1]}
            self._events = [e for e, is_same in zip(self._events, same, strict=True) if not is_same]
        self._events.append(message)

    def _fail_all(self, kind: str, message: str, details: str) -> None:
        fields = {"event": "error", "type": kind, "message": message, "details": details}
        self._events += [{**fields, "id": request} for request in self._open]
        self._open.clear()

    def _give_up(self, why: str) -> None:
        """Kill the process and answer every open request with a WorkerError."""
        child, self._child, self.ready = self._child, None, None
        details = ""
        if child is not None:
            child.kill()
            how = "" if child.exit_code is None else f"the process ended with exit code {child.exit_code}"
            details = "\n".join(filter(None, (child.stderr_tail().strip(), how)))
        self._fail_all(WorkerError.__name__, why, details)

    def _end_at_start(self, child: ChildProcess) -> str:
        """Return the sentence about a Python whose process ended before it was ready, with what it said
        last."""
        lines = child.stderr_tail().split("\n")
        said = next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")
        return self._unfit(said if child.exit_code == EXIT_UNFIT else f"cannot capture ({said})")

    def _unfit(self, what: str) -> str:
        """Return the sentence about a Python that cannot capture: what it is or does, and what to do."""
        return f"the Python '{self.python}' {what}; {self._advice}"
