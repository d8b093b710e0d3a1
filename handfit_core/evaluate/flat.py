"""Detections as another program would export them: keypoints in the picture plane, without depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.detect.keypoints import Detections
from handfit_core.interchange.lift import lifted
from handfit_core.interchange.recording import LEAST_POINTS, SeenHands


@dataclass(frozen=True)
class Flat:
    """How keypoints are degraded beside the loss of their depth."""

    noise: float = 0.0
    """Standard deviation added to x and y, of the hand's size (the longer side of its keypoints' box)"""
    missing: float = 0.0
    """Share of the points that are dropped, 0..1"""


def flattened(detections: Detections, flat: Flat, seed: int = 0) -> Detections:
    """Detections of which only the keypoints' x and y are used, degraded as `flat` says, with a depth that is
    estimated as for keypoints of other programs. The sides are those that the detector found likelier."""
    rng = np.random.default_rng(seed)
    points, size = detections.keypoints_2d, detections.extent
    points = points + flat.noise * size[:, None, None] * rng.normal(size=points.shape)
    lost = rng.random(points.shape[:2]) < flat.missing
    lost[(~lost).sum(axis=1) < LEAST_POINTS] = False
    points[lost] = np.nan
    sides = detections.likely_side
    return lifted(SeenHands.of(detections.frame, sides, np.zeros_like(sides), detections.score, points))
