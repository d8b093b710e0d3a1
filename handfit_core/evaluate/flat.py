"""Detections as another program would export them: keypoints in the picture plane, without depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.detect.keypoints import Detections
from handfit_core.interchange.lift import lifted
from handfit_core.interchange.recording import LEAST_POINTS, SeenHands


@dataclass(frozen=True)
class Flat:
    """The damage done to keypoints beside the loss of their depth."""

    noise: float = 0.0
    """Standard deviation of the noise added to x and y, in parts of the hand's size (the longer side of its
    keypoints' box)"""
    missing: float = 0.0
    """Share, 0..1, of the points that are dropped"""


def flattened(detections: Detections, flat: Flat, seed: int = 0) -> Detections:
    """Return detections of which only the keypoints' x and y are used, degraded as `flat` says, with a depth
    that is estimated as for keypoints of other programs. The sides are those that the detector found
    likelier."""
    rng = np.random.default_rng(seed)
    points, size = detections.keypoints_2d, detections.extent
    points = points + flat.noise * size[:, None, None] * rng.normal(size=points.shape)
    lost = rng.random(points.shape[:2]) < flat.missing
    lost[(~lost).sum(axis=1) < LEAST_POINTS] = False
    points[lost] = np.nan
    sides = detections.likely_side
    return lifted(SeenHands.of(detections.frame, sides, np.zeros_like(sides), detections.score, points))
