"""Starts the process that captures, handfit_core's worker, and talks to it.

Capturing needs torch, MediaPipe and OpenCV, which Blender's own Python does not have and must not be given.
docs/worker-protocol.md lists the messages.
"""

from __future__ import annotations

import contextlib
import shutil
import signal
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from handfit_core import errors
from handfit_core.errors import Cancelled, HandfitError, ProtocolError
from handfit_core.version import __version__
from handfit_core.worker import protocol

from .. import installation, verification
from .interpreter import (
    LAUNCHER,
    PYTHON_VARIABLE,
    find_python,
    is_blenders_own,
    worker_command,
    worker_environment,
)
from .process import ChildProcess, out_of_memory_kills

__all__ = [
    "IN_BLENDER",
    "PYTHON_VARIABLE",
    "Advice",
    "Event",
    "Worker",
    "WorkerError",
    "as_error",
    "find_python",
]

_START_LIMIT = 60.0
"""seconds until a started process must have said that it is ready"""
_NOISE_LIMIT = 200
"""lines before that which are no messages"""
_GRACE = 0.03
"""seconds that Blender's main thread gives a process to end by itself; one that has loaded torch needs some
0.1, all of it to give back memory"""
_PATIENCE = 3.0
"""seconds that a script gives it"""

_LONGEST_SENTENCE = 2000
"""characters of what a worker says for people"""
_CRASHES = ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGILL", "SIGFPE", "SIGTRAP", "SIGSYS")
"""What a process does to itself; other signals come from outside"""

Event = dict[str, Any]
"""One message of the worker"""


class WorkerError(HandfitError):
    """The process that captures could not be started, is the wrong one, or died.

    `details` has what it said last, for a bug report.
    """

    def __init__(self, message: str, details: str = "") -> None:
        super().__init__(message)
        self.details = details


@dataclass(frozen=True)
class Advice:
    """What errors tell the user to do; parts of sentences."""

    where: str
    """where the interpreter is chosen"""
    crash: str
    """what to do after a crash"""

    @property
    def python(self) -> str:
        """What to do about an unfit interpreter."""
        return f"choose a Python that has torch, SciPy, OpenCV and MediaPipe {self.where}"


IN_BLENDER = Advice(
    where=installation.IN_PREFERENCES,
    crash="try again, and if it happens again, press Check Installation in the add-on's preferences",
)


