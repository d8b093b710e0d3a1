"""How pins act on what a hand is fitted to. NumPy.

A pinned point's pixels are taken as true. The other points of its finger count the less, the farther the
pin lies from where the point was: so a dragged fingertip takes its finger along, as inverse kinematics
does, while the other fingers stay. A knuckle turns the palm about the wrist and takes all fingers along,
the wrist takes the palm along. A pin that lies where the point is already changes nothing.

A pose is corrected in two steps. First the fingers with pins beyond their knuckles go alone, bent no
farther than joints can be when they are pressed (10 degrees beyond what a person can do with them), or than
they were; palm and other fingers do not move at all. Where that brings
every point to within `REACHED` of its pin, that is the answer. Else the palm must follow: from that pose, it
and the fingers go for what is left, and the other fingers ride along. So the palm moves by about as much as
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

from handfit_core.detect.keypoints import Landmarked
from handfit_core.geometry.camera import Intrinsics
from handfit_core.skeleton import NUM_KEYPOINTS

PIN_SIGMA: Final = 0.2
"""pixels"""
REACHED_PIXELS: Final = 0.5
"""pixels from its pin: there a point has reached it"""
LIMITS_SIGMA: Final = float(np.radians(0.3))
"""radians beyond what pressed joints can do, as `Kept.limits_sigma` has it: pins are surer than landmarks,
and would bend fingers far beyond it where a capture's landmarks do not"""
POSE_SIGMA: Final = 0.005
"""of the hand's size in the picture: how firmly points of a pose that is corrected stay where they are"""
POSE_DEPTH_SIGMA: Final = 0.02
MIN_POSE_SIGMA: Final = 0.5
"""pixels, of points that are kept"""
SIGMA_PER_PIXEL: Final = 0.5
"""of a pin's displacement: what it adds to the expected errors of its finger's points"""
DEPTH_SIGMA_PER_PIXEL: Final = 1.0
WRIST_SHARE: Final = 0.5
"""of the wrist's displacement: how much all other points uncertainty theirs"""
HALF_BLEND: Final = 0.05
"""of the hand's size: displaced by so much, a finger's points are half the pose's and half the detector's"""
DISTANCE_SIGMA: Final = 0.002
"""of the wrist's distance: how firmly it is kept"""
PALM_DISTANCE_SIGMA: Final = 0.5
"""of a palm pin's displacement, in parts of the hand's size: what it adds to that"""
ANGLE_SIGMA: Final = 8.0
"""radians: how firmly angles of a finger in uncertainty are kept, per hand's size of its uncertainty"""
IDLE_SHARE: Final = 0.25
"""of that, for fingers without pins: they ride on a palm that is moved"""
MIN_ANGLE_SIGMA: Final = 0.002
NEIGHBOUR_SECONDS: Final = 0.25
"""seconds: frames up to so far from a pin uncertainty their own landmarks too, the farther the less"""

_FINGERS: Final = np.arange(1, NUM_KEYPOINTS).reshape(5, 4)
_PALM: Final = [0, *_FINGERS[:, 0]]


def landmarks_of_pose(points: np.ndarray, intrinsics: Intrinsics) -> Landmarked:
    """A pose's landmarks (N, 21, 3), metres, camera frame, as if a detector had seen them."""
    pixels = intrinsics.project(points)
    size = hand_sizes(pixels)[:, None]
    ray = points.mean(axis=1)
    distance = np.linalg.norm(ray, axis=1, keepdims=True)
    along = np.einsum("nkc,nc->nk", points, ray / distance)
    depth = (along - distance) * (0.5 * (intrinsics.fx + intrinsics.fy) / distance)
    sigma = np.maximum(POSE_SIGMA * size, MIN_POSE_SIGMA)
    return Landmarked(
        pixels,
        np.broadcast_to(sigma[..., None], pixels.shape).copy(),
        depth,
        np.broadcast_to(np.maximum(POSE_DEPTH_SIGMA * size, MIN_POSE_SIGMA), depth.shape).copy(),
    )


