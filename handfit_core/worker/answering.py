"""The answers of the worker: what is done for each kind of request."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from handfit_core import edit
from handfit_core.capturing.detection import find_in_frame
from handfit_core.capturing.options import OPTIONS, CaptureOptions
from handfit_core.capturing.pipeline import add_arms_to_file, capture_to_file
from handfit_core.capturing.retiming import check_rate, is_other_rate
from handfit_core.capturing.sources import open_input
from handfit_core.common.arrays import pack, unpack
from handfit_core.common.errors import PictureSizeError
from handfit_core.common.files import written_whole
from handfit_core.common.skeleton import SIDES
from handfit_core.detect.keypoints import Detections
from handfit_core.interchange.opening import RELATIVE
from handfit_core.media.chessboard import measure_lens
from handfit_core.media.lenses import checked_name, save_lens
from handfit_core.take import Take
from handfit_core.take.sheet import write_sheet
from handfit_core.worker.events import OnProgress

if TYPE_CHECKING:
    from handfit_core.capturing.pipeline import Progress

MAX_PICTURE_SIDE: Final = 4096
"""The most pixels a side of a picture that people look at"""


def answer(
    message: Mapping[str, Any], should_stop: Callable[[], bool], on_progress: OnProgress
) -> dict[str, Any]:
    """Do the request of a message; returns the fields of its `done` event. Raises whatever the request's
    function raises."""
    match message["request"]:
        case "capture":
            return capture(message, should_stop, on_progress)
        case "arms":
            return arms(message, should_stop, on_progress)
        case "refit":
            return edit.answer(message, should_stop)
        case "probe":
            return probe(message)
        case "find":
            return find(message)
        case "sheet":
            return sheet(message)
        case "lens":
            return lens(message, should_stop, on_progress)
        case _:
            from handfit_core.worker import checking  # slow to load, with all that fits hands

            warm = message["request"] == "warm"
            return checking.warm(message, should_stop) if warm else checking.check(should_stop)


def capture(
    message: Mapping[str, Any], should_stop: Callable[[], bool], on_progress: OnProgress
) -> dict[str, Any]:
    """Capture as the request says, write the take. Raises what `pipeline.capture` raises, and OutputError."""
    source, retimed = _source(message), message.get("retimed")
    flags = {name: message.get(name, False) for name in ("compact", "bare")}
    options = CaptureOptions.of_message(message.get("options") or {})
    if retimed is not None:
        _check_retimed(source, options, retimed)
    stopped = False

    def should_stop_once() -> bool:
        nonlocal stopped
        stopped = stopped or should_stop()
        return stopped

    report = _reporting(on_progress)
    done = capture_to_file(source, message["output"], options, report, should_stop_once, **flags)
    return {**done, "stopped": stopped}


def arms(
    message: Mapping[str, Any], should_stop: Callable[[], bool], on_progress: OnProgress
) -> dict[str, Any]:
    """Add arms to a take's hands, write the take. Raises what `pipeline.add_arms_to_file` raises."""
    return add_arms_to_file(
        message["take"],
        message["output"],
        _reporting(on_progress),
        should_stop,
        max_megapixels=OPTIONS["max_megapixels"].read(message.get("max_megapixels")),
        compact=message.get("compact", False),
    )


def _reporting(on_progress: OnProgress) -> Callable[[Progress], None]:
    return lambda progress: on_progress(progress.stage, progress.done, progress.total, progress.view)


def _check_retimed(source: Any, options: Any, rate: float) -> None:
    """Raise what keeps a clip from being retimed to a scene's frames per second, before anything is detected
    in it."""
    media = open_input(source, options)
    if media.source.kind == "video" and is_other_rate(rate, media.fps):
        check_rate(rate)


def probe(message: Mapping[str, Any]) -> dict[str, Any]:
    """Open the request's input and read nothing but its first picture. Raises OptionError and InputError."""
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
    """Find all hands of the first used frame, those of regions beside the `known` ones, and write a copy of
    that frame for people to look at. Raises what `detection.find_in_frame` raises, and OutputError."""
    picture, options = message.get("picture"), CaptureOptions.of_message(message.get("options") or {})
    places = (np.pad(unpack(each).astype(float), [(0, 0), (0, 1)]) for each in message.get("known", ()))
    known = [Detections.hand("right", 1.0, keypoints, np.zeros_like(keypoints)) for keypoints in places]
    frame, hands = find_in_frame(_source(message), options, known)
    assert frame.rgb is not None
    if picture is not None:
        _write_picture(frame.rgb, picture)
    return {
        "frame": frame.number,
        "width": frame.rgb.shape[1],
        "height": frame.rgb.shape[0],
        "hands": [
            {
                "side": SIDES[given if given >= 0 else likely],
                "certainty": score if np.isnan(certainty) else certainty,
                "keypoints": pack(np.asarray(points, dtype=np.float32)),
            }
            for given, likely, score, certainty, points in zip(
                *(
                    each.tolist()
                    for each in (hands.given_side, hands.likely_side, hands.score, hands.certainty)
                ),
                hands.keypoints_2d,
                strict=True,
            )
        ],
    }


def sheet(message: Mapping[str, Any]) -> dict[str, Any]:
    """Write the contact sheet of a take. Raises TakeError and OutputError."""
    limit = OPTIONS["max_megapixels"].read(message.get("max_megapixels"))
    return {"frames": write_sheet(Take.load(message["take"]), message["output"], max_megapixels=limit)}


def lens(
    message: Mapping[str, Any], should_stop: Callable[[], bool], on_progress: OnProgress
) -> dict[str, Any]:
    """Measure a lens and save it by the request's name. Raises OptionError, InputError and OutputError."""
    name = checked_name(message["name"])
    measured = measure_lens(_source(message), partial(on_progress, "lens"), should_stop)
    save_lens(name, measured)
    return {"said": measured.said}


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
    """Return a request's `input`: a path or pattern, or the pictures of one sequence."""
    source = message["input"]
    return source[0] if len(source) == 1 else source
