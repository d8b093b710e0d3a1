"""Crashes that are made, to see what the harness makes of them."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from scenarios.capturing import part


def outside_the_addon(stage, mark: str | None = None):
    """Die of SIGFPE while none of the add-on's code runs; with a `mark`, only until that file is there."""
    yield 0.0
    if mark is None or not Path(mark).exists():
        if mark is not None:
            Path(mark).touch()
        _die()
    return "played again"


def in_the_addon(stage):
    """Die of it while the add-on's code runs."""
    yield 0.0
    part("scene.store").captured_hands(_Dying())


class _Dying:
    @property
    def objects(self):
        """What kills whoever asks for it."""
        _die()


def _die() -> None:
    os.kill(os.getpid(), signal.SIGFPE)
