"""Comparing hand detections of one picture: distance, overlap, which are of one hand, and their mean."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.batch import slices
from handfit_core.detect.keypoints import HandDetection
from handfit_core.skeleton import KEYPOINT_PARENTS, NUM_KEYPOINTS, SIDES

_PALM = [0, 5, 9, 13, 17]
_BONES = [[parent, point] for point, parent in enumerate(KEYPOINT_PARENTS) if parent >= 0]

SAME_HAND_DISTANCE = 0.25
"""`distance`, in hand sizes, below which two detections are of one hand"""

SAME_HAND_PALM_DISTANCE = 0.25
"""Distance of the palms' centres, in hand sizes, below which two detections are of one hand"""

SAME_HAND_IOU = 0.5
"""IoU of the keypoints' boxes above which two detections are of one hand"""

CHOSEN_HAND_IOU = 0.97
"""IoU with the box of a hand's keypoints above which a person's box was drawn about that very hand"""

BONE_RADIUS = 0.14
"""Hand sizes; a point nearer than this to another hand's bones lies on it, or so near that the landmark
network may take the one hand for the other"""

MIN_PART_INSIDE = 0.5
"""Share of the smaller hand's points within the other's box above which it may be a part of that hand, as
fingers are, or the same hand without its forearm"""

MAX_PART_SIZE = 0.6
"""Size of such a part, in sizes of the other hand, at most"""

_PAIRS_AT_ONCE: Final = 1 << 9
"""Pairs of hands whose points are compared together: what a processor's cache holds, and what takes no new
memory from the system each time"""


def distance(a: HandDetection, b: HandDetection, shift: np.ndarray | float = 0.0) -> float:
    """Mean distance of the keypoints in the picture, in sizes of the larger hand, with `a` shifted by (2,)
    pixels."""
    size = max(a.extent, b.extent, 1e-9)
    return float(np.mean(np.linalg.norm(a.keypoints_2d + shift - b.keypoints_2d, axis=-1))) / size


