"""How pins change the landmarks that a hand is fitted to. NumPy.

A pinned point's pixels are taken as true. The other points of its finger become the more uncertain, the
farther the pin lies from where the point was: so a dragged fingertip takes its finger along, as inverse
kinematics does, while the other fingers stay. A knuckle turns the palm about the wrist and takes all fingers
along, the wrist takes the palm along. A pin that lies where the point is already changes nothing.

A pose is corrected in two steps. First the fingers with pins beyond their knuckles go alone, bent no
farther than joints can be when they are pressed (10 degrees beyond what a person can do with them), or than
they were; palm and other fingers do not move at all. Where that brings every point to within `reached_pixels`
of its pin, that is the answer. Else the palm must follow: from that pose, it and the fingers go for what is
left, and the other fingers ride along. So the palm moves by about as much as
the fingers fall short, and nothing jumps where they begin to. Pins of the wrist and of knuckles move the
palm by their nature: no finger can bring them nearer.

A picture hardly tells how far away a hand is: a pin that a finger cannot reach would draw the whole hand
nearer. So the wrist's distance is kept, the less firmly the farther a pin moves the palm itself.

Pins come after the landmark network (`detect.correction`), which knows detectors and not artists.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from handfit_core.common.skeleton import NUM_KEYPOINTS
from handfit_core.detect.keypoints import Landmarked
from handfit_core.edit.settings import PINS
from handfit_core.geometry.camera import Intrinsics

_FINGERS: Final = np.arange(1, NUM_KEYPOINTS).reshape(5, 4)
_PALM: Final = [0, *_FINGERS[:, 0]]


def landmarks_of_pose(points: np.ndarray, intrinsics: Intrinsics) -> Landmarked:
    """Return the landmarks of poses as if a detector had seen them, from `points` (N, 21, 3) in metres,
    camera frame."""
    pixels = intrinsics.project(points)
    size = hand_sizes(pixels)[:, None]
    ray = points.mean(axis=1)
    distance = np.linalg.norm(ray, axis=1, keepdims=True)
    along = np.einsum("nkc,nc->nk", points, ray / distance)
    depth = (along - distance) * (0.5 * (intrinsics.fx + intrinsics.fy) / distance)
    sigma = np.maximum(PINS.pose_sigma * size, PINS.min_pose_sigma)
    return Landmarked(
        pixels,
        np.broadcast_to(sigma[..., None], pixels.shape).copy(),
        depth,
        np.broadcast_to(np.maximum(PINS.pose_depth_sigma * size, PINS.min_pose_sigma), depth.shape).copy(),
    )


def displacement(pins: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return how many pixels (N, 21) each point, at (N, 21, 2), lies from its pin, at (N, 21, 2); 0 where
    there is no pin."""
    return np.nan_to_num(np.linalg.norm(pins - pixels, axis=-1), nan=0.0)


def propagate(displaced: np.ndarray) -> np.ndarray:
    """Return how many pixels (N, 21) all points become uncertain when pinned points are displaced by (N, 21)
    pixels."""
    uncertainty = displaced.copy()
    uncertainty[:, _FINGERS] = displaced[:, _FINGERS].max(axis=2, keepdims=True)
    # The palm turns about the wrist, and all fingers ride on it.
    knuckles = displaced[:, _FINGERS[:, 0]].max(axis=1, keepdims=True)
    uncertainty[:, 1:] = np.maximum(uncertainty[:, 1:], knuckles)
    return np.maximum(uncertainty, PINS.wrist_share * displaced[:, :1])


def finger_pins(pins: np.ndarray) -> np.ndarray:
    """Return the pins (N, 21, 2) in pixels without those of the palm, as a finger reaches by itself only
    those beyond its knuckle."""
    own = pins.copy()
    own[:, _PALM] = np.nan
    return own


def palm_displacement(displaced: np.ndarray) -> np.ndarray:
    """Return the displacements (N, 21), in pixels, of wrist and knuckles, and 0 for the other points."""
    return np.where(np.isin(np.arange(NUM_KEYPOINTS), _PALM), displaced, 0.0)


