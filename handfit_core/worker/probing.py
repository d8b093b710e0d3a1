"""The request `probe`: what an input is, before anybody captures it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from handfit_core.media.opening import open_media
from handfit_core.options import OPTIONS
from handfit_core.worker.capturing import source_of


def answer(message: Mapping[str, Any]) -> dict[str, Any]:
    """Open the request's input and read nothing but its first picture; the fields of the `done` event.

    Raises OptionError and InputError.
    """
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
