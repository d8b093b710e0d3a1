"""The one warm worker of this Blender, made from the preferences."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from .. import preferences, verification
from ..cache import cache_folder, remove_temporary_takes, temporary_take
from ..installation import Problem
from ..wording import capitalised
from .client import Worker
from .interpreter import find_python, is_blenders_own
from .process import wait_for_killed

__all__ = ["cache_folder", "capture_sentence", "current", "make", "stop", "temporary_take", "worker"]

_LAST_WAIT = 3.0
"""seconds that disabling the add-on waits for killed processes; they need a tenth of one"""


@dataclass(frozen=True)
class _Settings:
    python: str | None
    threads: int | None
    debug: bool


_worker: Worker | None = None
_made_for: _Settings | None = None


def worker() -> Worker:
    """The shared worker; its process starts with the first request, or with `start()`.

    Another one after the preferences have changed, as soon as the old one has nothing left to do.
    """
    global _worker, _made_for
    settings = _settings()
    if _worker is None or (settings != _made_for and not _worker.busy):
        if _worker is not None:
            _worker.stop()
        _worker, _made_for = make(), settings
    return _worker


def current() -> Worker | None:
    """The shared worker if there is one already; for those who only look."""
    return _worker


def make(python: str | None = None) -> Worker:
    """A worker of one's own, with the preferences' settings, or with another `python`."""
    settings = _settings()
    return Worker(python or settings.python, settings.threads, settings.debug)


def capture_sentence(python: str | None = None) -> str:
    """Why `python`, or the Python that the preferences choose, cannot capture, as far as is known; empty
    where nothing is. For labels: with a capital, and it costs nothing."""
    problem = capture_problem(python)
    return capitalised(problem.sentence) if problem is not None else ""


def capture_problem(python: str | None = None) -> Problem | None:
    """Of which problem `capture_sentence` tells."""
    problem = verification.capture_problem()
    if problem is None or not is_blenders_own(python or find_python(_settings().python)):
        return None
    return problem


def stop() -> None:
    """End the shared worker and remove what it left in the cache folder."""
    global _worker, _made_for
    if _worker is not None:
        _worker.stop()
    _worker = _made_for = None
    remove_temporary_takes()


def _settings() -> _Settings:
    chosen = preferences.get()
    debug = bpy.app.debug or bpy.app.debug_python
    return _Settings(preferences.full_path(chosen.python) or None, chosen.threads or None, debug)


def register() -> None:
    """Say on the console why nothing can be captured; the worker starts with the first request."""
    # Without a window a Python may still be named on the command line, and captures tell what they lack.
    on_purpose = verification.problems()[:1] and verification.problems()[0].kind == "left-out"
    if (sentence := capture_sentence()) and not (bpy.app.background and on_purpose):
        verification.print_sentence(sentence)


def unregister() -> None:
    """End the worker now, and wait until it is gone: Blender may be about to remove the files it runs."""
    stop()
    wait_for_killed(_LAST_WAIT)
