"""Hands in pictures that are independent of each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.detect.correction.corrected import with_side_judged
from handfit_core.detect.detector import Detector, DetectorSettings
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.matching import hand_of_box
from handfit_core.detect.networks import Networks
from handfit_core.detect.search import Search


class StillFinder(Detector):
    """Finds the hands of stills. Raises LandmarkModelError when the model file is missing or damaged."""

    def __init__(self, settings: DetectorSettings) -> None:
        self._max_hands = settings.max_hands
        self._networks = Networks(settings.landmark_model, quality=settings.quality)
        self._search = Search(self._networks, settings.threshold, plain=settings.plain)
        self._counts = [0]
        self._last = Detections.of([[]])
        """All hands of the last picture"""

    def close(self) -> None:
        """Give the networks' threads and memory back."""
        self._networks.close()

    @property
    def most_seen(self) -> int:
        """The most hands that were seen in any picture so far."""
        return max(self._counts)

    @property
    def missed(self) -> bool:
        """True if the last picture likely shows another hand beside those that were found."""
        return self._search.missed

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> Detections:  # noqa: ARG002
        """Return the hands of a picture (see `Detector`), the likeliest first, with their sides judged."""
        self._last = Detections.of([[] if rgb is None else self._search.detect_all(rgb)])
        self._counts.append(len(self._last))
        wanted = self._last.select(slice(self._max_hands))
        hands = [self._networks.with_keypoints_2020(rgb, hand) for hand in wanted if rgb is not None]
        return with_side_judged(Detections.of([hands]))

    def detect_in_box(
        self,
        rgb: np.ndarray,
        box: Sequence[float],
        side: Side | None = None,
        known: Iterable[Detections] = (),
    ) -> Detections | None:
        """Return the hand in a box of the last picture (see `Detector`), with its side judged; None where
        there is none."""
        known = [*self._last, *known]
        hand = hand_of_box(known, box) or self._search.detect_in_box(rgb, box, known)
        if hand is None:
            return None
        hand = self._networks.with_keypoints_2020(rgb, hand)
        return with_side_judged(hand).shown_by_person(side)
