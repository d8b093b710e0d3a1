"""Bring fingertips to where they should be, within the joints' ranges and without cutting through."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, TIP_KEYPOINTS

from .contact import overlaps
from .kinematics import RightHand, first_limits

_TIP_MM = 1.0
_POSTURE_DEG = 25.0
_STEP = 1e-4
_ROUNDS = 30


def fingers_mask(*fingers: str) -> np.ndarray:
    """(15, 3) bool: the angles that these fingers move willingly: bends, and spread and twist at the root."""
    free = np.zeros((15, 3), dtype=bool)
    for finger in fingers:
        joints = [j - 1 for j in FINGER_JOINTS[finger]]
        free[joints, 2] = True
        free[joints[0], :2] = True
    return free


def reach(
    hand: RightHand,
    angles: np.ndarray,
    free: np.ndarray,
    miss: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Change the `free` (15, 3) angles so that `miss` vanishes: damped Gauss-Newton with differences.

    `miss` maps keypoints (B, 21, 3) to vectors (B, M) in metres. The result stays within the active
    ranges and near where it starts; `miss` need not vanish: ask again.
    """
    limits = first_limits()
    places = np.flatnonzero(free)
    low, high = limits.lower.ravel()[places], limits.upper.ravel()[places]
    start = angles.ravel()[places]

    def residuals(values: np.ndarray) -> np.ndarray:
        batch = np.repeat(angles.reshape(1, 45), len(values), axis=0)
        batch[:, places] = values
        points = hand.keypoints(batch.reshape(-1, 15, 3))
        tips = miss(points) / (_TIP_MM / 1000)
        deep = np.maximum(overlaps(points, hand.scale) - 0.001, 0.0) / 0.004
        return np.concatenate([tips, deep, (values - start) / np.radians(_POSTURE_DEG)], axis=1)

    x = np.clip(start, low, high)
    damping = 1.0
    here = residuals(x[None])[0]
    for _ in range(_ROUNDS):
        moved = residuals(x + _STEP * np.eye(len(x)))
        jacobian = (moved - here).T / _STEP
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ here
        trials = np.stack(
            [
                np.clip(x - np.linalg.solve(normal + damping * k * np.eye(len(x)), gradient), low, high)
                for k in (0.1, 1.0, 10.0, 100.0)
            ]
        )
        found = residuals(trials)
        costs = np.sum(found**2, axis=1)
        best = int(costs.argmin())
        if costs[best] >= np.sum(here**2) * (1 - 1e-6):
            break
        x, here = trials[best], found[best]
        damping = float(np.clip(damping * (0.1, 1.0, 10.0, 100.0)[best], 1e-3, 1e6))
    result = angles.copy().ravel()
    result[places] = x
    return result.reshape(15, 3)


def pinch(hand: RightHand, angles: np.ndarray, fingers: tuple[str, ...], gap: float = 0.0) -> np.ndarray:
    """Bring the thumb's tip and those of one or two `fingers` together, up to `gap` metres."""
    tips = [TIP_KEYPOINTS[FINGERS.index(finger)] for finger in fingers]

    def miss(points: np.ndarray) -> np.ndarray:
        apart = points[:, tips] - points[:, 4:5]
        length = np.linalg.norm(apart, axis=-1, keepdims=True)
        wanted = apart * (1 - gap / np.maximum(length, 1e-9))
        return wanted.reshape(len(points), -1)

    return reach(hand, angles, fingers_mask("thumb", *fingers), miss)


def tip_distance(points: np.ndarray, finger: str) -> float:
    """Distance of the thumb's tip from a finger's, keypoints (21, 3), metres."""
    return float(np.linalg.norm(points[TIP_KEYPOINTS[FINGERS.index(finger)]] - points[4]))
