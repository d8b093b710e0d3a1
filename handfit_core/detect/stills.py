"""Hands in single pictures: a plain look, a search where it finds too little, and means over crops."""

from __future__ import annotations

import os
from contextlib import ExitStack

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.mediapipe_tasks import MediaPipeHands
from handfit_core.detect.refine import refine
from handfit_core.detect.search import search
from handfit_core.detect.second_look import SecondLook


class StillFinder:
    """Finds hands in pictures that have nothing to do with each other. Use as a context manager.

    Raises LandmarkModelError when the model file is missing or damaged, OptionError for a threshold
    outside 0..1.
    """

    def __init__(
        self, *, max_hands: int, threshold: float, landmark_model: str | os.PathLike[str] | None
    ) -> None:
        self._max_hands = max_hands
        with ExitStack() as opening:
            self._plain = opening.enter_context(
                MediaPipeHands(max_hands=max_hands, threshold=threshold, landmark_model=landmark_model)
            )
            self._searching = opening.enter_context(
                SecondLook(max_hands=max_hands, landmark_model=landmark_model)
            )
            self._refining = opening.enter_context(SecondLook(max_hands=1, landmark_model=landmark_model))
            self._open = opening.pop_all()

    def __enter__(self) -> StillFinder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give MediaPipe's threads and memory back."""
        self._open.close()

    def find(self, rgb: np.ndarray) -> tuple[HandDetection, ...]:
        """The hands of one picture (H, W, 3) uint8 RGB, at most `max_hands`; none is an empty tuple."""
        hands = list(self._plain.detect(rgb))
        if len(hands) < self._max_hands:
            hands += search(rgb, self._searching, hands, self._max_hands - len(hands))
        return tuple(refine(rgb, hand, self._refining) for hand in hands)
