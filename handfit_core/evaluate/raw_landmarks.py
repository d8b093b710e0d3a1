"""The detector's own landmarks as 3D hands, without any hand model: what a fit must beat.

MediaPipe gives two sets. Image landmarks are pixels with a depth on the scale of x; world landmarks
are metres. Their errors differ, so that both together (`fused`) beat either.
"""

from __future__ import annotations

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.similarity import align


def image_landmarks(detection: HandDetection) -> np.ndarray:
    """(21, 3) pixels with depth, as they are."""
    return detection.keypoints


def world_landmarks(detection: HandDetection) -> np.ndarray:
    """(21, 3) pixels with depth: world landmarks laid over the image landmarks by a similarity transform."""
    return align(detection.world, detection.keypoints, with_scale=True).apply(detection.world)


def fused_landmarks(detection: HandDetection) -> np.ndarray:
    """(21, 3) pixels with depth: x and y of the image landmarks, the depth averaged over both sets."""
    fused = detection.keypoints.copy()
    fused[:, 2] = (fused[:, 2] + world_landmarks(detection)[:, 2]) / 2.0
    return fused


def in_metres(picture_points: np.ndarray, detection: HandDetection, intrinsics: Intrinsics) -> np.ndarray:
    """(21, 3) pixels with depth -> (21, 3) metres in the camera frame.

    The size is the world landmarks': the scale of the similarity transform from the points to them.
    The shape is left as it is, as if seen from far away, and stands where a pinhole camera sees a hand
    of that size that large.
    """
    metres_per_pixel = align(picture_points, detection.world, with_scale=True).scale
    centre = picture_points[:, :2].mean(axis=0)
    depth = metres_per_pixel * (intrinsics.fx + intrinsics.fy) / 2.0
    offsets = picture_points - np.array([*centre, picture_points[:, 2].mean()])
    return intrinsics.rays(centre) * depth + offsets * metres_per_pixel
