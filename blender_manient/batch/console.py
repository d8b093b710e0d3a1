"""The streams and signals of a process that runs without a window."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from typing import NoReturn


def show_all_names() -> None:
    """Have a console that cannot show a file name escape its letters, so that no name ends a run."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


@contextlib.contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Within, Ctrl-C and SIGTERM raise KeyboardInterrupt.

    Blender keeps Ctrl-C to itself in the background; farms end jobs with SIGTERM.
    """
    before = {}
    with contextlib.suppress(ValueError):  # not in the main thread
        for number in (signal.SIGINT, signal.SIGTERM):
            before[number] = signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:  # None: Blender's own, which Python cannot put back
                signal.signal(number, handler)


@contextlib.contextmanager
def blender_silenced(debug: bool) -> Iterator[None]:
    """Keep exporters and renders from talking on stdout, where our lines belong; errors stay visible.

    With `debug` they talk on stderr.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    target = os.dup(2) if debug else os.open(os.devnull, os.O_WRONLY)
    os.dup2(target, 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
        os.close(target)


def print_error(text: str, debug: bool = False) -> None:
    """Print one line on stderr; with `debug` the traceback of the exception being handled too."""
    print(f"error: {' '.join(text.split())}", file=sys.stderr)
    if debug:
        traceback.print_exc()


def _interrupt(_number: int, _frame: object) -> NoReturn:
    raise KeyboardInterrupt
