"""Corrected landmarks and judged sides: the correction network runs once for each detection."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.common.batch import slices
from handfit_core.common.skeleton import KEYPOINT_PARENTS, NUM_KEYPOINTS, SIDES, Side
from handfit_core.detect.correction.canonical import canonical
from handfit_core.detect.correction.network import landmark_network
from handfit_core.detect.keypoints import Detections, Landmarked
from handfit_core.geometry.crossing import Crossing

_THUMB: Final = [2, 3, 4]
BATCH: Final = 512
"""Detections in one forward pass; bounds the memory"""


@dataclass(frozen=True)
class SecondNetworkWeights:
    """Weights of the landmark network of December 2020: of its depth, and of where both networks differ."""

    depth: float = 0.4
    """Share of the way from the corrected depth to this network's"""
    agree: float = 0.14
    """`disagreement` from which on that share falls: of a blurred or covered hand this depth is no better"""
    least: float = 0.3
    """Factor on `depth`, at least, however much the networks disagree"""
    doubted: float = 0.12
    """`disagreement` from which on expected errors in the picture grow with it"""
    most_doubted: float = 4.0
    """Factor on the expected errors, at most"""
    thumb: float = 0.7
    """In place of `depth` for a thumb of which the networks differ whether it lies over a finger or under it:
    of thumbs under fingers this network is right"""
    depth_doubted: float = 0.3
    """Share of the difference of both depths that is added to the depth's expected error"""


SECOND_NETWORK: Final = SecondNetworkWeights()


@dataclass(frozen=True)
class BlendWeights:
    """Weights by which the detector's landmarks and the correction network's are blended."""

    plane: float = 0.3
    """Share of the way from the detector's x and y to the network's"""
    depth: float = 0.6
    """Share of the way from the detector's fused depth to the network's"""
    plane_sigma: float = 0.5
    """Factor on the network's expected errors of x and y"""
    depth_sigma: float = 0.4
    """Factor on the network's expected error of depth"""
    knuckles: float = 2.5
    """Factor on the network's expected errors of the fingers' knuckles: in photos, the detector errs more
    there than in the painted pictures that the network knows"""
    floor: float = 0.006
    """Hand sizes in the picture; the least expected error"""
    detector_odds: float = 3.0
    """Factor on the network's odds for the detector's side. The network was trained on painted pictures,
    where the detector names the wrong side five times as often as in photos"""
    overlapped: float = 4.0
    """Factor on the expected errors of points that lie on another hand: the detector finds one hand at a
    time, and takes fingers of the other for that one's. Guessed points have it, too"""


BLEND: Final = BlendWeights()


def landmarked(hands: Detections, side: Side, blend: BlendWeights = BLEND) -> Landmarked:
    """Corrected landmarks of N hands, all taken for ones of that side. The network does not run for those
    whose `corrected` is of that side. Points that are `overlapped` have larger expected errors."""
    sides = np.full(len(hands), SIDES.index(side))
    if hands.corrected is None or blend != BLEND:
        table, _ = corrected(hands, sides, blend)
    else:
        table, missing = hands.corrected, np.flatnonzero(hands.corrected_side != sides)
        if len(missing):
            table = table.copy()
            table[missing], _ = corrected(hands.select(missing), sides[missing], blend)
    landmarks = Landmarked.of_table(table)
    if hands.overlapped is None:
        return landmarks
    factor = np.where(hands.overlapped, blend.overlapped, 1.0)
    return replace(
        landmarks,
        pixel_sigma=landmarks.pixel_sigma * factor[..., None],
        depth_sigma=landmarks.depth_sigma * factor,
    )


def with_side_judged(hands: Detections) -> Detections:
    """Hands with `right_side` and `corrected` filled in."""
    table, probability = corrected(hands, hands.side)
    odds = BLEND.detector_odds * probability / np.maximum(1.0 - probability, 1e-9)
    return replace(hands, right_side=odds / (1.0 + odds), corrected_side=hands.side, corrected=table)


