"""Finding the hands of photos and clips with any detector, and counting those that are not looked for."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from handfit_core.detect.clips import ClipFinder
from handfit_core.detect.detector import DETECTORS, Detector, DetectorSettings
from handfit_core.detect.stills import StillFinder
from handfit_core.detect.tracks import without_duplicates
from handfit_core.options import CaptureOptions


def settings_of(options: CaptureOptions, *, video: bool = False) -> DetectorSettings:
    """What a capture with these options asks of its detector; `video`: of the frames of one clip."""
    return DetectorSettings(options.max_hands, video, options.threshold, options.landmark_model)


def open_finder(options: CaptureOptions, *, video: bool = False) -> Detector:
    """The detector that the options name, for the frames of one clip, or for stills.

    Where second looks help it, and unless `plain_detection`, it looks again where it finds too little,
    averages several looks at hands in stills, and judges sides. Raises OptionError where there is no such
    detector, LandmarkModelError.
    """
    backend, settings = DETECTORS.get(options.detector), settings_of(options, video=video)
    if options.plain_detection or not backend.second_looks:
        return backend.open(settings)
    return (ClipFinder if settings.video else StillFinder)(backend, settings)


MOST_COUNTED: Final = 10
"""Hands that a count tells apart"""

COUNTED_EVERY: Final = 25
"""Pictures of a clip, of those with as many hands as are looked for, from one count to the next: a count
costs as much as finding hands in one more picture"""


class HandCounter:
    """Counts the hands of pictures in which the finder found as many as it may. Use as a context manager.

    A finder that found fewer has seen them all, so that footage of one hand costs nothing.
    """

    def __init__(self, options: CaptureOptions) -> None:
        self._options = options
        self._counting: Detector | None = None
        self._full = 0
        self._counts: list[int] = []

    def __enter__(self) -> HandCounter:
        return self

    def __exit__(self, *_: object) -> None:
        if self._counting is not None:
            self._counting.close()

    def look(self, rgb: np.ndarray | None, found: int) -> None:
        """Take notice of the next picture (H, W, 3) uint8 RGB, in which `found` hands were found."""
        if rgb is None or found < self._options.max_hands:
            return
        if self._full % COUNTED_EVERY == 0:
            if self._counting is None:
                all_hands = replace(self._options, max_hands=MOST_COUNTED, plain_detection=True)
                self._counting = open_finder(all_hands)
            self._counts.append(len(without_duplicates(self._counting.find(rgb))))
        self._full += 1

    @property
    def seen(self) -> int:
        """The most hands that were seen at once; of several pictures, in at least two, since one may show
        what only looks like a hand. 0 where no picture was full."""
        return sorted([0, *self._counts])[-min(2, max(1, len(self._counts)))]
