"""Corrected landmarks and judged sides: the network is asked once for each detection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.batch import slices
from handfit_core.detect.correction.canonical import canonical
from handfit_core.detect.correction.network import landmark_network
from handfit_core.detect.keypoints import HandDetection, Landmarked
from handfit_core.geometry.crossing import Crossing
from handfit_core.skeleton import KEYPOINT_PARENTS, NUM_KEYPOINTS, Side

_KNUCKLES: Final = [5, 9, 13, 17]
_THUMB: Final = [2, 3, 4]

LEAST_SIGMA: Final = 0.1
"""pixels; landmarks in one place would else be surer than anything"""
CHUNK: Final = 512
"""Detections corrected at once; bounds the memory"""
DETECTOR_ODDS: Final = 3.0
"""The network was trained on painted pictures, where the detector names the wrong side five times as often as
in photos: its odds for the detector's word count this many times"""


OVERLAPPED: Final = 4.0
"""Points that lie where another hand is are expected to err so many times as much: the detector looks for one
hand at a time, and takes fingers of the other for that one's. So are points that are guessed"""


@dataclass(frozen=True)
class Second:
    """How much the landmark network of December 2020 is heard: its depth, and where both networks differ."""

    depth: float = 0.4
    """of the way from the corrected depth to this network's"""
    agree: float = 0.14
    """disagreement up to which that holds; beyond it the weight falls: of a blurred or covered hand this
    depth is no better"""
    least: float = 0.3
    """of `depth`, however much they disagree"""
    doubted: float = 0.12
    """disagreement from which on expected errors in the picture grow with it"""
    most_doubted: float = 4.0
    """times the expected errors, at most"""
    thumb: float = 0.7
    """as `depth`, of a thumb of which the networks differ whether it lies over a finger or under it: of
    thumbs under fingers this network is right"""
    depth_doubted: float = 0.3
    """of the difference of both depths, which adds to the depth's expected error"""


SECOND: Final = Second()


@dataclass(frozen=True)
class Trust:
    """How the detector's landmarks and the network's meet."""

    plane: float = 0.3
    """of the way from the detector's x and y to the network's"""
    depth: float = 0.6
    """of the way from the detector's fused depth to the network's"""
    plane_sigma: float = 0.5
    """of the network's expected error, x and y"""
    depth_sigma: float = 0.4
    """of the network's expected error in depth"""
    knuckles: float = 2.5
    """times the network's expected errors, of the fingers' knuckles: in photos, the detector errs more there
    than in the painted pictures that the network knows"""
    floor: float = 0.006
    """expected errors are at least this, of the hand's size in the picture"""


TRUST: Final = Trust()


def landmarked(detections: Sequence[HandDetection], side: Side, trust: Trust = TRUST) -> Landmarked:
    """Corrected detections, all taken for hands of that side. Those that carry what the network said of that
    side are not shown to it again. Points that are `overlapped` are expected to err more."""
    said = [d.corrected for d in detections]
    table, unknown = np.empty((len(said), NUM_KEYPOINTS, 6)), []
    for i, judged in enumerate(said):
        if judged is not None and judged[0] == side and trust == TRUST:
            table[i] = judged[1]
        else:
            unknown.append(i)
    if unknown:
        sides: list[Side] = [side for _ in unknown]
        table[unknown] = corrected([detections[i] for i in unknown], sides, trust)[0].table
    seen = Landmarked.of_table(table)
    doubted = {row: d.overlapped for row, d in enumerate(detections) if d.overlapped is not None}
    if not doubted:
        return seen
    times = np.ones(seen.depth.shape)
    times[list(doubted)] = np.where(list(doubted.values()), OVERLAPPED, 1.0)
    return replace(
        seen, pixel_sigma=seen.pixel_sigma * times[..., None], depth_sigma=seen.depth_sigma * times
    )


