"""World landmarks against keypoints, up to the rotation, size and place that suit them best."""

from __future__ import annotations

import numpy as np

from handfit_core.residuals.rows import PointRows


def similarity(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (B, 3, 3) and scale (B,) that lay centred source (B, N, 3) over centred target (B, N, 3)
    with the least squared distance. Umeyama, 1991. Points that are not finite get a meaningless rotation and
    harm no other in the batch."""
    a = source - source.mean(axis=1, keepdims=True)
    b = target - target.mean(axis=1, keepdims=True)
    # LAPACK raises on NaN.
    covariance = np.nan_to_num(np.swapaxes(b, 1, 2) @ a, posinf=0.0, neginf=0.0)
    u, s, vt = np.linalg.svd(covariance)
    sign = np.ones_like(s)
    sign[:, 2] = np.sign(np.linalg.det(u @ vt))
    rotation = (u * sign[:, None, :]) @ vt
    return rotation, (s * sign).sum(axis=1) / np.maximum(np.square(a).sum(axis=(1, 2)), 1e-12)


def world(points: np.ndarray, landmarks: np.ndarray, sigma: np.ndarray, offset: np.ndarray) -> PointRows:
    """points (B, 21, 3) metres, camera frame; landmarks (B, 21, 3) metres in any frame and size; sigma
    (B, 21) metres; offset (B, 3) metres, where the landmarks' centre lies, solved for beside the hand.

    Three rows: r = x - offset - s R w. Rotation and size are the best ones for the points as they are,
    taken as constant in the derivative: since they are at a minimum, the gradient of the unweighted cost is
    exact all the same.
    """
    rotation, scale = similarity(landmarks, points)
    laid = (
        scale[:, None, None]
        * (landmarks - landmarks.mean(axis=1, keepdims=True))
        @ np.swapaxes(rotation, 1, 2)
    )
    residual = points - offset[:, None] - laid
    jacobian = np.eye(3) / sigma[..., None, None]
    return PointRows(residual / sigma[..., None], jacobian, -jacobian)