def corrected(
    hands: Detections, sides: np.ndarray, blend: BlendWeights = BLEND
) -> tuple[np.ndarray, np.ndarray]:
    """Corrected landmarks of N hands taken for ones of those sides, (N,) indices in `SIDES`: a
    `Landmarked.table` (N, 21, 6), and the probability (N,) that they are of these sides."""
    table, probability = np.empty((len(hands), NUM_KEYPOINTS, 6)), np.empty(len(hands))
    for part in slices(len(hands), BATCH):
        found, probability[part] = _correct_batch(hands.select(part), sides[part], blend)
        table[part] = found.table
    return table, probability


def _correct_batch(
    hands: Detections, sides: np.ndarray, blend: BlendWeights
) -> tuple[Landmarked, np.ndarray]:
    seen = canonical(hands, sides)
    correction = landmark_network()(seen)
    share = np.array([blend.plane, blend.plane, blend.depth])
    canonical_points = seen.fused + share * (correction.points - seen.fused)
    canonical_points[..., 2] -= canonical_points[..., 2].mean(axis=1, keepdims=True)
    doubted, depths_apart = np.ones(len(hands)), np.zeros((len(hands), NUM_KEYPOINTS))
    asked = hands.asked_2020
    if hands.keypoints_2020 is not None and asked.any():
        other = seen.from_picture(hands.keypoints_2020)
        other[..., 2] -= other[..., 2].mean(axis=1, keepdims=True)
        apart = disagreement(canonical_points, other)
        weight = np.empty(other.shape[:2])
        weight[:] = (SECOND_NETWORK.depth * np.clip(SECOND_NETWORK.agree / apart, SECOND_NETWORK.least, 1.0))[
            :, None
        ]
        crossing = Crossing.of(canonical_points[..., :2])
        deeper = crossing.deeper(canonical_points[..., 2]) * crossing.deeper(other[..., 2])
        disputed = np.any(crossing.crossed & (deeper < 0.0), axis=1, keepdims=True)
        weight[:, _THUMB] = np.where(disputed, SECOND_NETWORK.thumb, weight[:, _THUMB])
        difference = other[asked, :, 2] - canonical_points[asked, :, 2]
        canonical_points[asked, :, 2] += weight[asked] * difference
        depths_apart[asked] = SECOND_NETWORK.depth_doubted * np.abs(difference)
        doubted[asked] = np.clip(apart / SECOND_NETWORK.doubted, 1.0, SECOND_NETWORK.most_doubted)[asked]
    points = seen.to_picture(canonical_points)
    # The least expected error is in pixels, or landmarks in one place would be surer than anything
    sigma = np.maximum(np.maximum(correction.sigma, blend.floor) * seen.size[:, None, None], 0.1)
    sigma[:, [5, 9, 13, 17]] *= blend.knuckles
    plane = blend.plane_sigma * sigma[..., :2].mean(axis=-1, keepdims=True).repeat(2, axis=-1)
    plane *= doubted[:, None, None]
    depth = points[..., 2] - points[..., 2].mean(axis=1, keepdims=True)
    depth_sigma = np.hypot(blend.depth_sigma * sigma[..., 2], depths_apart * seen.size[:, None])
    return Landmarked(points[..., :2], plane, depth, depth_sigma), correction.right_side


def disagreement(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(N,) mean distance in the picture between two networks' points (N, 21, 3), in mean lengths of the first
    one's bones; NaN where the second one's points are NaN."""
    bones = np.linalg.norm(points[:, 1:] - points[:, list(KEYPOINT_PARENTS[1:])], axis=-1).mean(axis=1)
    apart = np.linalg.norm(points[..., :2] - others[..., :2], axis=-1).mean(axis=1)
    return np.asarray(apart / np.maximum(bones, 1e-9))
