"""Captured hands that an artist corrects: what is seen of them, how far points move and miss their pins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.detect.keypoints import Detections
from handfit_core.edit import RefineHand
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.motion import POSE_ARRAYS, HandMotion
from tests.core.fit.detections import (
    CAMERA,
    columns,
    fit_frames,
    keypoints_of,
    landmarks_of,
    poses,
    seen,
)

FPS = 25.0


def locked(*joints: int) -> np.ndarray:
    return np.isin(np.arange(16), joints)


def true_hands(side: Side, count: int, seed: int = 0) -> HandMotion:
    """Of one shape."""
    betas, *pose = poses(count, seed, side)
    return HandMotion(side, betas[0], *pose)


def captured(side: Side, detections: Sequence[Detections]) -> HandMotion:
    """Each frame by itself, with the mean of their shapes."""
    betas, *pose = fit_frames(side, detections).pose
    return HandMotion(side, betas.mean(axis=0), *pose)


def to_refine(
    motion: HandMotion, detections: Sequence[Detections | None], pins: Any = None, **fields: Any
) -> RefineHand:
    given = {"locked": locked(), "fps": FPS, **fields}
    given["pins"] = np.full((len(detections), 21, 2), np.nan) if pins is None else pins
    pose = (motion.side, motion.betas, *motion.pose)
    return RefineHand(*pose, intrinsics=CAMERA, detections=columns(detections), **given)


@cache
def photo(side: Side = "right", seed: int = 1, row: int = 1, noise: float = 2.0) -> RefineHand:
    """A hand seen with some noise, as captured."""
    points = landmarks_of(side, *rows_of(true_hands(side, 3, seed)))[row]
    detections = [seen(points, side, noise=noise, seed=seed)]
    return to_refine(captured(side, detections), detections)


def rows_of(motion: HandMotion) -> tuple[np.ndarray, ...]:
    return np.tile(motion.betas, (len(motion.transl), 1)), *motion.pose


def shown(motion: HandMotion) -> np.ndarray:
    """(T, 21, 2) pixels, by the mesh and not by the package's own function."""
    return CAMERA.project(landmarks_of(motion.side, *rows_of(motion)))


def joints_of(motion: HandMotion) -> np.ndarray:
    """(T, 21, 3) metres"""
    return keypoints_of(motion.side, *rows_of(motion))


def posed(hand: RefineHand, *pose: np.ndarray, **fields: Any) -> RefineHand:
    """With other poses, and fields that fit them."""
    return replace(hand, **dict(zip(POSE_ARRAYS, pose, strict=True)), **fields)


def drag(hand: RefineHand, by: Mapping[int, Sequence[float]], row: int = 0) -> RefineHand:
    """With points of one frame dragged by so many pixels from where they are."""
    pins, places = hand.pins.copy(), shown(hand)
    for point, pixels in by.items():
        pins[row, point] = places[row, point] + pixels
    return replace(hand, pins=pins)


def distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=-1)


def moved(hand: RefineHand, found: HandMotion) -> np.ndarray:
    """(21,) pixels, in the first frame"""
    return distance(shown(found), shown(hand))[0]


def missed(hand: RefineHand, found: HandMotion) -> np.ndarray:
    """(N,) pixels to each pin"""
    return distance(shown(found), hand.pins)[hand.pinned]


def turned(before: HandMotion, after: HandMotion) -> np.ndarray:
    """(T, 15) degrees between hand poses."""
    first, second = (rotvec_to_rotmat(one.hand_pose.reshape(-1, 15, 3)) for one in (before, after))
    return np.degrees(np.linalg.norm(rotmat_to_rotvec(first.swapaxes(-1, -2) @ second), axis=-1))
