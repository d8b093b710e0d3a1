"""Compares hand detections of one picture: their distance and overlap, which of them are of one hand, and the
mean of those."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.batch import slices
from handfit_core.common.skeleton import KEYPOINT_PARENTS, NUM_KEYPOINTS, SIDES
from handfit_core.detect.keypoints import Detections

_PALM = [0, 5, 9, 13, 17]
_BONES = [[parent, point] for point, parent in enumerate(KEYPOINT_PARENTS) if parent >= 0]


@dataclass(frozen=True)
class MatchingSettings:
    """When two detections of one picture are of one hand, or touch. Lengths are in hand sizes."""

    same_hand_distance: float = 0.25
    """`distance` below which two detections are of one hand"""
    same_hand_palm_distance: float = 0.25
    """Distance of the palms' centres below which two detections are of one hand"""
    same_hand_iou: float = 0.5
    """IoU of the keypoints' boxes above which two detections are of one hand"""
    chosen_hand_iou: float = 0.97
    """IoU with the box of a hand's keypoints above which a person's box was drawn about that very hand"""
    bone_radius: float = 0.14
    """Distance from another hand's bones below which a point lies on that hand, or so near that the landmark
    network may take the one hand for the other"""
    min_part_inside: float = 0.5
    """Share of the smaller hand's points within the larger one's box above which it may be a part of that
    hand, as fingers are, or the same hand without its forearm"""
    max_part_size: float = 0.6
    """Largest size of a detection that may be a part of another hand, in sizes of that hand"""
    pairs_at_once: int = 1 << 9
    """Number of pairs of hands whose points are compared together: what a processor's cache holds, and what
    takes no new memory from the system each time"""


MATCHING: Final = MatchingSettings()


def distance(hand: Detections, others: Detections) -> np.ndarray:
    """Return (N,) the mean distance of the keypoints in the picture from one hand to each of N others, in
    sizes of the larger hand of each pair."""
    size = np.maximum(np.maximum(hand.extent, others.extent), 1e-9)
    apart = np.linalg.norm(hand.keypoints_2d - others.keypoints_2d, axis=-1)
    return np.asarray(apart.mean(axis=-1) / size)


