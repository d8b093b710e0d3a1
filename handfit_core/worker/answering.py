"""What is done for each kind of request. Nothing heavy loads before a request needs it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from handfit_core.worker.runner import OnProgress


def answer(
    message: Mapping[str, Any], should_stop: Callable[[], bool], on_progress: OnProgress
) -> dict[str, Any]:
    """Do the request of one of `protocol.JOBS`; the fields of its `done` event. Raises what it raises."""
    match message["request"]:
        case "capture":
            from handfit_core.worker import capturing

            return capturing.answer(message, should_stop, on_progress)
        case "refit":
            from handfit_core import edit

            return edit.answer(message, should_stop)
        case "probe":
            return probe(message)
        case "warm":
            from handfit_core.worker import checking

            return checking.warm(message, should_stop)
        case _:
            from handfit_core.worker import checking

            return checking.check(should_stop)


def probe(message: Mapping[str, Any]) -> dict[str, Any]:
    """Open the request's input and read nothing but its first picture. Raises OptionError and InputError."""
    from handfit_core.media.opening import open_media
    from handfit_core.options import OPTIONS
    from handfit_core.worker.capturing import source_of

    limit = OPTIONS["max_megapixels"].read(message.get("max_megapixels"))
    media = open_media(source_of(message), max_megapixels=limit)
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
