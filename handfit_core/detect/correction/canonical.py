"""The canonical frame, in which the correction network sees a hand: a right one, upright, centred, of unit
size.

NumPy only; N detections at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, WRIST_KEYPOINT
from handfit_core.detect.keypoints import Detections
from handfit_core.geometry.similarity import laid_over

KNUCKLES = (5, 9, 13, 17)
WORLD_SCALE = 10.0
"""Factor that brings world landmarks, in metres, to the order of one"""
FEATURES = 3 * 3 * NUM_KEYPOINTS + 1


@dataclass(frozen=True, eq=False)
class Canonical:
    """N detections in the canonical frame, and the way back."""

    features: np.ndarray
    """(N, FEATURES): image landmarks, world landmarks, the latter laid over the former, and the detector's
    confidence in its side, negative where that is not the assumed one"""
    fused: np.ndarray
    """(N, 21, 3) image landmarks, with the depth averaged over both sets"""
    turn: np.ndarray
    """(N, 3, 3) from mirrored picture axes to the canonical ones"""
    mirror: np.ndarray
    """(N,) -1 where a left hand was mirrored, else 1"""
    size: np.ndarray
    """(N,) pixels per unit"""
    middle: np.ndarray
    """(N, 2) of the keypoints, pixels"""

    def to_picture(self, points: np.ndarray) -> np.ndarray:
        """(N, 21, 3) canonical points -> pixels, and depth in pixels about the mean of the detection's."""
        turned = (points @ self.turn) * self.size[:, None, None]
        turned[..., 0] *= self.mirror[:, None]
        turned[..., :2] += self.middle[:, None]
        return turned

    def from_picture(self, points: np.ndarray) -> np.ndarray:
        """(N, 21, 3) pixels and depth in pixels about the mean of the detection's -> canonical points."""
        moved = np.array(points, dtype=np.float64)
        moved[..., :2] -= self.middle[:, None]
        moved[..., 0] *= self.mirror[:, None]
        return (moved / self.size[:, None, None]) @ np.swapaxes(self.turn, -1, -2)


def canonical(hands: Detections, sides: np.ndarray) -> Canonical:
    """Bring N hands into the canonical frame, each taken for one of that side: `sides` (N,) indices in
    `SIDES`."""
    agreement = np.where(hands.side == sides, hands.score, -hands.score)
    return canonical_arrays(hands.keypoints, hands.world, sides == SIDES.index("left"), agreement)


def canonical_arrays(
    keypoints: np.ndarray, world: np.ndarray, left: np.ndarray, agreement: np.ndarray
) -> Canonical:
    """Bring keypoints and world landmarks (N, 21, 3) into the canonical frame. `left` (N,) bool: taken for
    left hands; `agreement` (N,): the detector's score for that side, negative where it named the other
    one."""
    mirror = np.where(left, -1.0, 1.0)
    middle = keypoints[..., :2].mean(axis=1)
    points = keypoints - keypoints.mean(axis=1, keepdims=True)
    laid = world - world.mean(axis=1, keepdims=True)
    points[..., 0] *= mirror[:, None]
    laid[..., 0] *= mirror[:, None]
    size = np.maximum(np.sqrt(np.square(points[..., :2]).sum(axis=-1).mean(axis=1)), 1e-9)
    up = points[:, KNUCKLES, :2].mean(axis=1) - points[:, WRIST_KEYPOINT, :2]
    length = np.maximum(np.linalg.norm(up, axis=1), 1e-9)
    sin, cos = -up[:, 0] / length, -up[:, 1] / length
    turn = np.zeros((len(points), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = cos, -sin, sin, cos, 1.0
    points = (points / size[:, None, None]) @ np.swapaxes(turn, -1, -2)
    laid = laid @ np.swapaxes(turn, -1, -2)
    rotation, scale = laid_over(laid, points)
    over = scale[:, None, None] * laid @ np.swapaxes(rotation, -1, -2)
    fused = points.copy()
    fused[..., 2] = (points[..., 2] + over[..., 2]) / 2.0
    flat = [part.reshape(len(points), 3 * NUM_KEYPOINTS) for part in (points, WORLD_SCALE * laid, over)]
    features = np.concatenate([*flat, agreement[:, None]], axis=1)
    return Canonical(features, fused, turn, mirror, size, middle)