class Worker:
    """One process that captures. It starts with the first request; after a crash the next one starts another.

    Nothing but `wait` blocks, and `stop` for a moment. No thread runs for it: what the process says is taken
    in by `poll` and `wait`, and it works on only as long as somebody calls them.
    """

    def __init__(
        self,
        python: str | None = None,
        threads: int | None = None,
        debug: bool = False,
        *,
        advice: Advice = IN_BLENDER,
    ) -> None:
        """`python`: the interpreter, as `find_python` takes it. `threads`: how many it may use, None for
        its own choice. `debug`: its stderr, with tracebacks, is repeated on ours."""
        self.python = find_python(python)
        self._threads = threads
        self._debug = debug
        self._advice = advice
        self._child: ChildProcess | None = None
        self._last_child: ChildProcess | None = None
        self._hello: Event | None = None
        self._start_deadline = 0.0
        self._kills_before: int | None = None
        """`out_of_memory_kills` when the last request was sent"""
        self._number = 0
        self._open: dict[int, str] = {}
        self._events: deque[Event] = deque()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(_PATIENCE)

    @property
    def blenders_own(self) -> bool:
        """Whether Blender's own Python captures, with what the add-on's zip brings."""
        return is_blenders_own(self.python)

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._child is not None and self._child.exit_code is None

    @property
    def pid(self) -> int | None:
        """The running process's id."""
        return self._child.pid if self.alive and self._child else None

    @property
    def ready(self) -> Event | None:
        """The process's `ready` event, with its versions; None until `poll` or `wait` has seen it."""
        return self._hello

    @property
    def busy(self) -> bool:
        """Whether a request has not been answered, or an answer was not taken yet."""
        return bool(self._open or self._events)

    def start(self) -> None:
        """Start the process unless it runs; returns at once. Raises WorkerError."""
        self._collect()
        if self._child is not None:
            return
        if Path(self.python).is_dir() and not shutil.which(self.python):
            raise WorkerError(f"'{self.python}' is a folder, not a Python; {self._advice.python}")
        if not LAUNCHER.is_file():
            raise WorkerError(installation.import_problem(FileNotFoundError(f"no {LAUNCHER.name}")).sentence)
        command = worker_command(self.python)
        if self._threads:
            command += ["--threads", str(self._threads)]
        if self._debug:
            command.append("--debug")
        try:
            self._child = ChildProcess(command, worker_environment(self.python), echo=self._debug)
        except OSError as error:
            raise WorkerError(
                f"cannot start the Python '{self.python}' ({error.strerror or error}); {self._advice.python}"
            ) from error
        self._last_child = self._child
        self._hello = None
        self._start_deadline = time.monotonic() + _START_LIMIT

    def request(self, kind: str, **fields: Any) -> int:
        """Ask for something; returns the number that its events carry as `id`.

        Starts the process if need be. Raises WorkerError when it cannot be started, or where a part that a
        capture needs is known to be missing; ProtocolError for values that JSON cannot hold, and for more of
        them than the process reads.
        """
        if kind == "capture" and self.blenders_own and (sentence := verification.before_capture()):
            if sentence.endswith(installation.IN_PREFERENCES):
                sentence = sentence.removesuffix(installation.IN_PREFERENCES) + self._advice.where
            raise WorkerError(sentence)
        line = protocol.encode({"id": self._number + 1, "request": kind, **fields})
        if len(line) > protocol.LONGEST_REQUEST:
            raise ProtocolError(f"a {kind} of {len(line) // 1_000_000} MB is too large; give it fewer frames")
        self.start()
        assert self._child is not None
        self._kills_before = out_of_memory_kills()
        self._number += 1
        self._open[self._number] = kind
        self._child.send(line)
        return self._number

    def cancel(self, job: int) -> None:
        """Have a request stopped as soon as it can be; its last event still comes."""
        if job not in self._open or self._child is None:
            return
        self._number += 1
        self._child.send(protocol.encode({"id": self._number, "request": "cancel", "job": job}))

    def poll(self, *ids: int) -> list[Event]:
        """The events since the last call, in order: `progress`, `warning`, and last `done` or `error`.

        With `ids` only those of these requests; the others are kept for who asks for them. Where the
        process has died, every open request gets an `error` of type WorkerError.
        """
        self._collect()
        if not ids:
            events = list(self._events)
            self._events.clear()
            return events
        events = [event for event in self._events if event["id"] in ids]
        if events:
            self._events = deque(event for event in self._events if event["id"] not in ids)
        return events

    def wait(
        self, job: int, on_event: Callable[[Event], None] | None = None, timeout: float | None = None
    ) -> Event:
        """Block until a request is done; returns its `done` event. `on_event` gets the events before.

        Raises the HandfitError that the worker names (InputError, NoHandFoundError, Cancelled, ...) or
        WorkerError. After `timeout` seconds the process is killed, and with it every open request.
        """
        kind = self._open.get(job, "request")
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            for event in self.poll(job):
                if event["event"] == "done":
                    return event
                if event["event"] == "error":
                    raise as_error(event)
                if on_event:
                    on_event(event)
            if job not in self._open:
                raise ValueError(f"request {job} does not exist, or was answered before")
            if deadline is not None and time.monotonic() > deadline:
                assert timeout is not None
                self._give_up(
                    f"the {kind} took longer than {timeout:g} seconds and was stopped; allow it more time, "
                    "or give it fewer frames"
                )
            elif self._child is not None:
                self._child.wait_for_news(0.05)

    def stop(self, seconds: float = _GRACE) -> None:
        """End the process; open requests get an `error` of type Cancelled.

        One that has not ended after `seconds` is killed. A take is written whole or not at all; of what
        was being written a temporary file may stay beside it.
        """
        child, self._child, self._hello = self._child, None, None
        if child is not None:
            child.stop(seconds)
        self._answer_all(Cancelled.__name__, "stopped before it was finished", "")

    def details(self) -> str:
        """What the process, or the last one, said on stderr, and how it ended; for a bug report."""
        child = self._last_child
        if child is None:
            return ""
        code = child.exit_code
        ending = "" if code is None else f"the process ended {_ending(code)}"
        return "\n".join(filter(None, (child.last_words().strip(), ending)))

    def _collect(self) -> None:
        """Take in what the process said since the last time."""
        child = self._child
        if child is None:
            return
        child.exchange()
        ended = child.ended()
        for message in child.received():
            try:
                if self._hello is None:
                    self._greet(message)
                else:
                    self._receive(message)
            except ProtocolError as error:
                self._give_up(
                    f"the worker process said something unknown: {error}; {self._advice.crash}",
                    ProtocolError.__name__,
                )
            if self._child is None:
                return
        if child.endless:
            self._give_up(
                f"the worker process wrote a line of more than {protocol.LONGEST_EVENT >> 20} MB, and was "
                f"stopped; {self._advice.crash}"
                if self._hello
                else f"the Python '{self.python}' is not one; {self._advice.python}"
            )
        elif ended:
            self._give_up(self._why_it_died(child))
        elif self._hello is None and child.noise > _NOISE_LIMIT:
            self._give_up(f"the Python '{self.python}' is not one; {self._advice.python}")
        elif self._hello is None and time.monotonic() > self._start_deadline:
            self._give_up(
                f"the Python '{self.python}' did not answer within {_START_LIMIT:g} seconds; "
                f"{self._advice.python}"
            )

    def _greet(self, message: Event) -> None:
        """Take in the first message; gives up on the process if it is not the right one."""
        unknown = f"the Python '{self.python}' answered in an unknown way; {self._advice.python}"
        try:
            protocol.check_event(message)
        except ProtocolError:
            self._give_up(unknown)
            return
        version = message.get("protocol")
        if message.get("event") == "unfit":
            self._give_up(
                f"the Python '{self.python}' is version {message.get('python')}, and capturing needs 3.11 or "
                f"newer; {self._advice.python}"
            )
        elif message.get("event") != "ready":
            self._give_up(unknown)
        elif version != protocol.PROTOCOL:
            self._give_up(
                f"the worker of '{self.python}' speaks protocol {version}, this add-on needs "
                f"{protocol.PROTOCOL}; install the handfit-core that belongs to the add-on there"
            )
        elif installation.is_installed() and message.get("version") != __version__:
            self._give_up(
                f"the add-on was updated from version {__version__} to {message.get('version')} while "
                "Blender was running; restart Blender"
            )
        else:
            self._hello = message

    def _receive(self, message: Event) -> None:
        """Take in an event of a request that is open. Raises ProtocolError."""
        kind = message.get("event")
        if kind not in ("progress", "warning", "done", "error"):
            return
        if kind == "error" and message.get("id") is None:  # of a line that was none of the requests'
            return
        job = protocol.check_id(message)
        if job not in self._open:
            return
        protocol.check_event(message, self._open[job])
        if kind in ("warning", "error"):
            message = {**message, "message": " ".join(message["message"].split())[:_LONGEST_SENTENCE]}
        if kind in ("done", "error"):
            del self._open[job]
        if kind == "error" and message.get("type") in ("ModuleNotFoundError", "ImportError"):
            message = {**message, "type": WorkerError.__name__, "message": self._what_is_missing(message)}
        self._events.append(message)

    def _give_up(self, why: str, kind: str = WorkerError.__name__) -> None:
        """Kill the process and answer every open request with an error of this kind."""
        child, self._child, self._hello = self._child, None, None
        if child is not None:
            child.kill()
        self._answer_all(kind, why, self.details())

    def _answer_all(self, kind: str, message: str, details: str) -> None:
        for job in self._open:
            self._events.append(
                {"event": "error", "id": job, "type": kind, "message": message, "details": details}
            )
        self._open.clear()

    def _what_is_missing(self, message: Event) -> str:
        """One sentence for a part that the process could not import."""
        if self.blenders_own and installation.is_installed():
            return self._broken_part(_last_line(str(message.get("details", ""))))
        return f"{str(message.get('message', '')).rstrip('.')} {self._advice.where}"

    def _broken_part(self, said: str) -> str:
        """The same for one that the zip should have brought."""
        return verification.explanation() or (
            f"a part of the add-on does not load ({said}), although all its files are there; restart "
            f"Blender, and if it happens again, {self._advice.python}"
        )

    def _why_it_died(self, child: ChildProcess) -> str:
        """One sentence for a process that ended without saying why."""
        code = child.exit_code or 0
        last = _last_line(child.last_words())
        if "No module named" in last:
            if self.blenders_own and installation.is_installed():
                return self._broken_part(last)
            return f"the Python '{self.python}' cannot capture ({last}); {self._advice.python}"
        said = f", last saying: {last}" if last else ""
        if child.hung:
            return f"the worker process closed its output and did not end{said}; {self._advice.crash}"
        kills, before, signal_name = out_of_memory_kills(), self._kills_before, _signal_name(code)
        by_system = signal_name == "SIGKILL" and kills is not None and before is not None and kills > before
        if by_system or _says_memory_ran_out(child.last_words()):
            return (
                f"memory ran out, and the worker process ended {_ending(code)}{said}; capture fewer frames "
                "at a time, or smaller pictures"
            )
        if signal_name and signal_name not in _CRASHES:
            # A system that does not count may have done it itself, for whatever reason.
            who = "from outside" if kills is not None else "from outside or by the system"
            return f"the worker process was killed {who}, by signal {signal_name}{said}; {self._advice.crash}"
        if self._hello is None and not self.blenders_own:
            return (
                f"'{self.python}' is not a Python that can capture (it ended {_ending(code)}{said}); "
                f"{self._advice.python}"
            )
        return f"the worker process ended {_ending(code)}{said}; {self._advice.crash}"


