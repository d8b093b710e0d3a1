"""What is done for each kind of request. Nothing heavy loads before a request needs it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from handfit_core.errors import OptionError
from handfit_core.worker.runner import OnProgress

if TYPE_CHECKING:
    from handfit_core.pipeline import Progress


def answer(
    message: Mapping[str, Any], should_stop: Callable[[], bool], on_progress: OnProgress
) -> dict[str, Any]:
    """Do the request of one of `protocol.JOBS`; the fields of its `done` event. Raises what it raises."""
    match message["request"]:
        case "capture":
            return capture(message, should_stop, on_progress)
        case "refit":
            from handfit_core import edit

            return edit.answer(message, should_stop)
        case "probe":
            return probe(message)
        case "stretch":
            from handfit_core.detect import processes

            return processes.answer(message, should_stop, on_progress)
        case "warm":
            from handfit_core.worker import checking

            return checking.warm(message, should_stop)
        case _:
            from handfit_core.worker import checking

            return checking.check(should_stop)


def capture(
    message: Mapping[str, Any], should_stop: Callable[[], bool], on_progress: OnProgress
) -> dict[str, Any]:
    """Capture as the request says, write the take. Raises what `pipeline.capture` raises, and OutputError."""
    from handfit_core.options import CaptureOptions
    from handfit_core.pipeline import capture_to_file

    source, output = _source(message), message.get("output")
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


def probe(message: Mapping[str, Any]) -> dict[str, Any]:
    """Open the request's input and read nothing but its first picture. Raises OptionError and InputError."""
    from handfit_core.media.opening import open_media
    from handfit_core.options import OPTIONS

    limit = OPTIONS["max_megapixels"].read(message.get("max_megapixels"))
    media = open_media(_source(message), max_megapixels=limit)
    first, last = media.first_and_last
    return {
        "kind": media.source.kind,
        "width": media.width,
        "height": media.height,
        "fps": media.fps,
        "frames": media.expected_frames,
        "first": first,
        "last": last,
    }


def _source(message: Mapping[str, Any]) -> str | list[str]:
    """A request's `input`: a path or pattern, or the pictures of one sequence. Raises OptionError."""
    source = message.get("input")
    if not isinstance(source, list) or not source or not all(isinstance(p, str) and p for p in source):
        raise OptionError(f"input must be a list of one path or pattern, or of pictures; got {source!r}")
    return source[0] if len(source) == 1 else source
