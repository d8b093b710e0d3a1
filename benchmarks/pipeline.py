"""The whole pipeline against detection alone, on the same input."""

from __future__ import annotations

import os
from collections.abc import Callable

from benchmarks.interleaved import Contender, Timing, interleaved
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.pipeline import capture, detect_frames

DETECTION = "detection alone"
PIPELINE = "whole pipeline"


def time_pipeline(
    source: str,
    frames: FrameRange | None,
    rounds: int,
    *,
    solver: str = "fast",
    model: str | os.PathLike[str] | None = None,
    on_round: Callable[[int], None] = lambda _: None,
) -> tuple[Timing, Timing]:
    """Time reading and detecting an input, and capturing it from the file to the take, in turn.

    Both open the input and the detector anew each time, as a user's run does. Raises HandfitError.
    """
    count = 0

    def detect(_: int) -> None:
        nonlocal count
        media = open_media(source, frames)
        numbers, _found, _ = detect_frames(
            media, lambda _: None, max_hands=2, threshold=0.5, landmark_model=None
        )
        count = len(numbers)

    detect(0)
    contenders = [
        Contender(DETECTION, detect, count),
        Contender(PIPELINE, lambda _: capture(source, model=model, solver=solver, frames=frames), count),
    ]
    detection, pipeline = interleaved(contenders, rounds, on_round)
    return detection, pipeline
