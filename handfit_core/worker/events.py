"""What becomes of requests: their events, the errors among them, and the exceptions that these stand for."""

from __future__ import annotations

import contextlib
import logging
import sys
import traceback
from collections.abc import Callable, Iterator
from typing import Any, Final

from handfit_core import errors
from handfit_core.errors import Cancelled, HandfitError

THREAD_VARIABLES: Final = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
"""What OpenMP, MKL, OpenBLAS, torch and OpenCV look at when they load"""

Event = dict[str, Any]
"""What has become of a request: its `id`, the kind of `event`, and the fields of that kind"""

OnProgress = Callable[[str, int, int], None]
"""Takes a stage's name, how much of it is done, and how much there is"""


class WorkerError(HandfitError):
    """The process that captures could not be started, is the wrong one, or died.

    `details` has what it said last, for a bug report.
    """

    def __init__(self, message: str, details: str = "") -> None:
        super().__init__(message)
        self.details = details


@contextlib.contextmanager
def log_warnings_to(say: Callable[[str], None]) -> Iterator[None]:
    """Within, `say` gets each warning that the core logs, as one line of text."""
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: say(" ".join(record.getMessage().split()))
    log = logging.getLogger("handfit")
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


def error_fields(error: Exception) -> dict[str, str]:
    """The fields of the `error` event of a request that ended in this exception: `message` is one sentence,
    `details` the traceback, which nobody needs of a Cancelled."""
    message, kind = str(error), type(error).__name__
    details = "" if isinstance(error, Cancelled) else "".join(traceback.format_exception(error))
    if isinstance(error, ImportError):
        message = (
            f"the Python {sys.executable} lacks what capturing needs ({error}); install handfit-core's "
            "requirements into it, or choose another Python"
        )
    elif isinstance(error, MemoryError):
        message = "memory ran out; capture fewer frames at a time, or smaller pictures"
        kind = MemoryError.__name__  # NumPy has one of its own
    elif not isinstance(error, HandfitError):
        message = f"unexpected error: {type(error).__name__}: {error}; the details say where"
    return {"type": kind, "message": " ".join(message.split()), "details": details}


def as_error(event: Event) -> HandfitError:
    """An `error` event as the exception that it was in the other process, with its details as a note."""
    kind, message, details = event["type"], event["message"], event["details"]
    of_core = getattr(errors, kind, None)
    if isinstance(of_core, type) and issubclass(of_core, HandfitError):
        error = of_core(message)
    else:
        error = WorkerError(message, details)
    if details:
        error.add_note(details)
    return error
