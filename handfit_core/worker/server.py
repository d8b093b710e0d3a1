"""The worker's loop: requests come in on stdin, events go out on stdout (docs/worker-protocol.md).

A thread reads, so that a cancel and the end of stdin are noticed at once; the work is done on the main
thread, one request at a time. Nothing heavy loads before a request needs it.
"""

from __future__ import annotations

import faulthandler
import os
import platform
import queue
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, BinaryIO, Final

from handfit_core.detect.detector import DETECTORS
from handfit_core.doors.values import shortly
from handfit_core.errors import Cancelled, OptionError, ProtocolError
from handfit_core.solvers import SOLVERS
from handfit_core.version import __version__
from handfit_core.worker.answering import answer
from handfit_core.worker.protocol import JOBS, LONGEST_REQUEST, PROTOCOL, REQUESTS, check_id, decode, encode
from handfit_core.worker.runner import THREAD_VARIABLES, OnProgress, error_fields, log_warnings_to

PROGRESS_SECONDS: Final = 0.05
"""seconds between two progress events; a stage's first and the one that completes it are always sent"""

STOP_SECONDS: Final = 1.0
"""seconds that the work gets, once nobody listens any more, to take its temporary files away"""


class _ClientGone(BaseException):
    """The client is gone. Not an Exception, so that no handler of errors on the way takes it."""


@dataclass(eq=False)
class _Job:
    number: int
    kind: str
    message: dict[str, Any]
    cancelled: threading.Event = field(default_factory=threading.Event)
    closed: bool = False
    """Whether its last event was sent"""


