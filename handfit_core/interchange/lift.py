"""From keypoints in the plane, some of which may be missing, to detections with depth.

A small network, trained on projections of the open hand in the poses of painted pictures
(scripts/train_lift.py at commit 2ca2c99), tells how deep each point is, and where the missing
ones are (docs/method.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.skeleton import KEYPOINT_PARENTS, NUM_KEYPOINTS, SIDES
from handfit_core.detect.correction.canonical import Canonical, canonical_arrays
from handfit_core.detect.correction.network import Layers
from handfit_core.detect.keypoints import Detections
from handfit_core.interchange.recording import SeenHands, known

FEATURES: Final = 4 * NUM_KEYPOINTS


@dataclass(frozen=True, eq=False)
class Plane:
    """The normal distribution of hands' points in the canonical frame, by which missing points are first
    guessed."""

    mean: np.ndarray
    """(42,) mean of x and y of the 21 points, in hand sizes"""
    covariance: np.ndarray
    """(42, 42) covariance of x and y of the 21 points"""

    def filled(self, points: np.ndarray, sure: np.ndarray) -> np.ndarray:
        """Return points (N, 21, 2) in which those that are not `sure`, (N, 21) bool, lie where they are
        likeliest, were hands normally distributed: m + C_mk C_kk^-1 (k - m)."""
        there = np.repeat(sure, 2, axis=1).astype(np.float64)
        among = self.covariance * there[:, :, None] * there[:, None]
        # A missing point's own row says that nothing pulls at it.
        # The errors that are expected of seen points, in parts of the hand's size, where others are guessed
        among += np.eye(there.shape[1]) * (1.0 + 0.05**2 - there[:, None])
        pull = np.linalg.solve(among, ((points.reshape(there.shape) - self.mean) * there)[..., None])
        guess = self.mean + (self.covariance @ pull)[..., 0]
        return np.where(sure[..., None], points, guess.reshape(points.shape))


def canonical_plane(
    plane: Plane, keypoints: np.ndarray, confidence: np.ndarray, left: np.ndarray
) -> Canonical:
    """Bring keypoints (N, 21, 2) in pixels, NaN where missing, of which every hand has some, with their
    confidence (N, 21) and `left`, (N,) bool, into the canonical frame: as of right hands, upright, centred,
    of unit size, without depth.

    Features are the points, those that are missing as `plane` guesses them, whether each was there, and its
    confidence.
    """
    sure = known(keypoints)
    count = np.maximum(sure.sum(axis=1, keepdims=True), 1)
    seen = np.where(sure[..., None], keypoints, 0.0)
    middle = seen.sum(axis=1) / count
    points = np.where(sure[..., None], seen, middle[:, None])
    some = np.flatnonzero(~sure.all(axis=1))
    # Frames that are laid through seen and guessed points; each changes what is guessed
    for _ in range(4 if len(some) else 0):
        frame = _frame(points[some], left[some])
        guess = plane.filled(frame.from_picture(_with_zero(points[some]))[..., :2], sure[some])
        guess = frame.to_picture(_with_zero(guess))[..., :2]
        points[some] = np.where(sure[some, :, None], points[some], guess)
    frame = _frame(points, left)
    fused = frame.from_picture(_with_zero(points))
    told = np.where(sure, confidence, 0.0)
    return replace(
        frame,
        features=np.concatenate([fused[..., :2].reshape(len(sure), 2 * NUM_KEYPOINTS), sure, told], axis=1),
        fused=fused,
    )


def _with_zero(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)


def _frame(points: np.ndarray, left: np.ndarray) -> Canonical:
    """Return the canonical frame of complete points (N, 21, 2) in pixels; `left`, (N,) bool, tells left
    hands."""
    confident = np.ones(len(points))
    return canonical_arrays(_with_zero(points), _with_zero(points), left, confident)


class Lifter:
    """The trained network that gives keypoints in the plane a depth, and places to missing ones."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self.plane = Plane(*(arrays[name].astype(np.float64) for name in ("plane_mean", "plane_covariance")))
        self._layers = Layers(arrays)

    def __call__(self, keypoints: np.ndarray, confidence: np.ndarray, left: np.ndarray) -> np.ndarray:
        """Return (N, 21, 3) of keypoints as `canonical_plane` takes them: pixels where they rather are, and
        depth in pixels."""
        seen = canonical_plane(self.plane, keypoints, confidence, left)
        said = self._layers(seen.features).reshape(-1, NUM_KEYPOINTS, 3)
        return seen.to_picture(seen.fused + said)


@lru_cache(maxsize=1)
def lifter() -> Lifter:
    """Return the lifter that ships with the package."""
    with np.load(Path(__file__).parent / "data" / "lift_network.npz", allow_pickle=False) as arrays:
        return Lifter(dict(arrays))


def lifted(hands: SeenHands) -> Detections:
    """Return N hands as detections: what was seen, with depth and world landmarks. These two are kept where
    they are known; else the lifter tells the depth, and the world landmarks are those of a hand of average
    size.

    Every hand has some points that are seen. Those that are missing lie where the lifter guesses them, and
    are `overlapped`, so that they are believed less, as are seen ones of which the program is far less sure
    than of the hand's others. Expected errors are the landmark network's, as those of
    any detection: it is asked when hands are fitted, and again when a take's are.
    """
    seen, depth = hands.keypoints, hands.points[..., 2]
    sure = known(seen)
    guess = lifter()(seen, hands.confidence, hands.side == SIDES.index("left"))
    pixels = np.where(sure[..., None], seen, guess[..., :2])
    points = np.concatenate([pixels, guess[..., 2:] - guess[:, :1, 2:]], axis=2)
    world = points - points.mean(axis=1, keepdims=True)
    bones = np.linalg.norm(world[:, 1:] - world[:, KEYPOINT_PARENTS[1:]], axis=2).mean(axis=1)
    # Metres: mean length of the 20 bones of the open hand of average shape
    world *= 0.0416 / np.maximum(bones, 1e-9)[:, None, None]
    points[..., 2] = np.where(np.isfinite(depth), depth, points[..., 2])
    world = np.where(np.isfinite(hands.world).all(axis=(1, 2), keepdims=True), hands.world, world)
    usual = np.nanmedian(np.where(sure, hands.confidence, np.nan), axis=1, keepdims=True)
    # Points of less than half the median confidence are believed less. Programs' scales differ.
    doubted = ~sure | (hands.confidence < 0.5 * usual)
    return Detections(
        hands.row, hands.side, hands.score, points, world, overlapped=doubted, given_side=hands.side
    )
