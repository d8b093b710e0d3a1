"""Starts and talks to the process that captures: `PYTHON -m handfit_core capture`.

Capturing needs torch, MediaPipe and OpenCV, which Blender's own Python does not have and must not
be given. Standard library only; docs/batch.md lists the messages of the child.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import handfit_core
from handfit_core import errors
from handfit_core.errors import HandfitError

PYTHON_VARIABLE = "HANDFIT_PYTHON"
"""Names the Python that has torch, MediaPipe and OpenCV, when it is not the one that is running"""

_REMEDY = (
    f"give a Python that has handfit-core's requirements (torch, mediapipe, opencv) with --python or in "
    f"${PYTHON_VARIABLE}"
)
_GRACE = 5.0
"""seconds that a child gets to end by itself before it is killed"""


class WorkerError(HandfitError):
    """The process that captures could not be started, or died."""


@dataclass(frozen=True)
class CaptureOptions:
    """What a capture can be told; None and "auto" leave it to the core."""

    frames: str | None = None
    """Source frames, as in 10-200:2"""
    hands: str | None = None
    solver: str | None = None
    model: str | None = None
    threshold: float | None = None
    intrinsics: str | None = None
    """FX,FY,CX,CY in pixels"""
    landmark_model: str | None = None
    smoothing: float | None = None
    """0 takes every frame by itself"""
    plain_detection: bool = False
    debug: bool = False

    def arguments(self) -> list[str]:
        """The command line options of `python -m handfit_core capture`."""
        given = {
            "--frames": self.frames,
            "--hands": self.hands,
            "--solver": self.solver,
            "--model": self.model,
            "--threshold": self.threshold,
            "--intrinsics": self.intrinsics,
            "--landmark-model": self.landmark_model,
            "--smoothing": self.smoothing,
        }
        # One word each: a value such as "-200" would else be taken for an option.
        arguments = [f"{name}={value}" for name, value in given.items() if value is not None]
        flags = {"--plain-detection": self.plain_detection, "--debug": self.debug}
        return [*arguments, *(name for name, wanted in flags.items() if wanted)]


def find_python(python: str | None = None) -> str:
    """The interpreter to capture with: the argument, $HANDFIT_PYTHON, else the running one."""
    return python or os.environ.get(PYTHON_VARIABLE) or sys.executable


def capture_in_child(
    source: Sequence[str],
    output: Path,
    *,
    python: str | None = None,
    options: CaptureOptions | None = None,
    on_progress: Callable[[str, int, int], None] | None = None,
    on_warning: Callable[[str], None] | None = None,
    timeout: float | None = None,
) -> None:
    """Capture `source` (a path or pattern, or the pictures of one sequence) into the take `output`.

    `on_progress` gets (stage, done, total). `timeout` is in seconds. An error of the child is raised
    here as what it was there (InputError, NoHandFoundError, ...); a child that cannot start, dies or
    takes too long raises WorkerError. KeyboardInterrupt ends the child first.
    """
    python = find_python(python)
    options = options or CaptureOptions()
    command = [python, "-u", "-m", "handfit_core", "capture"]
    command += ["-o", str(output), "--progress", "json", *options.arguments(), "--", *map(str, source)]
    try:
        child = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=child_environment(),
            text=True,
            encoding="utf-8",
            errors="replace",
        )
    except OSError as error:
        raise WorkerError(f"cannot start the Python '{python}' ({error.strerror}); {_REMEDY}") from error

    overdue = threading.Event()
    last_error: dict[str, Any] | None = None
    with (
        _ended(child),
        _timer(timeout, child, overdue),
        _collected(child.stderr, options.debug) as last_lines,
    ):
        assert child.stdout is not None
        for line in child.stdout:
            event = _event(line)
            kind = event.get("event")
            if kind == "progress" and on_progress:
                on_progress(str(event.get("stage")), int(event.get("done", 0)), int(event.get("total", 0)))
            elif kind == "warning" and on_warning:
                on_warning(str(event.get("message")))
            elif kind == "error":
                last_error = event
        code = child.wait()
    if overdue.is_set():
        raise WorkerError(f"the capture took longer than {timeout:g} seconds and was stopped")
    if last_error is not None:
        raise _as_raised_there(last_error)
    if code != 0:
        raise _died(python, code, list(last_lines))


def child_environment() -> dict[str, str]:
    """The child's environment: handfit_core in reach, and nothing of Blender's own Python."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    environment["PYTHONPATH"] = str(Path(handfit_core.__file__).resolve().parents[1])
    environment["PYTHONIOENCODING"] = "utf-8"
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    return environment


def _event(line: str) -> dict[str, Any]:
    """One message of the child; what some library printed in between is no message."""
    try:
        event = json.loads(line)
    except ValueError:
        return {}
    return event if isinstance(event, dict) else {}


def _as_raised_there(event: dict[str, Any]) -> HandfitError:
    message = str(event.get("message", "the capture failed"))
    if event.get("type") in ("ModuleNotFoundError", "ImportError"):
        return WorkerError(f"{message.rstrip('.')}; {_REMEDY}")
    kind = getattr(errors, str(event.get("type")), None)
    if isinstance(kind, type) and issubclass(kind, HandfitError):
        return kind(message)
    return WorkerError(message)


def _died(python: str, code: int, last_lines: list[str]) -> WorkerError:
    """One sentence for a child that ended without saying why."""
    last = next((line.strip() for line in reversed(last_lines) if line.strip()), "")
    if "No module named" in last:
        return WorkerError(f"the Python '{python}' cannot capture ({last}); {_REMEDY}")
    how = f"with exit code {code}"
    if code < 0:
        with contextlib.suppress(ValueError):
            how = f"by signal {signal.Signals(-code).name}"
    said = f", last saying: {last}" if last else ""
    if code == -getattr(signal, "SIGKILL", 9):
        return WorkerError(
            f"the capture was ended {how}{said}; probably memory ran out: capture fewer frames at a time"
        )
    return WorkerError(f"the capture ended {how}{said}; try again with --debug, or {_REMEDY}")


@contextlib.contextmanager
def _ended(child: subprocess.Popen[str]) -> Iterator[None]:
    """Leave no child behind, whatever happens; also on Ctrl-C."""
    try:
        yield
    finally:
        if child.poll() is None:
            child.terminate()
            try:
                child.wait(_GRACE)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        for stream in (child.stdout, child.stderr):
            if stream is not None:
                stream.close()


@contextlib.contextmanager
def _timer(seconds: float | None, child: subprocess.Popen[str], overdue: threading.Event) -> Iterator[None]:
    """Kill the child when its time is up; reading its output then ends by itself."""
    if seconds is None:
        yield
        return

    def stop() -> None:
        overdue.set()
        child.kill()

    timer = threading.Timer(seconds, stop)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextlib.contextmanager
def _collected(stream: IO[str] | None, echo: bool) -> Iterator[deque[str]]:
    """Read a stream in the background, so that the child never waits for us; keep its last lines."""
    lines: deque[str] = deque(maxlen=50)

    def read() -> None:
        assert stream is not None
        for line in stream:
            lines.append(line)
            if echo:
                sys.stderr.write(line)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        yield lines
    finally:
        reader.join(_GRACE)
