"""From keypoints in the plane to what the solver takes: depth, and what is expected of each point's error."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.interchange.recording import SeenHands, known
from handfit_core.skeleton import Side

_PLANE_SIGMA: Final = 0.03
"""of the hand's size in the picture: what a point is off that its program is sure of"""
_LEAST_CONFIDENCE: Final = 0.05
_MISSING_SIGMA: Final = 100.0
"""times the hand's size"""
_SIZE: Final = 0.1
"""metres: what the spread of a hand's keypoints is about"""


def lifted(hands: SeenHands) -> list[HandDetection]:
    """N hands, each as a detection with what is known and expected of its points.

    Every hand has some points that are seen.
    """
    sure = known(hands.keypoints)
    middle = np.nanmean(hands.keypoints, axis=1)
    pixels = np.where(sure[..., None], hands.keypoints, middle[:, None])
    away = np.where(sure[..., None], hands.keypoints - middle[:, None], 0.0)
    size = np.maximum(np.sqrt(np.square(away).sum(axis=(1, 2)) / sure.sum(axis=1)), 1e-6)
    sigma = _PLANE_SIGMA / np.sqrt(np.clip(hands.confidence, _LEAST_CONFIDENCE, 1.0))
    sigma = np.where(sure, sigma, _MISSING_SIGMA) * size[:, None]
    found = []
    for i in range(len(hands)):
        side: Side = "left" if hands.left[i] else "right"
        depth = np.zeros(pixels.shape[1]) if hands.depth is None else hands.depth[i]
        points = np.column_stack([pixels[i], depth])
        world = (points - points.mean(axis=0)) * _SIZE / size[i] if hands.world is None else hands.world[i]
        detection = HandDetection(side, float(hands.score[i]), points, world, given_side=side)
        if hands.world is None or not sure[i].all():
            table = np.column_stack(
                [pixels[i], sigma[i], sigma[i], depth, np.full_like(depth, 10.0 * size[i])]
            )
            detection = replace(
                detection,
                corrected=(side, table),
                overlapped=None if sure[i].all() else ~sure[i],
            )
        found.append(detection)
    return found