class Server:
    """Answers the requests of one client, until it says `end` or closes the stream."""

    def __init__(self, requests: BinaryIO, events: BinaryIO) -> None:
        self._requests, self._events = requests, events
        self._sending = threading.Lock()
        self._jobs: dict[int, _Job] = {}
        """the jobs without a last event, by their numbers"""
        self._waiting: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._current: _Job | None = None
        self._ending = threading.Event()
        self._finished = threading.Event()

    def run(self, *, leave: Callable[[], None] | None = None) -> None:
        """Say `ready`, then work until the client is done. `leave` is called from another thread when the
        work does not stop `STOP_SECONDS` seconds after that."""
        try:
            self._send(
                event="ready",
                protocol=PROTOCOL,
                version=__version__,
                pid=os.getpid(),
                python=platform.python_version(),
                detectors=DETECTORS.offered(),
                solvers=SOLVERS.offered(),
            )
            threading.Thread(target=self._read, args=(leave,), daemon=True).start()
            with log_warnings_to(self.warn):
                while (job := self._waiting.get()) is not None:
                    self._do(job)
        except _ClientGone:
            pass
        finally:
            self._finished.set()

    def warn(self, message: str) -> None:
        """Tell the client of something that the current request ran into."""
        job = self._current
        if job is not None:
            self._send(event="warning", id=job.number, message=message)

    # The reading thread

    def _read(self, leave: Callable[[], None] | None) -> None:
        try:
            while line := self._requests.readline(LONGEST_REQUEST):
                if len(line) == LONGEST_REQUEST and not line.endswith(b"\n"):
                    del line
                    self._skip_line()
                elif line.strip() and not self._receive(line):
                    break
        except (OSError, ValueError, _ClientGone):  # the pipe broke
            pass
        except Exception:  # a defect, or no memory: the client finds what it was in our last words
            traceback.print_exc()
        finally:
            # Nobody reads any more: whatever it was, the worker must not stay.
            self._ending.set()
            self._waiting.put(None)
            if not self._finished.wait(STOP_SECONDS) and leave is not None:
                leave()

    def _skip_line(self) -> None:
        """Read on to the end of a line that is too long, and say so."""
        while (rest := self._requests.readline(1 << 20)) and not rest.endswith(b"\n"):
            pass
        message = f"a line of more than {LONGEST_REQUEST} bytes came; send fewer frames at a time"
        self._send(event="error", id=None, type=ProtocolError.__name__, message=message, details="")

    def _receive(self, line: bytes) -> bool:
        """Take one request in; False for the last one."""
        number: int | None = None
        try:
            message = decode(line)
            kind = message.get("request")
            if kind == "end":
                return False
            if kind == "cancel":
                self._cancel(check_id(message, "job"))
                return True
            number = check_id(message)
            if kind not in JOBS:
                raise ProtocolError(f"there is no request {shortly(kind)}; known are {', '.join(REQUESTS)}")
            if number in self._jobs:
                number = None  # the open request of that id must not seem to have failed
                raise ProtocolError(f"a request with the id {message['id']} is still open; use a new id")
        except ProtocolError as error:
            self._send(event="error", id=number, type="ProtocolError", message=str(error), details="")
            return True
        job = self._jobs[number] = _Job(number, kind, message)
        self._waiting.put(job)
        return True

    def _cancel(self, number: int) -> None:
        """Stop a job that runs; answer for one that waits. One that has just ended needs nothing."""
        job = self._jobs.get(number)
        if job is None:
            return
        job.cancelled.set()
        if job is not self._current:
            self._close(job, "error", **error_fields(Cancelled("cancelled before it was begun")))

    # The main thread

    def _do(self, job: _Job) -> None:
        # In this order: a cancel that comes in between is either seen here or by the job itself.
        self._current = job
        try:
            if self._ending.is_set():
                raise _ClientGone
            if job.cancelled.is_set():
                raise Cancelled("cancelled before it was begun")
            done = self._answer(job)
        except Exception as error:
            self._close(job, "error", **error_fields(error))
        else:
            self._close(job, "done", **done)
        finally:
            self._current = None

    def _answer(self, job: _Job) -> dict[str, Any]:
        """The fields of the job's `done` event."""

        def should_stop() -> bool:
            if self._ending.is_set():
                raise _ClientGone
            return job.cancelled.is_set()

        return answer(job.message, should_stop, self._progress_of(job))

    def _progress_of(self, job: _Job) -> OnProgress:
        last_stage, last_time = "", 0.0

        def report(stage: str, done: int, total: int) -> None:
            nonlocal last_stage, last_time
            if self._ending.is_set():
                raise _ClientGone
            now = time.monotonic()
            if stage == last_stage and now - last_time < PROGRESS_SECONDS and done != total:
                return
            last_stage, last_time = stage, now
            self._send(event="progress", id=job.number, stage=stage, done=done, total=total)

        return report

    # Called from both threads

    def _close(self, job: _Job, event: str, **fields: Any) -> None:
        """Send a job's last event, if it has had none."""
        with self._sending:
            if job.closed:
                return
            job.closed = True
            self._jobs.pop(job.number, None)
        try:
            self._send(event=event, id=job.number, **fields)
        except ProtocolError as error:  # a defect of ours; the client must still get an answer
            fields = error_fields(error)
            self._send(event="error", id=job.number, **fields)

    def _send(self, **event: Any) -> None:
        line = encode(event)
        try:
            with self._sending:
                self._events.write(line)
                self._events.flush()
        except (OSError, ValueError):  # closed by the other side
            self._ending.set()
            raise _ClientGone from None


def serve(threads: int | None = None) -> None:
    """Be the worker on this process's stdin and stdout; never returns.

    `threads`: how many OpenBLAS, OpenMP, torch and OpenCV use at most; none of them may have loaded, but for
    NumPy's own OpenBLAS, which has one. Raises OptionError if it is below 1.
    """
    if threads is not None and threads < 1:
        raise OptionError(f"a worker needs at least 1 thread, not {threads}")
    # Ctrl-C in the terminal that Blender was started from is Blender's; the worker ends with its stdin.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests, events = _own_streams()
    faulthandler.enable(sys.stderr)
    if threads is not None:
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(threads)))

    def leave() -> None:
        sys.stderr.flush()
        # Not sys.exit: torch's and MediaPipe's threads would be waited for.
        os._exit(0)

    Server(requests, events).run(leave=leave)
    leave()


def _own_streams() -> tuple[BinaryIO, BinaryIO]:
    """stdin and stdout for the protocol alone.

    What a library prints goes to stderr. Descriptor 0 gets an empty file: on Windows a library that asks
    about stdin while it loads would wait for the thread that reads there.
    """
    sys.stdout.flush()
    requests = os.fdopen(os.dup(0), "rb")
    events = os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return requests, events