def displacement(pins: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(N, 21) pixels from where points are (N, 21, 2) to their pins (N, 21, 2); 0 where there is none."""
    return np.nan_to_num(np.linalg.norm(pins - pixels, axis=-1), nan=0.0)


def propagate(displaced: np.ndarray) -> np.ndarray:
    """(N, 21) displacements of pinned points -> how much each of a hand's points is to uncertainty its
    place."""
    uncertainty = displaced.copy()
    uncertainty[:, _FINGERS] = displaced[:, _FINGERS].max(axis=2, keepdims=True)
    # The palm turns about the wrist, and all fingers ride on it.
    knuckles = displaced[:, _FINGERS[:, 0]].max(axis=1, keepdims=True)
    uncertainty[:, 1:] = np.maximum(uncertainty[:, 1:], knuckles)
    return np.maximum(uncertainty, WRIST_SHARE * displaced[:, :1])


def finger_pins(pins: np.ndarray) -> np.ndarray:
    """(N, 21, 2) only the pins that a finger can move to by itself, which are those beyond its knuckle."""
    own = pins.copy()
    own[:, _PALM] = np.nan
    return own


def palm_displacement(displaced: np.ndarray) -> np.ndarray:
    """(N, 21) only the displacements of wrist and knuckles, else 0."""
    return np.where(np.isin(np.arange(NUM_KEYPOINTS), _PALM), displaced, 0.0)


def unpinned_fingers(pins: np.ndarray) -> np.ndarray:
    """(N, 21, 2) -> (N, 5) bool: fingers without a pin beyond their knuckle."""
    return np.asarray(np.isnan(finger_pins(pins)[:, _FINGERS, 0]).all(axis=2))


def hand_sizes(pixels: np.ndarray) -> np.ndarray:
    """(N, 21, 2) -> (N,) a hand's size in the picture, pixels."""
    return np.maximum(np.ptp(pixels, axis=1).max(axis=1), 1.0)


def distance_sigma(displaced: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(N, 21) displacements of pinned points, (N,) pixels -> (N,) how firmly the wrist's distance is
    kept, as a part of it."""
    return np.hypot(DISTANCE_SIGMA, PALM_DISTANCE_SIGMA * displaced[:, _PALM].max(axis=1) / size)


def angle_sigma(uncertainty: np.ndarray, size: np.ndarray, idle: np.ndarray) -> np.ndarray:
    """(N, 21) `followed`, (N,) pixels -> (N, 5) radians, how firmly the fingers' angles are kept. `idle` (N,
    5) bool: those that nothing moves by themselves."""
    of_finger = uncertainty[:, _FINGERS].max(axis=2) * np.where(idle, IDLE_SHARE, 1.0)
    return np.maximum(ANGLE_SIGMA * of_finger / size[:, None], MIN_ANGLE_SIGMA)


def unmoved_fingers(uncertainty: np.ndarray) -> np.ndarray:
    """(N, 21) `followed` -> (N, 5) bool: fingers that no pin moves."""
    return np.asarray(uncertainty[:, _FINGERS].max(axis=2) == 0.0)


def propagate_in_time(displaced: np.ndarray, frames: np.ndarray, fps: float) -> np.ndarray:
    """(N, 21) the same, with a part of what pins in neighbouring frames were displaced by: where the detector
    errs in one frame it errs in the next. `frames` (N,) rising."""
    spread = displaced.copy()
    reach = NEIGHBOUR_SECONDS * fps
    for row in np.flatnonzero(displaced.any(axis=1)):
        share = np.clip(1.0 - np.abs(frames - frames[row]) / (reach + 1.0), 0.0, 1.0)
        np.maximum(spread, share[:, None] * displaced[row], out=spread)
    return spread


def apply_pins(seen: Landmarked, pins: np.ndarray, uncertainty: np.ndarray) -> Landmarked:
    """`seen` with pins (N, 21, 2) in their place and (N, 21) `uncertainty` added to the expected errors."""
    at = np.asarray(np.isfinite(pins).all(axis=-1))
    sigma = np.hypot(seen.pixel_sigma, SIGMA_PER_PIXEL * uncertainty[..., None])
    return replace(
        seen,
        pixels=np.where(at[..., None], pins, seen.pixels),
        pixel_sigma=np.where(at[..., None], PIN_SIGMA, sigma),
        depth_sigma=np.hypot(seen.depth_sigma, DEPTH_SIGMA_PER_PIXEL * uncertainty),
        pinned=at,
    )


def blend_to_detection(seen: Landmarked, detected: Landmarked, uncertainty: np.ndarray) -> Landmarked:
    """`seen` of a pose, whose points go back to what `detected` has the more they are in uncertainty (N, 21),
    where that has numbers."""
    size = hand_sizes(seen.pixels)[:, None]
    share = np.square(uncertainty) / (np.square(uncertainty) + np.square(HALF_BLEND * size))

    def between(name: str) -> np.ndarray:
        mine, theirs = getattr(seen, name), getattr(detected, name)
        part = share.reshape(*share.shape, *[1] * (mine.ndim - 2))
        return np.where(np.isfinite(theirs), (1.0 - part) * mine + part * theirs, mine)

    return Landmarked(*(between(name) for name in ("pixels", "pixel_sigma", "depth", "depth_sigma")))
