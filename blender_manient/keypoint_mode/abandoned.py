"""Requests whose answers nobody waits for any more: taken from the worker, so that it is not kept busy."""

from __future__ import annotations

import bpy

from .. import shared_worker

_EVERY = 0.2
"""seconds"""

_requests: set[int] = set()


def abandon(request: int) -> None:
    """Throw the answer away when it comes."""
    _requests.add(request)
    if not bpy.app.timers.is_registered(_collect):
        bpy.app.timers.register(_collect, first_interval=_EVERY, persistent=True)


def forget() -> None:
    """Stop looking: the add-on goes."""
    _requests.clear()
    if bpy.app.timers.is_registered(_collect):
        bpy.app.timers.unregister(_collect)


def _collect() -> float | None:
    worker = shared_worker.current()
    if worker is None:
        _requests.clear()
        return None
    for event in worker.events(*_requests) if _requests else ():
        if event["event"] in ("done", "error"):
            _requests.discard(event["id"])
    # Another worker's numbers mean nothing to this one.
    return _EVERY if _requests and worker.busy else _requests.clear()
