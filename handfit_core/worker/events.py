"""The messages between Blender and its worker: JSON lines, with arrays packed into them by `arrays`.

docs/worker-protocol.md lists them. Both sides are of one version, which the first message tells, and believe
each other from then on. What becomes of a request are its events, the last of which may be an error.
"""

from __future__ import annotations

import contextlib
import json
import logging
import traceback
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from handfit_core.common import errors
from handfit_core.common.errors import Cancelled, HandfitError, ProtocolError

THREAD_VARIABLES: Final = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
"""The environment variables that OpenMP, MKL, OpenBLAS, torch and OpenCV read when they load, to know how
many threads to use"""

Event = dict[str, Any]
"""A message about what has become of a request: its `id`, the kind of `event`, and the fields of that kind"""

OnProgress = Callable[..., None]
"""Takes a stage's name, how much of it is done, how much there is, and, where there are two, the view"""


class WorkerError(HandfitError):
    """The process that captures could not be started, is the wrong one, or died.

    `details` has what it said last, for a bug report.
    """

    def __init__(self, message: str, details: str = "") -> None:
        super().__init__(message)
        self.details = details


def encode(message: Mapping[str, Any]) -> bytes:
    """Return one message as one line of JSON, its end included.

    Plain ASCII: whatever a file is called, the line is valid UTF-8 and comes back as it was. Raises
    ProtocolError for what JSON cannot hold: NaN outside a packed array, and objects.
    """
    try:
        return json.dumps(message, allow_nan=False, separators=(",", ":")).encode("ascii") + b"\n"
    except (TypeError, ValueError) as error:
        raise ProtocolError(f"a message must hold JSON's types only ({error}); pack arrays") from error


@contextlib.contextmanager
def log_warnings_to(say: Callable[[str, str], None]) -> Iterator[None]:
    """Within, `say` gets each warning that the core logs, as one line of text, and the record's `offer`: the
    name of Blender's operator that helps, or nothing."""
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: say(" ".join(record.getMessage().split()), getattr(record, "offer", ""))
    log = logging.getLogger("handfit")
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


def error_fields(error: Exception) -> dict[str, str]:
    """Return the fields of the `error` event of a request that ended in this exception: `message` is one
    sentence, `details` the traceback, which nobody needs of a Cancelled."""
    message, kind = str(error), type(error).__name__
    details = "" if isinstance(error, Cancelled) else "".join(traceback.format_exception(error))
    if isinstance(error, MemoryError):
        message = "memory ran out; capture fewer frames at a time, or smaller pictures"
        kind = MemoryError.__name__  # NumPy has one of its own
    elif not isinstance(error, HandfitError | ImportError):
        message = f"unexpected error: {type(error).__name__}: {error}; the details say where"
    return {"type": kind, "message": " ".join(message.split()), "details": details}


def as_error(event: Event) -> HandfitError:
    """Return an `error` event as the exception that it was in the other process, with its details as a
    note."""
    kind, message, details = event["type"], event["message"], event["details"]
    of_core = getattr(errors, kind, None)
    if isinstance(of_core, type) and issubclass(of_core, HandfitError):
        error = of_core(message)
    else:
        error = WorkerError(message, details)
    if details:
        error.add_note(details)
    return error
