"""The one warm worker of this Blender, and others made for it: what of them depends on Blender's settings."""

from __future__ import annotations

import sys
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from handfit_core.common.errors import HandfitError
from handfit_core.fit.solvers import SOLVERS
from handfit_core.worker.client import CHOOSE_PYTHON, Worker
from handfit_core.worker.events import Event, as_error
from handfit_core.worker.interpreter import find_python, is_current_interpreter
from handfit_core.worker.process import wait_for_killed

from ..common import installation, preferences
from . import details, properties
from .cache import remove_temporary_takes

_EXIT_WAIT_SECONDS = 3.0
"""seconds that disabling the add-on waits for killed processes; they need a tenth of one"""

_POLL_SECONDS = 0.2
"""seconds between two looks for answers that nobody waits for"""


@dataclass(frozen=True)
class _Settings:
    python: str | None
    threads: int | None
    debug: bool


_worker: Worker | None = None
_worker_settings: _Settings | None = None
_abandoned: set[int] = set()
"""Requests whose answers nobody waits for any more"""


def worker() -> Worker:
    """The shared worker; its process starts with the first request, or with `start()`.

    Another one after the preferences have changed, as soon as the old one has nothing left to do.
    """
    global _worker, _worker_settings
    settings = _settings()
    if _worker is None or (settings != _worker_settings and not _worker.busy):
        if _worker is not None:
            _worker.stop()
        _worker, _worker_settings = new_worker(), settings
    return _worker


def current() -> Worker | None:
    """The shared worker; None where it was not made yet."""
    return _worker


def detectors() -> list[str]:
    """The names of the detectors that the Python has which captures; none before it was started."""
    return _offered_names("detectors")


def solvers() -> list[str]:
    """The names of the capturing Python's solvers without the paper's experiments; none where no plug-in adds
    any."""
    names, ours = _offered_names("solvers"), SOLVERS.built_in()
    return [n for n in names if n not in ours or not ours[n].slow] if {*names} - {*ours} else []


def _offered_names(kind: str) -> list[str]:
    ready = _worker.ready if _worker is not None else None
    return ready.get(kind, []) if ready is not None else []


def new_worker(python: str | None = None) -> Worker:
    """A worker beside the shared one, with the preferences' settings, or with another `python`."""
    settings = _settings()
    python = python or settings.python
    advice = f"{CHOOSE_PYTHON} in the add-on's preferences"
    if installation.is_installed() and is_current_interpreter(find_python(python)):
        advice = "remove the add-on and install the zip again"
    return Worker(python, settings.threads, settings.debug, advice=advice, bytecode=bytecode_folder())


def stop() -> None:
    """End the shared worker and remove what it left in the cache folder."""
    global _worker, _worker_settings
    if _worker is not None:
        _worker.stop()
    _worker = _worker_settings = None
    remove_temporary_takes()


class Waiting(str):
    """What steps yield while another process works: how far that is."""


def ask(
    kind: str, title: str, of_worker: Worker | None = None, **fields: Any
) -> Generator[Waiting, None, Event]:
    """Send a request to the shared worker, or to `of_worker`, and wait for it: yields the title with what is
    done, or with the seconds so far. Returns the `done` event; where it is closed, the request is cancelled.
    Raises HandfitError where the request failed."""
    asked, began, progress, request = of_worker or worker(), time.monotonic(), "", 0
    try:
        request = asked.submit(kind, **fields)
        while True:
            for event in asked.events(request):
                if event["event"] == "progress" and event.get("total"):
                    progress = f"{event['done']}/{event['total']}"
                if (done := _done(event)) is not None:
                    request = 0
                    return done
            yield Waiting(f"{title}  {progress or f'{time.monotonic() - began:.0f} s'}")
    except HandfitError as error:
        if of_worker is None:
            details.write_details(title, str(error), error)
        raise
    finally:
        if request and of_worker is None:
            abandon(request)


def answer(request: int) -> Event | None:
    """The `done` event of a request to the shared worker; None while there is none. Raises HandfitError where
    the request failed."""
    return next(filter(None, map(_done, worker().events(request))), None)


def _done(event: Event) -> Event | None:
    if event["event"] == "error":
        raise as_error(event)
    return event if event["event"] == "done" else None


def abandon(request: int, *, cancel: bool = True) -> None:
    """Throw the answer to a request away when it comes, and unless that is of use later, cancel it."""
    if cancel:
        worker().cancel(request)
    _abandoned.add(request)
    if not bpy.app.timers.is_registered(_collect):
        bpy.app.timers.register(_collect, first_interval=_POLL_SECONDS, persistent=True)


def _collect() -> float | None:
    if _worker is None:
        return _abandoned.clear()
    for event in _worker.events(*_abandoned) if _abandoned else ():
        if event["event"] in ("done", "error"):
            _abandoned.discard(event["id"])
    # Another worker's numbers mean nothing to this one.
    return _POLL_SECONDS if _abandoned and _worker.busy else _abandoned.clear()


def _settings() -> _Settings:
    chosen = preferences.get()
    debug = bpy.app.debug or bpy.app.debug_python
    return _Settings(preferences.full_path(chosen.python) or None, chosen.threads or None, debug)


def bytecode_folder() -> Path | None:
    """Where Blender's own Python keeps what it compiles for the worker; compiling anew costs each start.

    Blender unpacks wheels without compiling them, and what lay beside them would be left behind when it
    removes them; so a folder that goes with the extension. In it whole paths are repeated, which Windows
    finds too long.
    """
    if sys.platform == "win32" or not installation.is_installed():
        return None
    return Path(bpy.utils.extension_path_user(preferences.ADDON, path="bytecode"))


TIMERS = (_collect,)


def register() -> None:
    """Offer what the worker's plug-ins add; it starts with the first request."""
    properties.choices_of_option |= {"detector": detectors, "solver": solvers}


def unregister() -> None:
    """End the worker now, and wait until it is gone: Blender may be about to remove the files it runs."""
    stop()
    wait_for_killed(_EXIT_WAIT_SECONDS)
