"""Finding the hands of a photo or of a clip's frames, with or without second looks: one door for both."""

from __future__ import annotations

import os

import numpy as np

from handfit_core.detect.clips import ClipFinder
from handfit_core.detect.correction.sides import with_side_judged
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.mediapipe_tasks import MediaPipeHands
from handfit_core.detect.stills import StillFinder


class HandFinder:
    """Finds hands in pictures. Use as a context manager.

    `video`: the pictures are the frames of one clip, in order; else they have nothing to do with each
    other. `persistent`: look again where the plain detector finds too little, and more than once at
    hands in stills.

    Raises LandmarkModelError when the model file is missing or damaged, OptionError for a threshold
    outside 0..1.
    """

    def __init__(
        self,
        *,
        max_hands: int = 2,
        video: bool = False,
        threshold: float = 0.5,
        landmark_model: str | os.PathLike[str] | None = None,
        persistent: bool = True,
    ) -> None:
        self._finder: MediaPipeHands | ClipFinder | StillFinder
        if not persistent:
            self._finder = MediaPipeHands(
                max_hands=max_hands, video=video, threshold=threshold, landmark_model=landmark_model
            )
        else:
            kind = ClipFinder if video else StillFinder
            self._finder = kind(max_hands=max_hands, threshold=threshold, landmark_model=landmark_model)

    def __enter__(self) -> HandFinder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give MediaPipe's threads and memory back."""
        self._finder.close()

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> tuple[HandDetection, ...]:
        """The hands of the next picture (H, W, 3) uint8 RGB, at `time` in seconds; None, a picture that
        could not be read, has none."""
        finder = self._finder
        if isinstance(finder, ClipFinder):
            return finder.find(rgb, time)
        if rgb is None:
            return ()
        if isinstance(finder, StillFinder):
            return tuple(with_side_judged(finder.find(rgb)))
        return finder.detect(rgb, time)

    def completed(self, found: list[tuple[HandDetection, ...]]) -> list[tuple[HandDetection, ...]]:
        """What `find` gave for all pictures so far, in order, and the hands of a clip that were found in
        them later: one that turns up is looked for in the frames before. Sides are judged here."""
        if not isinstance(self._finder, ClipFinder):
            return found
        frames = list(self._finder.frames)
        judged = iter(with_side_judged([hand for frame in frames for hand in frame]))
        return [tuple(next(judged) for _ in frame) for frame in frames]
