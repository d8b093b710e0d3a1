"""Detections as another program would tell of the same hands: keypoints in the plane, without their depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.detect.keypoints import Detections
from handfit_core.interchange.lift import lifted
from handfit_core.interchange.recording import LEAST_POINTS, SeenHands


@dataclass(frozen=True)
class Flat:
    """What becomes of keypoints beside the loss of their depth."""

    noise: float = 0.0
    """Standard deviation added to x and y, of the hand's size (the longer side of its keypoints' box)"""
    missing: float = 0.0
    """Of the points, those that are dropped"""


def flattened(detections: Detections, flat: Flat, seed: int = 0) -> Detections:
    """Detections with their keypoints' x and y alone, spoilt as `flat` says, and lifted as a reader's are.
    Their sides are those that the detector held for likelier."""
    rng = np.random.default_rng(seed)
    points, size = detections.keypoints_2d, detections.extent
    points = points + flat.noise * size[:, None, None] * rng.normal(size=points.shape)
    lost = rng.random(points.shape[:2]) < flat.missing
    lost[(~lost).sum(axis=1) < LEAST_POINTS] = False
    points[lost] = np.nan
    sides = detections.likely_side
    return lifted(SeenHands.of(detections.frame, sides, np.zeros_like(sides), detections.score, points))
