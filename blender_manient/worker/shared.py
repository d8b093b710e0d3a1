"""The one warm worker of this Blender, made from the preferences."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from .. import preferences
from ..cache import cache_folder, remove_temporary_takes, temporary_take
from .client import Worker

__all__ = ["cache_folder", "current", "make", "stop", "temporary_take", "worker"]


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


def make() -> Worker:
    """A worker of one's own, with the preferences' settings."""
    settings = _settings()
    return Worker(settings.python, settings.threads, settings.debug)


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
    """Nothing to do: the worker starts with the first request."""


def unregister() -> None:
    """End the worker now."""
    stop()
