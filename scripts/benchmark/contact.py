"""Penetration of a hand's parts, with a capsule around every bone."""

from __future__ import annotations

import functools
from typing import Final

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS

from .kinematics import RightHand, model_of

PALM_RADIUS: Final = 0.010
"""metres, about half the palm's thickness; the metacarpals' capsules have it"""

Capsules = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Starts and ends (N, 3) of their axes, and radii (N,), metres"""
SEGMENTS: Final = (
    *((1 + 4 * f + i, 2 + 4 * f + i) for f in range(5) for i in range(3)),
    *((0, 5 + 4 * f) for f in range(4)),
)
"""Keypoints at both ends of the 15 phalanges (the thumb's metacarpal among them) and 4 metacarpals"""


def _may_touch(first: int, second: int) -> bool:
    """True if a pair of parts counts; parts that grow together do not."""
    if first >= 15 and second >= 15:
        return False
    if second >= 15:
        # The thumb's root and the fingers' first phalanges meet the palm in the flat hand, too.
        return first % 3 == 2 or (first % 3 == 1 and first != 1)
    return first // 3 != second // 3


_PAIRS: Final = np.array([(i, j) for i in range(19) for j in range(i + 1, 19) if _may_touch(i, j)])


@functools.cache
def radii() -> np.ndarray:
    """(19,) metres: the capsules' radii on the mean hand, measured on its skin."""
    model = model_of("right")
    shaped = model.shaped()
    owner = model.weights.argmax(axis=1)
    found = np.full(19, PALM_RADIUS)
    for f, finger in enumerate(FINGERS):
        joints = FINGER_JOINTS[finger]
        ends = [*shaped.joints[list(joints[1:])], shaped.tips[f]]
        for i, (joint, end) in enumerate(zip(joints, ends, strict=True)):
            along = end - shaped.joints[joint]
            along = along / np.linalg.norm(along)
            from_joint = shaped.vertices[owner == joint] - shaped.joints[joint]
            across = from_joint - np.outer(from_joint @ along, along)
            found[3 * f + i] = np.median(np.linalg.norm(across, axis=1))
    # The skin of the thumb's root is half of the palm.
    found[0] = found[1] * 1.15
    return found


def capsules(keypoints: np.ndarray, scale: float = 1.0) -> Capsules:
    """(..., 21, 3) keypoints -> starts and ends (..., 19, 3) and radii (19,) in metres.

    The last ones end one radius short of the fingertip, which lies on the skin.
    """
    starts = keypoints[..., [a for a, _ in SEGMENTS], :]
    ends = np.array(keypoints[..., [b for _, b in SEGMENTS], :])
    radius = radii() * scale
    last = np.arange(2, 15, 3)
    along = ends[..., last, :] - starts[..., last, :]
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    ends[..., last, :] -= along * radius[last][:, None]
    return starts, ends, radius


def segment_distance(p1: np.ndarray, q1: np.ndarray, p2: np.ndarray, q2: np.ndarray) -> np.ndarray:
    """Shortest distance between segments p1-q1 and p2-q2, all (..., 3) -> (...).

    After Ericson, Real-Time Collision Detection (2005), 5.1.9.
    """
    d1, d2, r = q1 - p1, q2 - p2, p1 - p2
    a = np.maximum(np.sum(d1 * d1, -1), 1e-12)
    e = np.maximum(np.sum(d2 * d2, -1), 1e-12)
    f, c, b = np.sum(d2 * r, -1), np.sum(d1 * r, -1), np.sum(d1 * d2, -1)
    denominator = a * e - b * b
    s = np.clip(
        np.where(denominator > 1e-15, (b * f - c * e) / np.maximum(denominator, 1e-15), 0.0), 0.0, 1.0
    )
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    gap = (p1 + s[..., None] * d1) - (p2 + t[..., None] * d2)
    return np.linalg.norm(gap, axis=-1)


def _overlaps(keypoints: np.ndarray, scale: float) -> np.ndarray:
    """(..., 21, 3) -> (..., pairs) metres; negative where apart."""
    starts, ends, radius = capsules(keypoints, scale)
    i, j = _PAIRS.T
    distance = segment_distance(starts[..., i, :], ends[..., i, :], starts[..., j, :], ends[..., j, :])
    return radius[i] + radius[j] - distance


@functools.cache
def _flat_overlaps() -> np.ndarray:
    flat = RightHand(np.zeros(10)).keypoints(np.zeros((15, 3)))
    return np.maximum(_overlaps(flat, 1.0), 0.0)


def overlaps(keypoints: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """Depth by which each pair of a hand's parts overlaps beyond its overlap in the flat hand.

    keypoints (..., 21, 3) metres; scale: size over the mean hand's. Returns (..., pairs) metres.
    """
    return _overlaps(keypoints, scale) - _flat_overlaps()


def penetration(keypoints: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """The deepest of `overlaps`, (...) metres, at least 0."""
    return np.maximum(overlaps(keypoints, scale).max(axis=-1), 0.0)


def clearance(first: np.ndarray, second: np.ndarray, scale: float = 1.0) -> float:
    """Smallest gap between two hands' capsules, keypoints (21, 3) each; negative where they overlap."""
    return gap(capsules(first, scale), capsules(second, scale))


def gap(first: Capsules, second: Capsules) -> float:
    """Smallest gap between any two capsules of the one and of the other; negative where they overlap."""
    (p1, q1, r1), (p2, q2, r2) = first, second
    return float((segment_distance(p1[:, None], q1[:, None], p2, q2) - r1[:, None] - r2).min())
