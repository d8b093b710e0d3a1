"""Check Installation: versions, files and a self-test as a text for bug reports."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import bpy

from handfit_core.common.errors import HandfitError
from handfit_core.worker.client import Worker
from handfit_core.worker.events import Event
from handfit_core.worker.interpreter import PYTHON_VARIABLE, find_python

from ..common import installation, preferences, screen
from ..common.wording import capitalised
from ..session import cache, details, shared_worker
from . import housekeeping
from .base import InternalOperator, ModalOperator

TEXT_NAME = "Hand Capture Check"

_LIMIT = 180.0
"""seconds; the first start of MediaPipe from a slow disk takes one or two dozen"""


@dataclass(frozen=True)
class Result:
    """What the last check came to."""

    ok: bool
    sentence: str
    chosen: str
    """The Python that was chosen in the preferences then"""


_last: Result | None = None
_checking: _Check | None = None
"""The check that runs beside the window's work"""


def last_result() -> Result | None:
    """The last check of this session; None before the first, when its text is gone, and where another Python
    was chosen since. For drawing."""
    if _last is None or _last.chosen != preferences.get().python or details.local_text(TEXT_NAME) is None:
        return None
    return _last


def running() -> bool:
    """Whether a check is under way."""
    return _checking is not None


class MANIENT_OT_check_installation(ModalOperator, bpy.types.Operator):
    """Start the Python that captures, try its detector and solver, and write versions and results into a text
    that can be copied into a bug report."""

    bl_label = "Check Installation"
    bl_options = InternalOperator.bl_options
    tick = 0.05

    @classmethod
    def poll_reason(cls, context):
        return "The check is running: Esc stops it" if running() else None

    def begin(self, context):
        """Check beside the window's work."""
        global _checking
        self._check = _checking = _Check(None)
        self.show_status(context, "Checking the installation of Hand Capture   Esc: Stop")
        screen.redraw("PREFERENCES")

    def follow(self, context, event):
        if event.type == "ESC" and event.value == "PRESS":
            self.end(context)
            return self._nothing_done("The check was stopped")
        if event.type != "TIMER" or not self._check.look():
            return {"PASS_THROUGH"}
        self.end(context)
        return self._show(*self._check.outcome())

    def ended(self, context):
        global _checking
        _checking = None
        self._check.worker.stop()
        screen.redraw("PREFERENCES")

    def run(self, context):
        """Check and wait for it: for scripts, and without a window."""
        return self._show(*check())

    def _show(self, result: Result, text: str) -> set[str]:
        global _last
        _last = result
        details.write_text(TEXT_NAME, text)
        screen.redraw("PREFERENCES")
        return self._done(f"{result.sentence} (text {TEXT_NAME})", kind="INFO" if result.ok else "WARNING")


class _Check:
    """A check that is under way, in a process of its own: the shared one may be busy for minutes, and may be
    what is wrong."""

    def __init__(self, python: str | None) -> None:
        """Begin. `python` captures instead of the one that the preferences choose."""
        installation.note(installation.examine(Path(bpy.utils.user_resource("EXTENSIONS"))))
        self.worker = shared_worker.new_worker(python)
        self._answer: Event | None = None
        self._problem = ""
        try:
            self._request = self.worker.submit("check")
        except HandfitError as error:
            self._problem = str(error)

    def look(self, *, wait: bool = False) -> bool:
        """Look for news, or wait for the end; whether it is over."""
        if self._answer is None and not self._problem:
            try:
                if wait:
                    self._answer = self.worker.wait(self._request, timeout=_LIMIT)
                else:
                    self._answer = shared_worker.answer(self._request, self.worker)
            except HandfitError as error:
                self._problem = str(error)
        return self._answer is not None or bool(self._problem)

    def outcome(self) -> tuple[Result, str]:
        """What it came to, and the text for a bug report."""
        missing = shared_worker.capture_sentence(self.worker.python)
        ok = self._answer is not None and self._answer["ok"] and not missing
        if missing:
            sentence = missing
        elif self._answer is None:
            sentence = capitalised(self._problem)
        elif ok:
            sentence = "Everything that a capture needs is there and works"
        else:
            sentence = "Something that a capture needs is missing or fails: the text tells what"
        said = f"The process that captures said:\n{self.worker.details() or '(nothing)'}"
        parts = [
            "Hand Capture Check",
            sentence,
            installation.report(),
            details.system_text(),
            _settings_text(self.worker),
            said if self._answer is None else self._answer["report"],
        ]
        other = shared_worker.current()
        if other is not None and not other.alive and other.details():
            parts.append(f"The process of the last capture said:\n{other.details()}")
        text, home = "\n\n".join(parts) + "\n", str(Path.home())
        # A bug report need not tell the user's name.
        text = text.replace(home, "~") if len(home) > 1 else text
        return Result(ok, sentence, preferences.get().python), text


def check(python: str | None = None) -> tuple[Result, str]:
    """Check and wait for it. Returns what it came to, and the text for a bug report; raises nothing.

    `python` captures instead of the one that the preferences choose.
    """
    under_way = _Check(python)
    try:
        under_way.look(wait=True)
    finally:
        under_way.worker.stop()
    return under_way.outcome()


def _settings_text(worker: Worker) -> str:
    chosen = preferences.get()
    if worker.python != find_python(preferences.full_path(chosen.python) or None):
        origin = "command line"
    elif chosen.python:
        origin = "preferences"
    elif os.environ.get(PYTHON_VARIABLE):
        origin = f"${PYTHON_VARIABLE}"
    else:
        origin = "Blender's own"
    lines = [
        f"Python that captures: {worker.python} ({origin})",
        f"Threads: {chosen.threads or 'automatic'}",
        f"Cache folder: {cache.folder_path()} ({cache.measure(cache.folder_path()) / 1e6:.1f} MB)",
        f"MANO files: {chosen.mano_folder or 'none chosen'}",
    ]
    if chosen.mano_folder:
        lines += [f"  {result.sentence}" for result in housekeeping.check(chosen.mano_folder)]
    return "\n".join(lines)


def unregister() -> None:
    """End the check's process and forget the last check."""
    global _last, _checking
    if _checking is not None:
        _checking.worker.stop()
    _last = _checking = None