def unpinned_fingers(pins: np.ndarray) -> np.ndarray:
    """Tell which fingers have no pin beyond their knuckle: (N, 5) bool, from pins (N, 21, 2) in pixels."""
    return np.asarray(np.isnan(finger_pins(pins)[:, _FINGERS, 0]).all(axis=2))


def hand_sizes(pixels: np.ndarray) -> np.ndarray:
    """Return the sizes (N,), in pixels, of hands in the picture whose points are at `pixels` (N, 21, 2)."""
    return np.maximum(np.ptp(pixels, axis=1).max(axis=1), 1.0)


def distance_sigma(displaced: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return how far the wrist's distance may deviate, (N,) sigmas relative to it, when pinned points of
    hands of `size` (N,) pixels are displaced by (N, 21) pixels."""
    most = displaced[:, _PALM].max(axis=1)
    return np.hypot(PINS.distance_sigma, PINS.palm_distance_sigma * most / size)


def angle_sigma(uncertainty: np.ndarray, size: np.ndarray, idle: np.ndarray) -> np.ndarray:
    """Return how far the fingers' angles may deviate, (N, 5) sigmas in radians, from pixels of uncertainty
    (N, 21) of hands of `size` (N,) pixels. `idle`: (N, 5) bool, true for fingers that neither pins nor
    touches move by themselves."""
    of_finger = uncertainty[:, _FINGERS].max(axis=2) * np.where(idle, PINS.idle_share, 1.0)
    return np.maximum(PINS.angle_sigma * of_finger / size[:, None], PINS.min_angle_sigma)


def unmoved_fingers(uncertainty: np.ndarray) -> np.ndarray:
    """Tell which fingers have no uncertain point: (N, 5) bool, from pixels of uncertainty (N, 21)."""
    return np.asarray(uncertainty[:, _FINGERS].max(axis=2) == 0.0)


def propagate_in_time(displaced: np.ndarray, frames: np.ndarray, fps: float) -> np.ndarray:
    """Return the displacements (N, 21), in pixels, of pinned points, or a share of those in neighbouring
    frames where that is larger: where the detector errs in one frame it errs in the next. `frames`: (N,)
    frame numbers, rising; `fps`: frames per second."""
    spread = displaced.copy()
    reach = PINS.neighbour_seconds * fps
    for row in np.flatnonzero(displaced.any(axis=1)):
        share = np.clip(1.0 - np.abs(frames - frames[row]) / (reach + 1.0), 0.0, 1.0)
        np.maximum(spread, share[:, None] * displaced[row], out=spread)
    return spread


def apply_pins(seen: Landmarked, pins: np.ndarray, uncertainty: np.ndarray) -> Landmarked:
    """Return the landmarks `seen` with pins (N, 21, 2), in pixels, in their place, and with `uncertainty`
    (N, 21) in pixels added to the expected errors."""
    at = np.asarray(np.isfinite(pins).all(axis=-1))
    sigma = np.hypot(seen.pixel_sigma, PINS.sigma_per_pixel * uncertainty[..., None])
    return replace(
        seen,
        pixels=np.where(at[..., None], pins, seen.pixels),
        pixel_sigma=np.where(at[..., None], PINS.pin_sigma, sigma),
        depth_sigma=np.hypot(seen.depth_sigma, PINS.depth_sigma_per_pixel * uncertainty),
        pinned=at,
    )


def blend_to_detection(seen: Landmarked, detected: Landmarked, uncertainty: np.ndarray) -> Landmarked:
    """Return the landmarks `seen` of a pose, moved towards the `detected` ones the more, the larger their
    `uncertainty` (N, 21) in pixels. Where nothing is detected (NaN) they stay."""
    size = hand_sizes(seen.pixels)[:, None]
    share = np.square(uncertainty) / (np.square(uncertainty) + np.square(PINS.half_blend * size))

    def between(name: str) -> np.ndarray:
        mine, theirs = getattr(seen, name), getattr(detected, name)
        part = share.reshape(*share.shape, *[1] * (mine.ndim - 2))
        return np.where(np.isfinite(theirs), (1.0 - part) * mine + part * theirs, mine)

    return Landmarked(*(between(name) for name in ("pixels", "pixel_sigma", "depth", "depth_sigma")))
