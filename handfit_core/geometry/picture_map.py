"""From the captured picture to the 3D viewport that looks through its camera, and back.

A pixel is a ray of the capture camera. Seen in any view, the picture of a plane is a projective map of
it: one 3 x 3 matrix, exact under zoom, pan, lens shift and non-square pixels.
"""

from __future__ import annotations

import numpy as np

from handfit_core.geometry.camera import Intrinsics


def picture_to_region(
    intrinsics: Intrinsics, camera: np.ndarray, perspective: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Return the (3, 3) map of homogeneous pixels (x, y, 1) of the upright picture to pixels of a region.

    camera (4, 4): the camera object's matrix_world; its scale does not matter. perspective (4, 4): the
    region's `RegionView3D.perspective_matrix`. size: the region's width and height. Regions count pixels from
    their lower left corner, upwards.
    """
    rays = np.array(
        [
            [1.0 / intrinsics.fx, 0.0, -intrinsics.cx / intrinsics.fx],
            [0.0, 1.0 / intrinsics.fy, -intrinsics.cy / intrinsics.fy],
            [0.0, 0.0, 1.0],
        ]
    )
    # Blender's cameras look along their own -Z with Y up.
    directions = np.diag([1.0, -1.0, -1.0]) @ rays
    axes = np.asarray(camera, dtype=np.float64)[:3, :3]
    axes = axes / np.linalg.norm(axes, axis=0)
    points = np.zeros((4, 3))
    points[:3] = axes @ directions
    points[:3, 2] += np.asarray(camera, dtype=np.float64)[:3, 3]
    points[3, 2] = 1.0
    clip = np.asarray(perspective, dtype=np.float64) @ points
    half_width, half_height = size[0] / 2.0, size[1] / 2.0
    return np.stack([half_width * (clip[0] + clip[3]), half_height * (clip[1] + clip[3]), clip[3]])


def mapped(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Map points (..., 2) by a (3, 3) projective matrix to points (..., 2)."""
    points = np.asarray(points, dtype=np.float64)
    moved = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1) @ matrix.T
    return moved[..., :2] / moved[..., 2:]
