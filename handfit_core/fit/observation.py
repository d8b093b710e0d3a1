"""What the solver fits to: corrected landmarks with their expected errors, seen through a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.batch import Batch
from handfit_core.detect.correction.corrected import Landmarked
from handfit_core.geometry.camera import Intrinsics


@dataclass(frozen=True, eq=False)
class Kept(Batch):
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
    limits_sigma: np.ndarray
    """(B,) radians beyond what joints can do when they are pressed (`terms.limits.PASSIVE_RANGE`), or beyond
    the kept angles where these go further, that cost as much as one sigma; NaN: as hands without a pose to
    keep have it"""


@dataclass(frozen=True, eq=False)
class Observation(Batch):
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


def observation_of(seen: Landmarked, intrinsics: Intrinsics) -> Observation:
    """Landmarks as seen through a camera."""
    rays = intrinsics.rays(seen.pixels.mean(axis=1))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    focal, centre = (intrinsics.fx, intrinsics.fy), (intrinsics.cx, intrinsics.cy)
    return Observation(
        pixels=seen.pixels,
        pixel_sigma=seen.pixel_sigma,
        depth=seen.depth,
        depth_sigma=seen.depth_sigma,
        ray=rays,
        focal=np.broadcast_to(focal, (len(rays), 2)),
        centre=np.broadcast_to(centre, (len(rays), 2)),
        pinned=seen.pinned,
    )
