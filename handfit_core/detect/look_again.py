"""Looking for a hand near where it was seen, in a frame before or after, or where one look suspected it."""

from __future__ import annotations

import numpy as np

from handfit_core.detect.agreement import AGREEMENT, largest_agreement, mean_of, nearest
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.second_look import SecondLook
from handfit_core.detect.view import CROP_SIZE, square_about

MOVED = 0.8
"""A hand is found again nearer than this to where it was seen, in units of its size."""

_CROPS = ((2.0, 45, False), (2.0, -45, True), (3.0, 45, False), (3.0, -45, True), (2.5, 0, False))
"""Side in units of the hand's size, turn in degrees, mirrored. Turned ones see many hands that upright ones
do not; the wide ones, hands of which only a part was seen before."""


def look_again(rgb: np.ndarray, seen: HandDetection, second: SecondLook) -> HandDetection | None:
    """The hand of a picture (H, W, 3) uint8 RGB near where it was `seen`, if two looks agree on it."""
    looks: list[list[HandDetection]] = []
    for span, degrees, mirrored in _CROPS:
        view = square_about(seen, span, CROP_SIZE, turn=np.radians(degrees), mirrored=mirrored)
        hand = nearest(seen, second.look(rgb, view), MOVED)
        looks.append([] if hand is None else [hand])
        group = largest_agreement(looks, AGREEMENT)
        if len(group) == 2:
            return mean_of(group, len(looks))
    return None
