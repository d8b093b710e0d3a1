"""The one warm worker of this Blender, and others made for it: what of them depends on Blender's settings."""

from __future__ import annotations

import sys
import time
from collections.abc import Generator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import bpy

from handfit_core.common.errors import Cancelled, HandfitError
from handfit_core.fit.solvers import SOLVERS
from handfit_core.worker.client import CHOOSE_PYTHON, Worker
from handfit_core.worker.events import Event, as_error
from handfit_core.worker.interpreter import find_python, is_current_interpreter
from handfit_core.worker.process import wait_for_killed

from ..common import installation, preferences
from . import details, properties
from .cache import remove_temporary_takes

_EXIT_WAIT_SECONDS = 3.0
"""Seconds that disabling the add-on waits for killed processes; they need a tenth of one"""


@dataclass(frozen=True)
class _Settings:
    python: str | None
    threads: int | None
    debug: bool


_worker: Worker | None = None
_worker_settings: _Settings | None = None


def worker() -> Worker:
    """Return the shared worker; its process starts with the first request, or with `start()`.

    It is another one after the preferences have changed, as soon as the old one has nothing left to do."""
    global _worker, _worker_settings
    settings = _settings()
    if _worker is None or (settings != _worker_settings and not _worker.busy):
        if _worker is not None:
            _worker.stop()
        _worker, _worker_settings = new_worker(), settings
    return _worker


def current() -> Worker | None:
    """Return the shared worker; None where it was not made yet."""
    return _worker


def detectors() -> list[str]:
    """Return the names of the detectors that the capturing Python has; none before it was started."""
    return _offered_names("detectors")


def solvers() -> list[str]:
    """Return the names of the capturing Python's solvers without the paper's experiments; none where no
    plug-in adds any."""
    names, ours = _offered_names("solvers"), SOLVERS.built_in()
    return [n for n in names if n not in ours or not ours[n].slow] if {*names} - {*ours} else []


def _offered_names(kind: str) -> list[str]:
    ready = _worker.ready if _worker is not None else None
    return ready.get(kind, []) if ready is not None else []


def new_worker(python: str | None = None) -> Worker:
    """Return a worker beside the shared one, with the preferences' settings, or with another `python`."""
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


_STAGES = {"detect": "Finding hands", "arms": "Finding arms", "fit": "Fitting", "join": "Joining views"}
"""The stages of the worker in words, by their names"""


@dataclass(frozen=True)
class Progress:
    """How far a request to the worker is, as `ask` yields it, or other work of a capture."""

    title: str
    """The words with which a text about the request begins"""
    stage: str = ""
    """The worker's own name of what it does now; empty until it says so"""
    view: int = 0
    done: float = 0
    total: float = 0
    """How many frames the stage has; 0 while unknown"""
    began: float = field(default_factory=time.monotonic)
    """The moment of `time.monotonic` at which the stage began, or the request before its first stage"""
    first: float = 0
    """The value of `done` in the first event of the stage"""
    warnings: tuple[str, ...] = ()
    offer: str = ""
    """The operator, `find_hands` or `add_hand`, that helps with the first warning"""
    request: int = 0
    """The number of the request, for `Worker.cancel` and `Worker.tell`"""
    news: tuple[Event, ...] = ()
    """Other events that have come since the last time: those of `live`"""

    @property
    def part(self) -> float:
        """Return how much of the stage is done, 0..1; 0 where nobody knows how long it takes."""
        return self.done / self.total if self.total else 0.0

    @property
    def rate(self) -> float:
        """Return the frames per second of this stage; 0 while unknown."""
        spent, frames = time.monotonic() - self.began, self.done - self.first
        return frames / spent if self.stage and frames > 0 and spent > 0.2 else 0.0

    def stage_text(self, views: int = 1) -> str:
        """Return the stage in words, of which view where there are more, and how many of its frames are
        done."""
        text = _STAGES.get(self.stage, self.title)
        if views > 1 and self.stage in ("detect", "fit"):
            text += f", view {self.view + 1}"
        return f"{text}  {self.done}/{self.total}" if self.total > 1 else text

    def __str__(self) -> str:
        """Return the title with what is done, or with the seconds so far."""
        far = f"{self.done}/{self.total}" if self.total else f"{time.monotonic() - self.began:.0f} s"
        return f"{self.title}  {far}"

    def after(self, event: Event) -> Progress:
        """Return the progress after an event of the worker."""
        if event["event"] == "warning":
            offer, text = event.get("offer", ""), event["message"]
            warnings = (text, *self.warnings) if offer else (*self.warnings, text)
            return replace(self, warnings=warnings, offer=offer or self.offer)
        if event["event"] != "progress":
            return replace(self, news=(*self.news, event))
        at = {name: event[name] for name in ("stage", "view", "done", "total")}
        if (at["stage"], at["view"]) != (self.stage, self.view):
            at |= {"began": time.monotonic(), "first": at["done"]}
        return replace(self, **at)


Asking = Generator[Progress, None, Event]
"""A request to the worker that is waited for"""


def ask(kind: str, title: str, of_worker: Worker | None = None, **fields: Any) -> Asking:
    """Send a request to the shared worker, or to `of_worker`, and wait for it: yields how far it is. Returns
    the `done` event; where it is closed, the request is cancelled. Raises HandfitError where the request
    failed; what the shared worker says of it goes into the text of details, unless the title is empty or it
    was cancelled."""
    asked, progress, request = of_worker or worker(), Progress(title), 0
    try:
        request = asked.submit(kind, **fields)
        progress = replace(progress, request=request)
        while True:
            yield progress
            yielded = progress = replace(progress, news=())
            for event in asked.events(request):
                if event["event"] not in ("done", "error"):
                    progress = progress.after(event)
                    continue
                request = 0
                if progress is not yielded:
                    yield progress
                if event["event"] == "error":
                    raise as_error(event)
                return event
    except HandfitError as error:
        if of_worker is None and title and not isinstance(error, Cancelled):
            details.write_details(title, str(error), error)
        raise
    finally:
        if request:
            asked.abandon(request)


def advance(asking: Asking) -> Event | None:
    """Go on with what `ask` waits for; return its answer, None while there is none. Raises HandfitError where
    the request failed."""
    try:
        next(asking)
    except StopIteration as stop:
        return stop.value
    return None


def _settings() -> _Settings:
    chosen = preferences.get()
    debug = bpy.app.debug or bpy.app.debug_python
    return _Settings(preferences.full_path(chosen.python) or None, chosen.threads or None, debug)


def bytecode_folder() -> Path | None:
    """Return the folder where Blender's own Python keeps what it compiles for the worker; compiling anew
    costs each start.

    Blender unpacks wheels without compiling them, and what lay beside them would be left behind when it
    removes them; so it is a folder that goes with the extension. In it whole paths are repeated, which
    Windows finds too long."""
    if sys.platform == "win32" or not installation.is_installed():
        return None
    return Path(bpy.utils.extension_path_user(preferences.ADDON, path="bytecode"))


def register() -> None:
    """Offer what the worker's plug-ins add; it starts with the first request."""
    properties.choices_of_option |= {"detector": detectors, "solver": solvers}


def unregister() -> None:
    """End the worker now, and wait until it is gone: Blender may be about to remove the files it runs."""
    stop()
    wait_for_killed(_EXIT_WAIT_SECONDS)