def with_side_judged(detections: Sequence[HandDetection]) -> list[HandDetection]:
    """The same detections with `right_side` and `corrected` filled in."""
    sides: list[Side] = [d.side for d in detections]
    judged: list[HandDetection] = []
    for part in slices(len(detections), CHUNK):
        found, probabilities = _of_chunk(detections[part], sides[part], TRUST)
        for detection, row, probability in zip(detections[part], found.table, probabilities, strict=True):
            odds = DETECTOR_ODDS * probability / max(1.0 - probability, 1e-9)
            right = float(odds / (1.0 + odds))
            judged.append(replace(detection, right_side=right, corrected=(detection.side, row)))
    return judged


def corrected(
    detections: Sequence[HandDetection], sides: Sequence[Side], trust: Trust = TRUST
) -> tuple[Landmarked, np.ndarray]:
    """Detections taken for hands of those sides, and the probability (N,) that they are."""
    parts = [_of_chunk(detections[part], sides[part], trust) for part in slices(len(detections), CHUNK)]
    whole = Landmarked.concatenate([found for found, _ in parts])
    return whole, np.concatenate([probability for _, probability in parts])


def _of_chunk(
    detections: Sequence[HandDetection], sides: Sequence[Side], trust: Trust
) -> tuple[Landmarked, np.ndarray]:
    seen = canonical(detections, sides)
    said = landmark_network()(seen)
    blend = np.array([trust.plane, trust.plane, trust.depth])
    canonical_points = seen.fused + blend * (said.points - seen.fused)
    canonical_points[..., 2] -= canonical_points[..., 2].mean(axis=1, keepdims=True)
    doubted, depths_apart = np.ones(len(detections)), np.zeros((len(detections), NUM_KEYPOINTS))
    asked = np.array([d.keypoints_2020 is not None for d in detections])
    if asked.any():
        nowhere = np.full((NUM_KEYPOINTS, 3), np.nan)
        second = [nowhere if d.keypoints_2020 is None else d.keypoints_2020 for d in detections]
        other = seen.from_picture(np.array(second))
        other[..., 2] -= other[..., 2].mean(axis=1, keepdims=True)
        apart = disagreement(canonical_points, other)
        weight = np.empty(other.shape[:2])
        weight[:] = (SECOND.depth * np.clip(SECOND.agree / apart, SECOND.least, 1.0))[:, None]
        crossing = Crossing.of(canonical_points[..., :2])
        deeper = crossing.deeper(canonical_points[..., 2]) * crossing.deeper(other[..., 2])
        disputed = np.any(crossing.crossed & (deeper < 0.0), axis=1, keepdims=True)
        weight[:, _THUMB] = np.where(disputed, SECOND.thumb, weight[:, _THUMB])
        difference = other[asked, :, 2] - canonical_points[asked, :, 2]
        canonical_points[asked, :, 2] += weight[asked] * difference
        depths_apart[asked] = SECOND.depth_doubted * np.abs(difference)
        doubted[asked] = np.clip(apart / SECOND.doubted, 1.0, SECOND.most_doubted)[asked]
    points = seen.to_picture(canonical_points)
    sigma = np.maximum(np.maximum(said.sigma, trust.floor) * seen.size[:, None, None], LEAST_SIGMA)
    sigma[:, _KNUCKLES] *= trust.knuckles
    plane = trust.plane_sigma * sigma[..., :2].mean(axis=-1, keepdims=True).repeat(2, axis=-1)
    plane *= doubted[:, None, None]
    depth = points[..., 2] - points[..., 2].mean(axis=1, keepdims=True)
    depth_sigma = np.hypot(trust.depth_sigma * sigma[..., 2], depths_apart * seen.size[:, None])
    return Landmarked(points[..., :2], plane, depth, depth_sigma), said.right_side


def disagreement(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(N,) mean distance in the picture between two networks' points (N, 21, 3), in mean lengths of the first
    one's bones; NaN where the others are."""
    bones = np.linalg.norm(points[:, 1:] - points[:, list(KEYPOINT_PARENTS[1:])], axis=-1).mean(axis=1)
    apart = np.linalg.norm(points[..., :2] - others[..., :2], axis=-1).mean(axis=1)
    return np.asarray(apart / np.maximum(bones, 1e-9))
