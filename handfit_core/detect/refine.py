"""Better landmarks of a hand that was found: the mean over looks at a crop about it."""

from __future__ import annotations

import numpy as np

from handfit_core.detect.agreement import SAME_HAND, mean_of, nearest
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.second_look import SecondLook
from handfit_core.detect.view import CROP_SIZE, square_about

SPAN = 2.0
"""Side of a crop in units of the hand's size"""

PASSES = 2
"""Both count: the first errs less on easy hands, the second on hard ones, where the first is cut out askew"""

# Turn in degrees, mirrored: the networks err on left and right hands differently. One crop has most
# of what more of them gain.
_CROPS = ((0, True),)


def refine(rgb: np.ndarray, hand: HandDetection, second: SecondLook) -> HandDetection:
    """The hand's mean over crops of the picture (H, W, 3) uint8 RGB, with the spread of its keypoints.

    Crops that show nothing, or another hand, are left out.
    """
    looks = [hand]
    for degrees, mirrored in _CROPS:
        view = square_about(hand, SPAN, CROP_SIZE, turn=np.radians(degrees), mirrored=mirrored)
        for found in second.passes(rgb, view, PASSES):
            again = nearest(hand, found, SAME_HAND)
            if again is not None:
                looks.append(again)
    return mean_of(looks, 1 + PASSES * len(_CROPS))
