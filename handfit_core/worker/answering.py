"""What is done for each kind of request.

Imports inside functions keep the worker's start quick: heavy packages load when a request needs them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from handfit_core.doors.values import shortly
from handfit_core.errors import OptionError, PictureSizeError
from handfit_core.files import written_whole
from handfit_core.worker.protocol import FoundHand
from handfit_core.worker.runner import OnProgress

if TYPE_CHECKING:
    from handfit_core.pipeline import Progress

MAX_PICTURE_SIDE: Final = 4096
"""pixels a side of a picture that people look at"""


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
        case "find":
            return find(message)
        case "sheet":
            return sheet(message)
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

    source, output = _source(message), _output(message)
    flags = {name: message.get(name, False) for name in ("compact", "bare")}
    for name, flag in flags.items():
        if not isinstance(flag, bool):
            raise OptionError(f"a capture's {name} must be true or false, not {flag!r}")
    options = CaptureOptions.of_message(message.get("options") or {})
    if message.get("retimed") is not None:
        _check_retimed(source, options, message["retimed"])
    stopped = False

    def should_stop_once() -> bool:
        nonlocal stopped
        stopped = stopped or should_stop()
        return stopped

    def report(progress: Progress) -> None:
        on_progress(progress.stage, progress.done, progress.total)

    done = capture_to_file(source, output, options, report, should_stop_once, **flags)
    return {**done, "stopped": stopped}


def _check_retimed(source: Any, options: Any, rate: Any) -> None:
    """Raise what keeps a clip from being retimed to a scene's rate, before anything is detected in it."""
    if isinstance(rate, bool) or not isinstance(rate, int | float):
        raise OptionError(f"what a clip is retimed to must be frames per second, not {shortly(rate)}")
    from handfit_core.interchange.opening import open_input
    from handfit_core.media.videos import Video
    from handfit_core.retiming import check_rate, is_other_rate

    media = open_input(source, options)
    if isinstance(media, Video) and is_other_rate(rate, media.fps):
        check_rate(rate)
        media.check_steady()


def probe(message: Mapping[str, Any]) -> dict[str, Any]:
    """Open the request's input and read nothing but its first picture. Raises OptionError and InputError."""
    from handfit_core.interchange.opening import RELATIVE, open_input
    from handfit_core.options import CaptureOptions

    source, limit = _source(message), message.get("max_megapixels")
    try:
        media = open_input(source, CaptureOptions(max_megapixels=limit))
        width, height = media.width, media.height
    except PictureSizeError:
        media = open_input(source, CaptureOptions(picture_size=RELATIVE))
        width, height = 0, 0
    first, last = media.first_and_last
    return {
        "kind": media.source.kind,
        "width": width,
        "height": height,
        "fps": media.fps,
        "frames": media.expected_frames,
        "first": first,
        "last": last,
    }


def find(message: Mapping[str, Any]) -> dict[str, Any]:
    """All hands of the first used frame, and a copy of that frame for people to look at. Raises what
    `detection.find_in_frame` raises, and OutputError."""
    from handfit_core.detection import find_in_frame
    from handfit_core.options import CaptureOptions

    picture = message.get("picture")
    if picture is not None and (not isinstance(picture, str) or not picture):
        raise OptionError(f"the picture must be the path of a JPEG file to write; got {shortly(picture)}")
    frame, hands = find_in_frame(_source(message), CaptureOptions.of_message(message.get("options") or {}))
    assert frame.rgb is not None
    if picture is not None:
        _write_picture(frame.rgb, picture)
    return {
        "frame": frame.number,
        "width": frame.rgb.shape[1],
        "height": frame.rgb.shape[0],
        "hands": [
            FoundHand(
                hand.given_side or hand.likely_side,
                hand.score if hand.certainty is None else hand.certainty,
                hand.keypoints_2d,
            ).to_message()
            for hand in hands
        ],
    }


def sheet(message: Mapping[str, Any]) -> dict[str, Any]:
    """Write the contact sheet of a take. Raises OptionError, TakeError and OutputError."""
    from handfit_core.options import OPTIONS
    from handfit_core.sheet import write_sheet
    from handfit_core.take import Take

    limit = OPTIONS["max_megapixels"].read(message.get("max_megapixels"))
    take, output = message.get("take"), message.get("output")
    if not all(isinstance(path, str) and path for path in (take, output)):
        raise OptionError("a sheet needs the path of a take, and as its output the path of a JPEG file")
    return {"frames": write_sheet(Take.load(str(take)), str(output), max_megapixels=limit)}


def _write_picture(rgb: np.ndarray, path: str) -> None:
    """Write a picture (H, W, 3) as JPEG, at most `MAX_PICTURE_SIDE` pixels a side. Raises OutputError."""
    import cv2

    smaller = MAX_PICTURE_SIDE / max(rgb.shape)
    if smaller < 1.0:
        size = [max(1, round(smaller * side)) for side in rgb.shape[1::-1]]
        rgb = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    bgr = np.ascontiguousarray(rgb[..., ::-1])
    with written_whole(path) as beside:
        beside.write_bytes(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes())


def _source(message: Mapping[str, Any]) -> str | list[str]:
    """A request's `input`: a path or pattern, or the pictures of one sequence. Raises OptionError."""
    source = _paths(message, "input")
    return source[0] if len(source) == 1 else source


def _paths(message: Mapping[str, Any], name: str) -> list[str]:
    paths = message.get(name)
    if not isinstance(paths, list) or not paths or not all(isinstance(p, str) and p for p in paths):
        what = "one path or pattern, or of pictures" if name == "input" else "the paths of part files"
        raise OptionError(f"{name} must be a list of {what}; got {shortly(paths)}")
    return paths


def _output(message: Mapping[str, Any]) -> str:
    output = message.get("output")
    if not isinstance(output, str) or not output:
        raise OptionError(f"a {message['request']} needs the path of the file to write, as its output")
    return output