def as_error(event: Event) -> HandfitError:
    """An `error` event as the exception that it was in the worker, with its details as a note."""
    message, details = str(event.get("message") or "the request failed"), str(event.get("details") or "")
    kind = getattr(errors, str(event.get("type")), None)
    if isinstance(kind, type) and issubclass(kind, HandfitError):
        error = kind(message)
    else:
        error = WorkerError(message, details)
    if details:
        error.add_note(details)
    return error


def _last_line(words: str) -> str:
    """What a process said last; of a crash, its kind rather than the lines about where it was."""
    lines = [line.strip() for line in words.splitlines() if line.strip()]
    return next((line for line in lines if line.startswith("Fatal Python error")), lines[-1] if lines else "")


def _says_memory_ran_out(words: str) -> bool:
    """Whether that is what ended a process: an error of Python's or NumPy's, or of C++, which then aborts."""
    return "MemoryError" in _last_line(words).partition(":")[0] or "std::bad_alloc" in words


def _signal_name(code: int) -> str:
    """The signal that ended a process, by its exit code; empty where none did."""
    with contextlib.suppress(ValueError):
        return signal.Signals(-code).name if code < 0 else ""
    return f"{-code}"


def _ending(code: int) -> str:
    if code < 0:
        return f"by signal {_signal_name(code)}"
    # Windows gives what Unix calls a signal as a large number that is known in hexadecimal.
    return f"with exit code {code if code < 256 else hex(code)}"
