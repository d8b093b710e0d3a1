"""The request `live`: hands are followed until it is cancelled, and told of as they move."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from handfit_core.capturing.live.streaming import Calibration, Live, LiveHand, picture
from handfit_core.capturing.options import CaptureOptions, LiveOptions
from handfit_core.common.arrays import pack
from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.media.recording import ClipWriter

_PICTURE_SECONDS: Final = 0.1
"""seconds between two small pictures: a window shows them, nobody measures in them"""
_WIDEST: Final = 640
"""The greatest width in pixels of the small picture that a window shows"""


def follow(
    message: Mapping[str, Any],
    should_stop: Callable[[], bool],
    say: Callable[..., None],
    told: queue.SimpleQueue[dict[str, Any]],
) -> dict[str, Any]:
    """Follow the hands of the request's source; returns the fields of its `done` event. `say` sends an event
    with these fields; `told` has what the client says meanwhile. Raises what `Live` raises."""
    capture = CaptureOptions.of_message(message.get("options") or {})
    options = LiveOptions.of_message(message.get("live") or {}, capture=capture)
    width, mirror = message.get("picture") or 0, bool(message.get("mirror"))
    if isinstance(width, bool) or not isinstance(width, int) or not 0 <= width <= _WIDEST:
        raise OptionError(f"the live picture must be 0 to {_WIDEST} pixels wide, not {width!r}")
    began, pictured, problem = time.perf_counter(), 0.0, ""
    with Live(message["source"], options) as run:
        reader = run.reader
        while not should_stop() and not reader.ended:
            while not told.empty():
                _do(run, told.get(), say)
            if reader.problem != problem:
                problem = reader.problem
                if problem:
                    say(event="warning", message=problem)
            writer = reader.recording
            if writer is not None and writer.failed:
                writer = reader.stop_recording()
                if writer is not None and writer.frames:  # else the warning has said all
                    say(event="recorded", **_summary(writer))
                writer = None
            pose = run.next()
            if pose is None:
                continue
            calibrations, run.follower.calibrations = run.follower.calibrations, []
            for calibrated in calibrations:
                if not calibrated:
                    say(event="warning", message=_NO_OPEN_HAND)
                say(event="calibrated", hands=[_calibrated(each) for each in calibrated])
            now = time.perf_counter()
            shown = None
            if width and now - pictured >= _PICTURE_SECONDS:
                shown, pictured = pack(picture(pose, width, mirror=mirror)), now
            say(
                event="live",
                sequence=pose.sequence,
                time=pose.time,
                age=1000.0 * (time.perf_counter() - pose.time),
                fps=run.fps,
                latency=1000.0 * run.latency,
                dropped=reader.dropped,
                recorded=None if writer is None else writer.frames,
                hands=[_hand(each) for each in pose.hands],
                intrinsics=list(vars(pose.intrinsics).values()),
                size=list(pose.rgb.shape[1::-1]),
                picture=shown,
            )
        writer = reader.stop_recording()
    return {
        "seconds": round(time.perf_counter() - began, 3),
        "frames": reader.received,
        "shown": run.shown,
        "dropped": reader.dropped,
        "recording": None if writer is None else _summary(writer),
    }


_NO_OPEN_HAND: Final = (
    "no open hand was seen: hold one up, fingers straight, its palm to the camera, for a second"
)


def _do(run: Live, told: Mapping[str, Any], say: Callable[..., None]) -> None:
    """Do what the client has said to a running `Live`; what does not work is told as a warning."""
    if told["request"] == "live-calibrate":
        run.follower.calibrate()
        return
    try:
        writer = run.reader.stop_recording()
        if writer is not None:
            say(event="recorded", **_summary(writer))
        if told.get("output") is not None:
            run.reader.record(told["output"])
    except HandfitError as error:
        say(event="warning", message=str(error))


def _summary(writer: ClipWriter | None) -> dict[str, Any]:
    """Return the fields about a recording that has ended."""
    assert writer is not None
    return {
        "output": str(writer.path),
        "frames": writer.frames,
        "seconds": writer.seconds,
        "fps": writer.fps,
    }


def _hand(hand: LiveHand) -> dict[str, Any]:
    poses = ("betas", "global_orient", "hand_pose", "transl")
    arrays = {name: pack(np.asarray(getattr(hand, name), dtype=np.float64)) for name in poses}
    return {"side": hand.side, "state": hand.state, "score": hand.score, **arrays}


def _calibrated(one: Calibration) -> dict[str, Any]:
    arrays = {"betas": pack(one.betas), "hand_pose": pack(one.hand_pose)}
    return {"side": one.side, "hand_length": one.hand_length, **arrays}
