"""Which detection is which labelled hand, and how the camera sees it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.evaluate.labels import HandLabel
from handfit_core.geometry.camera import Intrinsics
from handfit_core.skeleton import Side

MATCH_DISTANCE = 0.5
"""A detection whose points lie farther from the labels than half the hand's size (on average) has found
something else."""


def label_pixels(hand: HandLabel, intrinsics: Intrinsics | None) -> np.ndarray:
    """(21, 2) labelled pixels; where the set has none, the 3D labels through its camera; else NaN."""
    if np.isfinite(hand.keypoints_2d).any() or intrinsics is None:
        return hand.keypoints_2d
    in_front = np.where(hand.joints_3d[:, 2:] > 0.0, hand.joints_3d, np.nan)
    return intrinsics.project(in_front)


def match(labels_2d: Sequence[np.ndarray], detections: Sequence[HandDetection]) -> list[int | None]:
    """For each labelled hand's (21, 2) pixels the index of its detection, or None for a miss.

    The assignment with the least total distance; the side plays no part, so that wrong sides are
    seen as such. Labels without any pixels can only be told by their order: they take what is left.
    """
    from scipy.optimize import linear_sum_assignment

    matched: list[int | None] = [None] * len(labels_2d)
    placed = [i for i, pixels in enumerate(labels_2d) if np.isfinite(pixels).any()]
    if placed and detections:
        cost = np.array([[_distance(labels_2d[i], d) for d in detections] for i in placed])
        # A pair too far apart costs as much as none, or one stray would push another pair apart.
        for row, column in zip(*linear_sum_assignment(np.minimum(cost, 2 * MATCH_DISTANCE)), strict=True):
            if cost[row, column] < MATCH_DISTANCE:
                matched[placed[row]] = int(column)
    left = iter(j for j in range(len(detections)) if j not in matched)
    for i in range(len(labels_2d)):
        if i not in placed:
            matched[i] = next(left, None)
    return matched


def _distance(pixels: np.ndarray, detection: HandDetection) -> float:
    """Mean distance of the labelled points in units of the hand's size."""
    known = np.isfinite(pixels).all(axis=-1)
    distance = np.linalg.norm(detection.keypoints_2d[known] - pixels[known], axis=-1).mean()
    # One labelled point has no size, and a few may lie close together: the detection's then decides.
    size = max(float(np.max(np.ptp(pixels[known], axis=0))), detection.extent, 1e-9)
    return float(distance) / size


_WRIST, _INDEX_KNUCKLE, _LITTLE_KNUCKLE = 0, 5, 17
EDGE_DEGREES = 30.0
"""The palm's plane within so many degrees of the line of sight is an edge."""


def view_of(joints_3d: np.ndarray, side: Side | None) -> str:
    """How the camera sees the palm of (21, 3) labels in its frame: `palm`, `back`, `edge` or `unknown`.

    The palm's plane is that of wrist, index knuckle and little finger's knuckle; `unknown` where one of
    them has no label or the side is not known.
    """
    wrist, index, little = joints_3d[[_WRIST, _INDEX_KNUCKLE, _LITTLE_KNUCKLE]]
    # Out of the palm, for a right hand.
    normal = np.cross(index - wrist, little - wrist)
    sight = (wrist + index + little) / 3.0
    size = np.linalg.norm(normal) * np.linalg.norm(sight)
    if side is None or not np.isfinite(size) or size == 0.0:
        return "unknown"
    towards_camera = -float(normal @ sight) / size * (1.0 if side == "right" else -1.0)
    if abs(towards_camera) < math.sin(math.radians(EDGE_DEGREES)):
        return "edge"
    return "palm" if towards_camera > 0.0 else "back"
