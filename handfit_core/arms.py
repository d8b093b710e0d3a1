"""The arms of a take's hands: bodies are found in its pictures, and arms fitted to both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from handfit_core.errors import InputError
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.media.source import Media
from handfit_core.solvers import ShouldStop
from handfit_core.take import Take


def reopened(take: Take, max_megapixels: float | None = None) -> Media:
    """The pictures that the take was made from, in its frames. Raises InputError where they are gone, are
    others now, or where the take never had any."""
    source, numbers = take.source, take.frame_numbers
    if source.kind == "data":
        raise InputError(
            f"{source.name}: this take was made of another program's hands, without pictures in which arms "
            "could be found; capture the footage with --keypoints and --arms"
        )
    frames = None
    if source.kind == "video":
        step = int(numbers[1] - numbers[0]) if len(numbers) > 1 else 1
        frames = FrameRange(int(numbers[0]), int(numbers[-1]), step)
    given = source.files if source.kind == "sequence" else source.files[0]
    media = open_media(given, frames, max_megapixels=max_megapixels)
    if (media.width, media.height) != (take.width, take.height):
        raise InputError(
            f"{source.files[0]}: has {media.width}x{media.height} pixels, and the take was made of pictures "
            f"of {take.width}x{take.height}; put the former file back, or capture this one"
        )
    return media


def with_arms(take: Take, media: Media, on_frame: Callable[[int], None], should_stop: ShouldStop) -> Take:
    """The take with the arms of its hands, each of which gets one or a sentence why there is none.

    `on_frame` gets the count of frames that are done. Once it is to stop, the take comes back as it was."""
    hands = tuple(replace(hand, arm=None, no_arm="no arm: no body is in the picture") for hand in take.hands)
    return take if should_stop() else replace(take, hands=hands)
