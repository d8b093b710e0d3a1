"""What the solver fits to: from detections to landmarks with expected errors, and these through a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from handfit_core.detect.correction.canonical import canonical
from handfit_core.detect.correction.network import landmark_network
from handfit_core.detect.keypoints import HandDetection
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.chain import Index
from handfit_core.skeleton import Side

LEAST_SIGMA = 0.1
"""pixels; landmarks in one place would else be surer than anything"""
CHUNK = 512
"""Detections corrected at once; bounds the memory"""


@dataclass(frozen=True, eq=False)
class Kept:
    """Poses that B hands are to stay near, and how firmly; a sigma that is infinite keeps nothing. What is
    held exactly: `problem.Held`."""

    wrist: np.ndarray
    """(B, 3) metres, camera frame, of which the distance counts"""
    distance_sigma: np.ndarray
    """(B,) as a part of that distance"""
    angles: np.ndarray
    """(B, 5, 9) radians, finger by finger"""
    angle_sigma: np.ndarray
    """(B, 5) radians"""
    limits_sigma: float | None = None
    """radians beyond what joints can do when they are pressed (`terms.limits.PASSIVE_RANGE`), or beyond the
    kept angles where these go further, that cost as much as one sigma; None: as hands without a pose to keep
    have it"""

    def __getitem__(self, index: Index) -> Kept:
        """The hands of that index."""
        arrays = ("wrist", "distance_sigma", "angles", "angle_sigma")
        return replace(self, **{name: getattr(self, name)[index] for name in arrays})


@dataclass(frozen=True, eq=False)
class Observation:
    """Landmarks of B pictures of one model's hand, seen through a camera. Pixels, camera frame."""

    pixels: np.ndarray
    """(B, 21, 2)"""
    pixel_sigma: np.ndarray
    """(B, 21, 2) expected errors, pixels"""
    depth: np.ndarray
    """(B, 21) along the line of sight about its mean, in pixels at the hand's distance"""
    depth_sigma: np.ndarray
    """(B, 21) pixels"""
    ray: np.ndarray
    """(B, 3) unit line of sight"""
    focal: np.ndarray
    """(B, 2) pixels"""
    centre: np.ndarray
    """(B, 2) pixels"""
    pinned: np.ndarray | None = None
    """(B, 21) bool: pixels that are true, put there by a person: their cost grows with the square, so that no
    number of other landmarks can outvote them. None: there are none"""
    kept: Kept | None = None
    """Poses that the hands are to stay near; None: there are none"""

    def __len__(self) -> int:
        return len(self.pixels)

    def select(self, index: Index) -> Observation:
        """The pictures of that index."""
        return replace(
            self, **{f.name: v[index] for f in fields(self) if (v := getattr(self, f.name)) is not None}
        )


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
        rays = intrinsics.rays(self.pixels.mean(axis=1))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        focal, centre = (intrinsics.fx, intrinsics.fy), (intrinsics.cx, intrinsics.cy)
        return Observation(
            pixels=self.pixels,
            pixel_sigma=self.pixel_sigma,
            depth=self.depth,
            depth_sigma=self.depth_sigma,
            ray=rays,
            focal=np.broadcast_to(focal, (len(rays), 2)),
            centre=np.broadcast_to(centre, (len(rays), 2)),
            pinned=self.pinned,
        )


def landmarked(detections: Sequence[HandDetection], side: Side, trust: Trust) -> Landmarked:
    """Correct detections, all taken for hands of that side."""
    parts = [
        _landmarked(detections[i : i + CHUNK], side, trust) for i in range(0, max(len(detections), 1), CHUNK)
    ]
    names = ("pixels", "pixel_sigma", "depth", "depth_sigma")
    return Landmarked(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _landmarked(detections: Sequence[HandDetection], side: Side, trust: Trust) -> Landmarked:
    sides: list[Side] = [side] * len(detections)
    seen = canonical(detections, sides)
    said = landmark_network()(seen)
    blend = np.array([trust.plane, trust.plane, trust.depth])
    points = seen.to_picture(seen.fused + blend * (said.points - seen.fused))
    sigma = np.maximum(np.maximum(said.sigma, trust.floor) * seen.size[:, None, None], LEAST_SIGMA)
    plane = trust.plane_sigma * sigma[..., :2].mean(axis=-1, keepdims=True).repeat(2, axis=-1)
    depth = points[..., 2] - points[..., 2].mean(axis=1, keepdims=True)
    return Landmarked(points[..., :2], plane, depth, trust.depth_sigma * sigma[..., 2])
