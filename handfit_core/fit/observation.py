"""What the solver fits to: corrected landmarks with their expected errors, seen through a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.batch import Batch
from handfit_core.detect.keypoints import Landmarked
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.chain import State


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


def kept_at_distance(state: State, sigma: np.ndarray) -> Kept:
    """B hands of which nothing but the wrist's distance is kept; `sigma` (B,) as a part of it."""
    return Kept(
        state.wrist, sigma, state.angles, np.full(state.angles.shape[:2], np.inf), np.full(len(sigma), np.nan)
    )


@dataclass(frozen=True, eq=False)
class Meeting(Batch):
    """What is seen of parts that meet, of B hands. The pairs are those of
    `geometry.crossing.CROSSING`."""

    along: np.ndarray
    """(B, Q, 2) how far along their bones pairs of `CROSSING` cross in the picture, 0..1"""
    front: np.ndarray
    """(B, Q) 1 where the first is in front, -1 where it is behind, 0 where they do not cross"""
    apart: np.ndarray
    """(B, Q) metres along the line of sight from the one's axis to the other's, where their skins touch"""
    lying: np.ndarray
    """(B, Q) how sure it is that one lies on the other where they cross, 0..1"""
    standing_off: np.ndarray
    """(B,) bool: whether the thumb seems to stand far off a bent finger that it crosses, as it hardly does"""
    touching: np.ndarray
    """(B, T) how sure it is that pairs of `fit.meeting.TIPS` touch, 0..1"""


@dataclass(frozen=True, eq=False, kw_only=True)
class Observation(Landmarked):
    """Landmarks of B pictures of one model's hand, seen through a camera. Pixels, camera frame; depth is in
    pixels at the hand's distance."""

    ray: np.ndarray
    """(B, 3) unit line of sight"""
    focal: np.ndarray
    """(B, 2) pixels"""
    centre: np.ndarray
    """(B, 2) pixels"""
    depth_zero: np.ndarray | None = None
    """(B,) metres along the line of sight where depth is zero, NaN where that is not known; None: nowhere"""
    kept: Kept | None = None
    """Poses that the hands are to stay near; None: there are none"""
    meeting: Meeting | None = None
    """Where their parts meet; None: nobody has asked"""
    touches: np.ndarray | None = None
    """(B, 21) which other keypoint each one touches for certain, 0 being the palm; NaN, or None: none"""


def lines_of_sight(pixels: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(B, 3) unit vectors towards the means of points (B, 21, 2) in pixels."""
    rays = intrinsics.rays(pixels.mean(axis=1))
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def observation_of(
    seen: Landmarked, intrinsics: Intrinsics, depth_zero: np.ndarray | None = None
) -> Observation:
    """Landmarks as seen through a camera, of which depth is zero at `depth_zero` (B,) metres."""
    rays = lines_of_sight(seen.pixels, intrinsics)
    focal, centre = (intrinsics.fx, intrinsics.fy), (intrinsics.cx, intrinsics.cy)
    return Observation(
        **vars(seen),
        ray=rays,
        focal=np.broadcast_to(focal, (len(rays), 2)),
        centre=np.broadcast_to(centre, (len(rays), 2)),
        depth_zero=depth_zero,
    )
