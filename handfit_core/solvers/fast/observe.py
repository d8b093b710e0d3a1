"""From detections to what the solver fits to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handfit_core.detect.correction.canonical import canonical
from handfit_core.detect.correction.network import landmark_network
from handfit_core.detect.keypoints import HandDetection
from handfit_core.geometry.camera import Intrinsics
from handfit_core.skeleton import Side
from handfit_core.solvers.fast.observation import Observation

LEAST_SIGMA = 0.1
"""pixels; landmarks in one place would else be surer than anything"""


@dataclass(frozen=True)
class Trust:
    """How the detector's landmarks and the network's meet."""

    plane: float = 0.3
    """of the way from the detector's x and y to the network's"""
    depth: float = 0.7
    """of the way from the detector's fused depth to the network's"""
    plane_sigma: float = 0.5
    """of the network's expected error, x and y"""
    depth_sigma: float = 0.7
    floor: float = 0.006
    """expected errors are at least this, of the hand's size in the picture"""


@dataclass(frozen=True, eq=False)
class Landmarked:
    """What is seen of N detections, without a camera: pixels."""

    pixels: np.ndarray
    """(N, 21, 2)"""
    pixel_sigma: np.ndarray
    """(N, 21, 2)"""
    depth: np.ndarray
    """(N, 21) about its mean"""
    depth_sigma: np.ndarray
    """(N, 21)"""
    pinned: np.ndarray | None = None
    """(N, 21) bool: pixels that a person has put there; None: there are none"""

    def observation(self, intrinsics: Intrinsics) -> Observation:
        """As seen through a camera."""
        middle = self.pixels.mean(axis=1)
        rays = intrinsics.rays(middle)
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        count = len(middle)

        return Observation(
            pixels=self.pixels,
            pixel_sigma=self.pixel_sigma,
            depth=self.depth,
            depth_sigma=self.depth_sigma,
            ray=rays,
            focal=np.broadcast_to([intrinsics.fx, intrinsics.fy], (count, 2)),
            centre=np.broadcast_to([intrinsics.cx, intrinsics.cy], (count, 2)),
            pinned=self.pinned,
        )


def landmarked(detections: Sequence[HandDetection], side: Side, trust: Trust) -> Landmarked:
    """Correct detections, all taken for hands of that side."""
    sides: list[Side] = [side] * len(detections)
    seen = canonical(detections, sides)
    said = landmark_network()(seen)
    blend = np.array([trust.plane, trust.plane, trust.depth])
    points = seen.to_picture(seen.fused + blend * (said.points - seen.fused))
    sigma = np.maximum(np.maximum(said.sigma, trust.floor) * seen.size[:, None, None], LEAST_SIGMA)
    plane = trust.plane_sigma * sigma[..., :2].mean(axis=-1, keepdims=True).repeat(2, axis=-1)
    depth = points[..., 2] - points[..., 2].mean(axis=1, keepdims=True)
    return Landmarked(points[..., :2], plane, depth, trust.depth_sigma * sigma[..., 2])
