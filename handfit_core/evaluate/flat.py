"""Detections as another program would tell of the same hands: keypoints in the plane, without their depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.interchange.lift import lifted
from handfit_core.interchange.recording import LEAST_POINTS, SeenHands
from handfit_core.skeleton import NUM_KEYPOINTS


@dataclass(frozen=True)
class Flat:
    """What becomes of keypoints beside the loss of their depth."""

    noise: float = 0.0
    """Standard deviation added to x and y, of the hand's size (the longer side of its keypoints' box)"""
    missing: float = 0.0
    """Of the points, those that are dropped"""


def flattened(detections: Sequence[HandDetection], flat: Flat, seed: int = 0) -> list[HandDetection]:
    """The same hands by their keypoints' x and y alone, spoilt as `flat` says, and lifted as a reader's are.
    Their sides are those that the detector held for likelier."""
    if not detections:
        return []
    rng = np.random.default_rng(seed)
    points = np.array([d.keypoints_2d for d in detections], dtype=np.float64)
    size = np.array([d.extent for d in detections])
    points = points + flat.noise * size[:, None, None] * rng.normal(size=points.shape)
    lost = rng.random(points.shape[:2]) < flat.missing
    lost[(~lost).sum(axis=1) < LEAST_POINTS] = False
    points[lost] = np.nan
    hands = SeenHands(
        row=np.arange(len(points)),
        left=np.array([d.likely_side == "left" for d in detections]),
        score=np.array([d.score for d in detections]),
        keypoints=points,
        confidence=np.ones((len(points), NUM_KEYPOINTS)),
    )
    return lifted(hands)