def distances(
    hands: Detections,
    rows: np.ndarray,
    other_rows: np.ndarray,
    limit: float,
    shift: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Return (P,) the `distance` between P pairs of hands, those in `rows` (P,), shifted by (P, 2) pixels,
    and those in `other_rows` (P,); infinite where it exceeds `limit`, which the centroids alone mostly
    tell."""
    shift = np.broadcast_to(shift, (len(rows), 2))
    size = np.maximum(np.maximum(hands.extent[rows], hands.extent[other_rows]), 1e-9)
    apart = _lengths(hands.centroid[rows] + shift - hands.centroid[other_rows])
    found = np.full(len(rows), np.inf)
    # The mean of the points' distances is no less than the distance of their means.
    near = np.flatnonzero(apart <= limit * size * 1.001)
    for part in slices(len(near), MATCHING.pairs_at_once):
        pairs = near[part]
        difference = hands.keypoints_2d[rows[pairs]] + shift[pairs, None]
        difference -= hands.keypoints_2d[other_rows[pairs]]
        found[pairs] = _lengths(difference).mean(axis=-1) / size[pairs]
    return found


def share_within(hands: Detections, rows: np.ndarray, box_rows: np.ndarray) -> np.ndarray:
    """Return (P,) for P pairs of hands the share, 0..1, of the points of the hand in `rows` (P,) that lie
    within the box of the hand in `box_rows` (P,)."""
    share = np.zeros(len(rows))
    low, high = hands.box_min, hands.box_max
    overlapping = (low[rows] <= high[box_rows]) & (high[rows] >= low[box_rows])
    candidates = np.flatnonzero(overlapping.all(axis=1))
    for part in slices(len(candidates), MATCHING.pairs_at_once):
        pairs = candidates[part]
        points, boxes = hands.keypoints_2d[rows[pairs]], box_rows[pairs]
        inside = (points >= low[boxes, None]) & (points <= high[boxes, None])
        share[pairs] = inside.all(axis=-1).mean(axis=-1)
    return share


def covers(hands: Detections, rows: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (K,) bool: True for the points (K, 2), in pixels, that lie on one of the hands in `rows` (P,),
    within `MatchingSettings.bone_radius` of its bones."""
    covered = np.zeros(len(points), dtype=bool)
    for part in slices(len(rows), MATCHING.pairs_at_once // NUM_KEYPOINTS):
        # In a dense crowd a few hands cover every point.
        free = np.flatnonzero(~covered)
        if not len(free):
            break
        bones = hands.keypoints_2d[rows[part]][:, None, _BONES]
        radius = MATCHING.bone_radius * hands.extent[rows[part]]
        start, along = bones[..., 0, :], bones[..., 1, :] - bones[..., 0, :]
        offset = points[free, None] - start
        share = (offset * along).sum(axis=-1) / np.maximum(np.square(along).sum(axis=-1), 1e-9)
        nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
        near = _lengths(points[free, None] - nearest) < radius[:, None, None]
        covered[free] = near.any(axis=(0, 2))
    return covered


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the (...) Euclidean lengths of vectors (..., 2); NumPy's norm takes several times as long."""
    return np.sqrt(np.square(vectors[..., 0]) + np.square(vectors[..., 1]))


def is_same_hand(hand: Detections, others: Detections) -> np.ndarray:
    """Return (N,) bool: True for those of N detections that are of the same hand as one detection, even where
    one names it left and the other right."""
    size = np.maximum(hand.extent, others.extent)
    palms = [each.keypoints_2d[:, _PALM].mean(axis=1) for each in (hand, others)]
    return np.asarray(
        (distance(hand, others) < MATCHING.same_hand_distance)
        | (np.linalg.norm(palms[0] - palms[1], axis=-1) < MATCHING.same_hand_palm_distance * size)
        | (iou(hand.keypoints_2d, others.keypoints_2d) > MATCHING.same_hand_iou)
    )


def overlaps(hand: Detections, others: Detections) -> bool:
    """Return True if all of a hand lies where another one is: hands that cross share a place, but not with
    all their points."""
    return bool((distance(hand, others) < MATCHING.same_hand_distance).any())


def is_part_of(one: Detections, other: Detections) -> bool:
    """Return True if the smaller of two hands may be a part of the larger; the order of the arguments does
    not matter."""
    small, large = sorted((one, other), key=lambda hand: hand.extent[0])
    row = np.zeros(1, dtype=int)
    return bool(
        small.extent[0] < MATCHING.max_part_size * large.extent[0]
        and share_within(Detections.of([[small, large]]), row, row + 1)[0] > MATCHING.min_part_inside
    )


def hand_of_box(hands: Sequence[Detections], box: Sequence[float]) -> Detections | None:
    """Return the one of these hands about whose keypoints a box (x, y, width, height), pixels, was drawn;
    None where it is about none of them."""
    x, y, width, height = box
    shares = iou(np.array([[[x, y], [x + width, y + height]]]), Detections.of([hands]).keypoints_2d)
    return hands[int(shares.argmax())] if shares.max(initial=0.0) > MATCHING.chosen_hand_iou else None


def iou(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (N,) the intersection over union, 0..1, of the boxes about two sets of points, (N, K, 2) or (1,
    K, 2)."""
    low = np.maximum(a.min(axis=1), b.min(axis=1))
    high = np.minimum(a.max(axis=1), b.max(axis=1))
    intersection = np.clip(high - low, 0.0, None).prod(axis=-1)
    areas = sum(np.ptp(points, axis=1).prod(axis=-1) for points in (a, b))
    return np.asarray(intersection / np.maximum(areas - intersection, 1e-9))


def mean_detection(hands: Detections) -> Detections:
    """Average several predictions for one hand, as test-time augmentation gives them.

    Keypoints and world landmarks are averaged; `keypoints_2020` over the predictions that have them. The side
    is voted for with the scores; the mean's score is what that side got per prediction, so that predictions
    of the other side lower it.
    """
    votes = [hands.score[hands.side == side].sum() for side in range(len(SIDES))]
    side, asked = int(np.argmax(votes)), hands.asked_2020
    return Detections.hand(
        SIDES[side],
        votes[side] / len(hands),
        hands.keypoints.mean(axis=0),
        hands.world.mean(axis=0),
        keypoints_2020=hands.keypoints_2020[asked].mean(axis=0)
        if hands.keypoints_2020 is not None and asked.any()
        else None,
        spread=hands.keypoints.std(axis=0) if len(hands) > 1 else None,
    )
