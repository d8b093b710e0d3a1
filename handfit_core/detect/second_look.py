"""A hand detector for views that the plain one finds nothing in: lower thresholds, and landmarks that are
found again from where they were."""

from __future__ import annotations

import os
from types import TracebackType

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.mediapipe_tasks import MediaPipeHands
from handfit_core.detect.view import View

THRESHOLD = 0.15
"""Far lower than for a first look. One look is therefore never believed: two must agree."""

PASSES = 3
"""How often the landmark network sees a view, each time cut out and turned by its own last landmarks. On
rendered hands that the plain detector misses, the third has a tenth less PA-MPJPE than the first."""

_BLANK = np.full((64, 64, 3), 128, dtype=np.uint8)
_MOST_BLANKS = 3


class SecondLook:
    """Looks at views of pictures, each by itself. Use as a context manager.

    MediaPipe's following of a hand over a video does the passes: the same view is shown several times,
    after blank pictures in which it loses what it followed before.

    Raises LandmarkModelError when the model file is missing or damaged.
    """

    def __init__(
        self, *, max_hands: int, landmark_model: str | os.PathLike[str] | None, threshold: float = THRESHOLD
    ) -> None:
        self._hands = MediaPipeHands(
            max_hands=max_hands, video=True, threshold=threshold, landmark_model=landmark_model
        )

    def __enter__(self) -> SecondLook:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give MediaPipe's threads and memory back."""
        self._hands.close()

    def look(self, rgb: np.ndarray, view: View) -> tuple[HandDetection, ...]:
        """The hands of a picture (H, W, 3) uint8 RGB that `view` shows, in the picture's pixels, after
        all passes."""
        passes = self.passes(rgb, view, PASSES)
        return passes[-1] if len(passes) == PASSES else ()

    def passes(self, rgb: np.ndarray, view: View, count: int) -> list[tuple[HandDetection, ...]]:
        """What each of `count` passes found; the first that finds nothing is the last."""
        for _ in range(_MOST_BLANKS):
            if not self._hands.detect(_BLANK):
                break
        shown = view.render(rgb)
        passes: list[tuple[HandDetection, ...]] = []
        while len(passes) < count and (found := self._hands.detect(shown)):
            passes.append(tuple(view.to_picture(hand) for hand in found))
        return passes
