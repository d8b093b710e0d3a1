"""Whether a picture shows more hands than are looked for."""

from __future__ import annotations

import os
from typing import Final

import numpy as np

from handfit_core.detect.mediapipe_tasks import MediaPipeHands
from handfit_core.detect.tracks import without_duplicates

MOST: Final = 10
"""hands that are told apart"""

EVERY: Final = 25
"""Of a clip's pictures with as many hands as are looked for, every so many-th is looked at again: this
costs as much as finding hands in one more."""


class HandCounter:
    """Counts the hands of pictures in which the finder found as many as it may. Use as a context manager.

    A finder that found fewer has seen them all, so that footage of one hand costs nothing.
    """

    def __init__(
        self, *, max_hands: int, threshold: float, landmark_model: str | os.PathLike[str] | None
    ) -> None:
        self._max_hands = max_hands
        self._threshold = threshold
        self._landmark_model = landmark_model
        self._detector: MediaPipeHands | None = None
        self._full = 0
        self._counts: list[int] = []

    def __enter__(self) -> HandCounter:
        return self

    def __exit__(self, *_: object) -> None:
        if self._detector is not None:
            self._detector.close()

    def look(self, rgb: np.ndarray | None, found: int) -> None:
        """Take notice of the next picture (H, W, 3) uint8 RGB, in which `found` hands were found."""
        if rgb is None or found < self._max_hands:
            return
        if self._full % EVERY == 0:
            if self._detector is None:
                self._detector = MediaPipeHands(
                    max_hands=MOST, threshold=self._threshold, landmark_model=self._landmark_model
                )
            self._counts.append(len(without_duplicates(self._detector.detect(rgb))))
        self._full += 1

    @property
    def seen(self) -> int:
        """The most hands that were seen at once; of several pictures, in at least two, since one may show
        what only looks like a hand. 0 where no picture was full."""
        return sorted([0, *self._counts])[-min(2, max(1, len(self._counts)))]
