"""Waiting for a worker, which Blender never does."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from handfit_core.worker.client import Worker
from handfit_core.worker.events import Event, as_error


def wait_for(
    worker: Worker, request: int, on_event: Callable[[Event], None] | None = None, timeout: float = 120.0
) -> Event:
    """The `done` event of a request; `on_event` gets those before. Raises the error that the request ended
    in."""
    until = time.monotonic() + timeout
    while time.monotonic() < until:
        for event in worker.events(request):
            if event["event"] == "done":
                return event
            if event["event"] == "error":
                raise as_error(event)
            if on_event:
                on_event(event)
        time.sleep(0.005)
    raise AssertionError(f"the worker did not answer within {timeout:g} seconds")


@contextmanager
def stopping(worker: Worker) -> Iterator[Worker]:
    """A worker that is stopped at the end."""
    try:
        yield worker
    finally:
        worker.stop(3.0)


def alive(worker: Worker) -> bool:
    """True if the worker's process runs."""
    return worker._child is not None and worker._child.exit_code is None


def pid_of(worker: Worker) -> int:
    """The id of the worker's process, which runs."""
    assert worker._child is not None
    return worker._child.pid


def said_by(worker: Worker) -> str:
    """What the worker's process has said last on stderr."""
    assert worker._child is not None
    return worker._child.stderr_tail()
