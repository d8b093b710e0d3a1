"""The bodies that hands belong to: a pass over a clip's frames after its hands are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from handfit_core.detect.body import BodyTrack
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.source import Media
from handfit_core.options import CaptureOptions
from handfit_core.solvers import ShouldStop, never


def find_bodies(
    media: Media,
    numbers: Sequence[int],
    hands: Sequence[np.ndarray],
    intrinsics: Intrinsics,
    options: CaptureOptions,
    on_frame: Callable[[int], None] = lambda _: None,
    should_stop: ShouldStop = never,
) -> tuple[BodyTrack, ...]:
    """The people whom a clip's hands belong to, one track each over T frames.

    `numbers` are the source's numbers of these frames. `hands` has the keypoints (T, 21, 2) of each, pixels,
    NaN in frames without: frames without any are not looked at. A person is tracked whose wrist, of either
    side, is nearest a hand's; two hands share one where they share it in most frames.

    `on_frame` is called with the count of frames that are done, `should_stop` asked before each; frames after
    that have no body. Raises LandmarkModelError where the body networks are missing or damaged.
    """
    raise NotImplementedError
