"""From a hand fitted under an unknown camera to its place before a known one."""

from __future__ import annotations

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import turn_from_axis
from handfit_core.paper.settings import PAPER


def turn_to_ray(intrinsics: Intrinsics, pixel: np.ndarray) -> np.ndarray:
    """Return the smallest rotation (3, 3) from the optical axis to the ray through `pixel` (2,).

    A hand fitted as if seen along its own line of sight must be turned by this to look the same from a
    perspective camera that does not point at it.
    """
    ray = intrinsics.rays(pixel)
    return turn_from_axis(ray / np.linalg.norm(ray))


def place(points: np.ndarray, keypoints_2d: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Return the translation (3,) in metres that makes `points` (N, 3), in metres, project nearest to
    `keypoints_2d` (N, 2) in pixels.

    Starts from the linear solution of the pinhole equations and minimises the squared reprojection error by
    Gauss-Newton steps on the three unknowns.
    """
    focal = np.array([intrinsics.fx, intrinsics.fy])
    rays = intrinsics.rays(keypoints_2d)[:, :2]
    # (X + tx) = ray_x (Z + tz), and the same in y: linear in t.
    count = len(points)
    matrix = np.zeros((2 * count, 3))
    matrix[0::2, 0] = 1.0
    matrix[1::2, 1] = 1.0
    matrix[:, 2] = -rays.reshape(-1)
    right = (rays * points[:, 2:3] - points[:, :2]).reshape(-1)
    transl = np.linalg.lstsq(matrix, right, rcond=None)[0]
    nearest = -points[:, 2].min() + PAPER.min_depth
    transl[2] = max(transl[2], nearest)
    for _ in range(10):
        moved = points + transl
        depth = np.maximum(moved[:, 2], PAPER.min_depth)
        residual = (intrinsics.project(moved) - keypoints_2d).reshape(-1)
        jacobian = np.zeros((count, 2, 3))
        jacobian[:, 0, 0] = focal[0] / depth
        jacobian[:, 1, 1] = focal[1] / depth
        jacobian[:, :, 2] = -focal * moved[:, :2] / depth[:, None] ** 2
        step = np.linalg.lstsq(jacobian.reshape(-1, 3), -residual, rcond=None)[0]
        transl = transl + step
        transl[2] = max(transl[2], nearest)
        if np.linalg.norm(step) < 1e-7:
            break
    return transl
