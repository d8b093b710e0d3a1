"""The worker's loop: requests come in, events go out on one connection (docs/worker-protocol.md).

A thread reads, so that a cancel and the end of the connection are noticed at once; the work is done on the
main thread, one request at a time. Nothing heavy loads before a request needs it.
"""

from __future__ import annotations

import faulthandler
import json
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
from functools import partial
from typing import Any, BinaryIO, Final

from handfit_core.common.errors import Cancelled, OptionError, ProtocolError
from handfit_core.common.version import __version__
from handfit_core.detect.detector import DETECTORS
from handfit_core.fit.solvers import SOLVERS
from handfit_core.worker.answering import answer
from handfit_core.worker.events import THREAD_VARIABLES, OnProgress, encode, error_fields, log_warnings_to
from handfit_core.worker.process import own_streams

PROGRESS_SECONDS: Final = 0.05
"""seconds between two progress events; a stage's first and the one that completes it are always sent"""

STOP_SECONDS: Final = 1.0
"""seconds that the work gets, once nobody listens any more, to take its temporary files away"""


class _ClientGone(BaseException):
    """The client is gone. Not an Exception, so that no handler of errors on the way takes it."""


@dataclass(eq=False)
class _Job:
    number: int
    message: dict[str, Any]
    cancelled: threading.Event = field(default_factory=threading.Event)
    closed: bool = False
    """True if the job's last event was sent"""
    told: queue.SimpleQueue[dict[str, Any]] = field(default_factory=queue.SimpleQueue)
    """The messages that the client has sent to the job since it began"""


class Server:
    """Answers the requests of one client, until it closes the stream."""

    def __init__(self, requests: BinaryIO, events: BinaryIO) -> None:
        self._requests, self._events = requests, events
        self._sending = threading.Lock()
        self._jobs: dict[int, _Job] = {}
        """The jobs without a last event, by their numbers"""
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

    def warn(self, message: str, offer: str = "") -> None:
        """Tell the client of something that the current request ran into, and of the operator that helps."""
        job = self._current
        if job is not None:
            self._send(event="warning", id=job.number, message=message, offer=offer)

    # The reading thread

    def _read(self, leave: Callable[[], None] | None) -> None:
        try:
            for line in self._requests:
                self._receive(json.loads(line))
        except (OSError, _ClientGone):  # the connection broke
            pass
        except Exception:  # a defect, or no memory: the client finds what it was in our last words
            traceback.print_exc()
        finally:
            # Nobody reads any more: whatever it was, the worker must not stay.
            self._ending.set()
            self._waiting.put(None)
            if not self._finished.wait(STOP_SECONDS) and leave is not None:
                leave()

    def _receive(self, message: dict[str, Any]) -> None:
        """Take one request in. A cancel stops a job that runs, and answers for one that waits; one that has
        just ended needs nothing. What else has no number is for the job that it names."""
        if "id" not in message and message["request"] != "cancel":
            if (job := self._jobs.get(message["job"])) is not None:
                job.told.put(message)
        elif message["request"] != "cancel":
            job = self._jobs[message["id"]] = _Job(message["id"], message)
            self._waiting.put(job)
        elif (job := self._jobs.get(message["job"])) is not None:
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
        """Do a job; returns the fields of its `done` event."""

        def should_stop() -> bool:
            if self._ending.is_set():
                raise _ClientGone
            return job.cancelled.is_set()

        if job.message["request"] == "live":
            from handfit_core.worker import following  # slow to load, with all that fits hands

            say = partial(self._send, id=job.number)
            return following.follow(job.message, should_stop, say, job.told)
        return answer(job.message, should_stop, self._progress_of(job))

    def _progress_of(self, job: _Job) -> OnProgress:
        last_stage, last_time = ("", 0), 0.0

        def report(stage: str, done: int, total: int, view: int = 0) -> None:
            nonlocal last_stage, last_time
            if self._ending.is_set():
                raise _ClientGone
            now = time.monotonic()
            if (stage, view) == last_stage and now - last_time < PROGRESS_SECONDS and done != total:
                return
            last_stage, last_time = (stage, view), now
            self._send(event="progress", id=job.number, stage=stage, view=view, done=done, total=total)

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
            self._send(event="error", id=job.number, **error_fields(error))

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
    """Be the worker on the connection that this process has inherited; never returns.

    `threads`: how many OpenBLAS, OpenMP, torch and OpenCV use at most; none of them may have loaded, but for
    NumPy's own OpenBLAS, which has one. Raises OptionError if it is below 1.
    """
    if threads is not None and threads < 1:
        raise OptionError(f"a worker needs at least 1 thread, not {threads}")
    # Ctrl-C in the terminal that Blender was started from is Blender's; the worker ends with its connection.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests, events = own_streams()
    faulthandler.enable(sys.stderr)
    if threads is not None:
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(threads)))

    def leave() -> None:
        sys.stderr.flush()
        # Not sys.exit: torch's and MediaPipe's threads would be waited for.
        os._exit(0)

    Server(requests, events).run(leave=leave)
    leave()
