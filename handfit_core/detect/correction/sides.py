"""Which hand it is, left or right, where the detector may be wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from handfit_core.detect.correction.network import side_probability
from handfit_core.detect.keypoints import HandDetection

DETECTOR_ODDS: Final = 3.0
"""The network was trained on painted pictures, where the detector names the wrong side five times as often as
in photos: its odds for the detector's word count this many times"""


def with_side_judged(detections: Sequence[HandDetection]) -> list[HandDetection]:
    """The same detections with `right_side` filled in."""
    judged = []
    for detection, probability in zip(detections, side_probability(detections), strict=True):
        odds = DETECTOR_ODDS * probability / max(1.0 - probability, 1e-9)
        judged.append(replace(detection, right_side=float(odds / (1.0 + odds))))
    return judged
