"""The request `capture`: its options, the pipeline, the take's file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from handfit_core.errors import OptionError
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import Progress, capture_to_file


def source_of(message: Mapping[str, Any]) -> str | list[str]:
    """A request's `input`: a path or pattern, or the pictures of one sequence. Raises OptionError."""
    source = message.get("input")
    if not isinstance(source, list) or not source or not all(isinstance(p, str) and p for p in source):
        raise OptionError(f"input must be a list of one path or pattern, or of pictures; got {source!r}")
    return source[0] if len(source) == 1 else source


def answer(
    message: Mapping[str, Any], should_stop: Callable[[], bool], on_progress: Callable[[str, int, int], None]
) -> dict[str, Any]:
    """Capture as the request says, write the take; the fields of the `done` event.

    Raises what `pipeline.capture` raises, and OutputError.
    """
    source, output = source_of(message), message.get("output")
    if not isinstance(output, str) or not output:
        raise OptionError("a capture needs the path of the take to write, as its output")
    compact = message.get("compact", False)
    if not isinstance(compact, bool):
        raise OptionError(f"a capture's compact must be true or false, not {compact!r}")
    options = CaptureOptions.of_message(message.get("options") or {})
    stopped = False

    def asked() -> bool:
        nonlocal stopped
        stopped = stopped or should_stop()
        return stopped

    def report(progress: Progress) -> None:
        on_progress(progress.stage, progress.done, progress.total)

    done = capture_to_file(source, output, options, report, asked, compact=compact)
    return {**done, "stopped": stopped}