@dataclass(frozen=True, eq=False)
class HandArrays:
    """N hands as arrays in pixels, so that many pairs of them are compared at once.

    Rows (P,) are indices of hands; row i of one argument is paired with row i of the other.
    """

    points: np.ndarray
    """(N, 21, 2)"""
    box_min: np.ndarray
    """(N, 2) upper left corners of the points' boxes"""
    box_max: np.ndarray
    """(N, 2) lower right corners"""
    centroid: np.ndarray
    """(N, 2) means of the points"""
    extent: np.ndarray
    """(N,) longer sides of the boxes, as `HandDetection.extent`"""

    @classmethod
    def of(cls, hands: Sequence[HandDetection]) -> HandArrays:
        """Gather the keypoints of hands."""
        points = np.array([hand.keypoints_2d for hand in hands]).reshape(-1, NUM_KEYPOINTS, 2)
        box_min, box_max = points.min(axis=1), points.max(axis=1)
        return cls(points, box_min, box_max, points.mean(axis=1), np.max(box_max - box_min, axis=1))

    def distances(
        self,
        rows: np.ndarray,
        other: HandArrays,
        other_rows: np.ndarray,
        limit: float,
        shift: np.ndarray | float = 0.0,
    ) -> np.ndarray:
        """(P,) `distance` of these hands, each shifted by (P, 2) pixels, to those of `other`; infinite where
        it exceeds `limit`, which the centroids alone mostly tell."""
        shift = np.broadcast_to(shift, (len(rows), 2))
        size = np.maximum(np.maximum(self.extent.take(rows), other.extent.take(other_rows)), 1e-9)
        apart = _lengths(self.centroid.take(rows, axis=0) + shift - other.centroid.take(other_rows, axis=0))
        distances = np.full(len(rows), np.inf)
        # The mean of the points' distances is no less than the distance of their means.
        near = np.flatnonzero(apart <= limit * size * 1.001)
        for part in slices(len(near), _PAIRS_AT_ONCE):
            pairs = near[part]
            difference = self.points.take(rows[pairs], axis=0)
            difference += shift[pairs, None]
            difference -= other.points.take(other_rows[pairs], axis=0)
            distances[pairs] = _lengths(difference).mean(axis=-1) / size[pairs]
        return distances

    def share_within(self, rows: np.ndarray, box_rows: np.ndarray) -> np.ndarray:
        """(P,) share of a hand's points that lie within the other hand's box."""
        share = np.zeros(len(rows))
        overlapping = (self.box_min[rows] <= self.box_max[box_rows]) & (
            self.box_max[rows] >= self.box_min[box_rows]
        )
        candidates = np.flatnonzero(overlapping.all(axis=1))
        for part in slices(len(candidates), _PAIRS_AT_ONCE):
            pairs = candidates[part]
            points, boxes = self.points[rows[pairs]], box_rows[pairs]
            inside = (points >= self.box_min[boxes, None]) & (points <= self.box_max[boxes, None])
            share[pairs] = inside.all(axis=-1).mean(axis=-1)
        return share

    def covers(self, points: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """(K,) bool: which points (K, 2) lie on one of these hands (P,), within `BONE_RADIUS` of its
        bones."""
        covered = np.zeros(len(points), dtype=bool)
        for part in slices(len(rows), _PAIRS_AT_ONCE // NUM_KEYPOINTS):
            # In a dense crowd a few hands cover every point.
            free = np.flatnonzero(~covered)
            if not len(free):
                break
            bones = self.points[rows[part], None][:, :, _BONES]
            radius = BONE_RADIUS * self.extent[rows[part]]
            start, along = bones[..., 0, :], bones[..., 1, :] - bones[..., 0, :]
            offset = points[free, None] - start
            share = (offset * along).sum(axis=-1) / np.maximum(np.square(along).sum(axis=-1), 1e-9)
            nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
            near = _lengths(points[free, None] - nearest) < radius[:, None, None]
            covered[free] = near.any(axis=(0, 2))
        return covered


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """(...) Euclidean lengths of (..., 2); NumPy's norm takes several times as long."""
    return np.sqrt(np.square(vectors[..., 0]) + np.square(vectors[..., 1]))


def is_same_hand(a: HandDetection, b: HandDetection) -> bool:
    """Whether two detections are of one hand, be it once as a left and once as a right one."""
    if distance(a, b) < SAME_HAND_DISTANCE:
        return True
    apart = a.keypoints_2d[_PALM].mean(axis=0) - b.keypoints_2d[_PALM].mean(axis=0)
    if float(np.linalg.norm(apart)) < SAME_HAND_PALM_DISTANCE * max(a.extent, b.extent):
        return True
    return iou(a.keypoints_2d, b.keypoints_2d) > SAME_HAND_IOU


def is_part_of(a: HandDetection, b: HandDetection) -> bool:
    """Whether the smaller of two detections may be a part of the other's hand; the order does not matter."""
    small, large = sorted((a, b), key=lambda hand: hand.extent)
    box_min, box_max = large.keypoints_2d.min(axis=0), large.keypoints_2d.max(axis=0)
    inside = ((small.keypoints_2d >= box_min) & (small.keypoints_2d <= box_max)).all(axis=-1)
    return small.extent < MAX_PART_SIZE * large.extent and float(inside.mean()) > MIN_PART_INSIDE


def hand_of_box(hands: Iterable[HandDetection], box: Sequence[float]) -> HandDetection | None:
    """The hand about whose keypoints a box (x, y, width, height) was drawn; None: it is about none of
    them."""
    x, y, width, height = box
    corners = np.array([[x, y], [x + width, y + height]])
    overlaps = [(iou(hand.keypoints_2d, corners), hand) for hand in hands]
    best, hand = max(overlaps, key=lambda each: each[0], default=(0.0, None))
    return hand if best > CHOSEN_HAND_IOU else None


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union, 0..1, of the boxes about two sets of points (N, 2)."""
    low, high = np.maximum(a.min(axis=0), b.min(axis=0)), np.minimum(a.max(axis=0), b.max(axis=0))
    intersection = float(np.clip(high - low, 0.0, None).prod())
    areas = sum(float(np.ptp(points, axis=0).prod()) for points in (a, b))
    return intersection / max(areas - intersection, 1e-9)


def overlapped(hand: HandDetection, other: HandDetection) -> np.ndarray:
    """(21,) bool: which points of a hand lie on the other hand."""
    return HandArrays.of([other]).covers(hand.keypoints_2d, np.zeros(1, dtype=int))


def mean_detection(hands: Sequence[HandDetection]) -> HandDetection:
    """One detection from several predictions for one hand, as test-time augmentation has them.

    Keypoints and world landmarks are averaged; `keypoints_2020` over the predictions that have them. The side
    is voted for with the scores; the mean's score is what that side got per prediction, so that predictions
    of the other side lower it.
    """
    votes = {side: sum(hand.score for hand in hands if hand.side == side) for side in SIDES}
    side = max(SIDES, key=lambda s: votes[s])
    keypoints = np.array([hand.keypoints for hand in hands])
    second = [hand.keypoints_2020 for hand in hands if hand.keypoints_2020 is not None]
    return HandDetection(
        side=side,
        score=votes[side] / len(hands),
        keypoints=keypoints.mean(axis=0),
        world=np.mean([hand.world for hand in hands], axis=0),
        keypoints_2020=np.mean(second, axis=0) if second else None,
        spread=keypoints.std(axis=0) if len(hands) > 1 else None,
    )
