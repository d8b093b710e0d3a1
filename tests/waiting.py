"""Waiting for a worker without Blender."""

from __future__ import annotations

import time
from collections.abc import Callable

from handfit_core.worker.client import Worker
from handfit_core.worker.events import Event, as_error


def answered(
    worker: Worker,
    request: int,
    on_event: Callable[[Event], None] = lambda _event: None,
    timeout: float = 120.0,
) -> Event:
    """The `done` event of a request, once it has come; `on_event` gets the events before. Raises what the
    request ended in."""
    until = time.monotonic() + timeout
    while time.monotonic() < until:
        for event in worker.events(request, wait=0.05):
            if event["event"] == "done":
                return event
            if event["event"] == "error":
                raise as_error(event)
            on_event(event)
    raise TimeoutError(f"request {request} was not answered in {timeout:g} seconds")
