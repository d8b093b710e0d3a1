"""Cache of the last result, from which the next one of the same drag is reached in a few steps."""

from __future__ import annotations

import numpy as np

from handfit_core.edit.hand import RefineHand
from handfit_core.hand_model.motion import HandMotion


class Recent:
    """The last result of a single frame. A drag asks many times for the same frame with a pin that has moved
    a little: the solver needs a few steps from the last result, and many from where the drag began."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] | None = None
        self._result: HandMotion | None = None

    def of(self, hand: RefineHand) -> HandMotion | None:
        """The last result, if it was of the same frame, pose and shape."""
        return self._result if self._key == _key(hand) else None

    def keep(self, hand: RefineHand, result: HandMotion) -> None:
        """Remember a result; of many frames none."""
        self._key, self._result = (_key(hand), result) if len(hand) == 1 else (None, None)


def _key(hand: RefineHand) -> tuple[object, ...]:
    arrays = [hand.betas, *hand.pose, hand.locked, hand.detections.keypoints]
    numbers = (np.asarray(a, dtype=np.float64).tobytes() for a in arrays)
    return (hand.side, hand.model, hand.intrinsics, len(hand), *numbers)
