"""The request `capture`: its options, the pipeline, the take's file."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from handfit_core.errors import OptionError
from handfit_core.files import check_writable
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.frame_range import FrameRange
from handfit_core.pipeline import Progress, capture, hand_summaries


def _text(value: object) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError("a text")
    return value


def _number(value: object) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise ValueError("a number")
    try:
        number = float(value)
    except OverflowError:  # JSON's whole numbers have no limit
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("a finite number")
    return number


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError("true or false")
    return value


def _camera(value: object) -> Intrinsics:
    if not isinstance(value, list) or len(value) != 4:
        raise ValueError("four numbers: fx, fy, cx, cy in pixels")
    return Intrinsics(*(_number(v) for v in value))


def _lens(value: object) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError("three numbers: focal length in picture widths, principal point x and y as parts")
    return tuple(_number(v) for v in value)


OPTIONS: Final[dict[str, tuple[str, Callable[[Any], Any]]]] = {
    "frames": ("frames", lambda value: FrameRange.parse(_text(value))),
    "hands": ("hands", _text),
    "solver": ("solver", _text),
    "model": ("model", _text),
    "threshold": ("threshold", _number),
    "intrinsics": ("intrinsics", _camera),
    "lens": ("lens", _lens),
    "smoothing": ("smoothing", _number),
    "plain_detection": ("persistent", lambda value: not _flag(value)),
    "landmark_model": ("landmark_model", _text),
    "hand_length": ("hand_length", _number),
    "max_megapixels": ("max_megapixels", _number),
}
"""Option of the request -> argument of `pipeline.capture`, and how its value is read"""


def arguments(options: object) -> dict[str, Any]:
    """A request's options -> arguments of `pipeline.capture`; null is as good as missing.

    Raises OptionError for an option that does not exist or a value of the wrong kind.
    """
    if not isinstance(options, Mapping):
        raise OptionError(f"a capture's options must be an object, not {options!r}")
    given: dict[str, Any] = {}
    for name, value in options.items():
        if name not in OPTIONS:
            raise OptionError(f"there is no option '{name}' of a capture; choose from {', '.join(OPTIONS)}")
        if value is None:
            continue
        argument, read = OPTIONS[name]
        try:
            given[argument] = read(value)
        except ValueError as error:
            raise OptionError(f"the option '{name}' must be {error}; got {value!r}") from None
    return given


def source_of(message: Mapping[str, Any]) -> str | list[str]:
    """A request's `input`: a path or pattern, or the pictures of one sequence. Raises OptionError."""
    source = message.get("input")
    if not isinstance(source, list) or not source or not all(isinstance(p, str) and p for p in source):
        raise OptionError(f"input must be a list of one path or pattern, or of pictures; got {source!r}")
    return source[0] if len(source) == 1 else source


def answer(
    message: Mapping[str, Any],
    should_stop: Callable[[], bool],
    on_progress: Callable[[str, int, int], None],
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
    options = arguments(message.get("options") or {})
    check_writable(output)
    stopped = False

    def asked() -> bool:
        nonlocal stopped
        stopped = stopped or should_stop()
        return stopped

    def report(progress: Progress) -> None:
        on_progress(progress.stage, progress.done, progress.total)

    started = time.perf_counter()
    take = capture(source, progress=report, should_stop=asked, **options)
    path = take.save(output, compact=compact)
    return {
        "output": str(path),
        "frames": len(take.frame_numbers),
        "seconds": round(time.perf_counter() - started, 3),
        "hands": hand_summaries(take),
        "stopped": stopped,
    }
