"""Moving hands: smooth ways from pose to pose and through the picture, 25 frames a second."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from typing import Final

import numpy as np

from handfit_core.common.skeleton import SIDES, other_side
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat

from .contact import clearance, penetration
from .kinematics import RightHand, hand_pose_from_angles, model_of
from .people import Placed, arm_capsules, beside, random_betas, random_hand
from .poses import POSES, random_pose
from .shots import Shot, ShotHand
from .stills import random_occluder, shot_hand
from .views import (
    LEAST_ANGLE_TO_ARM,
    facing,
    intrinsics_of,
    lens_tags,
    outside,
    random_focal_mm,
    random_standpoint,
    stand_off,
    view_name,
)

CLIPS: Final = 1
"""The kind in a clip's seed; `stills.STILLS` is the other"""
_KEY_FRAMES: Final = (14, 30)
"""Frames from one pose to the next"""
_DEEPEST: Final = 0.006
"""metres of skin on skin on the way between two poses"""
_MOST_OUTSIDE: Final = 8
"""Keypoints of a picture beyond its frame"""


def clip_shot(seed: int, number: int, frames: int, size: int) -> Shot:
    """The clip of that number, always the same: it depends on nothing but these four.

    It has `frames` pictures, `size` pixels square, and one key frame more at each end, for the blur.
    """
    rng = np.random.default_rng([seed, CLIPS, number])
    return next(filter(None, (_draw(rng, seed, number, frames, size) for _ in count())))


def _draw(rng: np.random.Generator, seed: int, number: int, frames: int, size: int) -> Shot | None:
    rows = frames + 2
    side = SIDES[rng.integers(2)]
    betas = random_betas(rng)
    hands = [random_hand(side, betas, rng, kinds=("relaxed", "open"))]
    if rng.random() < 0.3:
        second = random_hand(other_side(side), betas, rng, kinds=("relaxed", "open"))
        found = beside(hands[0], second, rng.uniform(0.045, 0.08), rng)
        if found is None:
            return None
        hands.append(found)
    fingers = [finger_motion(RightHand(betas), rows, rng) for _ in hands]
    if len(hands) == 2 and not _stay_apart(hands, fingers):
        return None

    focal_mm = random_focal_mm(rng)
    camera = intrinsics_of(focal_mm, size)
    coverage = rng.uniform(0.4, 0.65) if len(hands) > 1 else rng.uniform(0.3, 0.6)
    rested = np.concatenate([hand.points for hand in hands])
    for _ in range(30):
        arms = [hand.rotation @ hand.elbow for hand in hands]
        standpoint, view, roll = random_standpoint(arms, rng)
        rotations = rotvec_to_rotmat(_wander(rows, 20, 0.45, 3, rng)) @ facing(
            view, np.array([0.0, 0.0, 1.0]), roll
        )
        off_axis = camera.cx + _wander(rows, 22, 0.10 * size, 2, rng)
        rays = camera.rays(off_axis)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        distance = stand_off(rested @ rotations[rows // 2].T, camera, rays[rows // 2], coverage)
        if distance is None:
            continue
        centre = 0.5 * (rested.min(axis=0) + rested.max(axis=0))
        away = np.linalg.norm(rotations[rows // 2] @ centre + distance)
        depth = away * np.exp(_wander(rows, 35, 0.10, 1, rng))
        translations = depth * rays - rotations @ centre
        moving = [
            replace(shot_hand(h, rotations, translations), hand_pose=hand_pose_from_angles(f, h.side))
            for h, f in zip(hands, fingers, strict=True)
        ]
        if _well_seen(moving, hands, camera, rotations, translations, size):
            break
    else:
        return None

    points = [hand.keypoints() for hand in moving]
    surroundings = _hand_held(rows, rng)
    nearest = float(min(p[..., 2].min() for p in points)) - 0.02
    occluder, props = random_occluder(points[0][rows // 2], camera, nearest, rng)
    beyond = np.sum([outside(camera.project(p), size) for p in points], axis=0)
    return Shot(
        files=tuple(f"clips/{number:02d}/{t:04d}.jpg" for t in range(frames)),
        clip=f"{number:02d}",
        size=size,
        camera=camera,
        hands=tuple(moving),
        props=props,
        surroundings=surroundings,
        tags=tuple(
            {
                "pose": "motion",
                "hands": "one" if len(hands) == 1 else "two",
                "occluder": occluder,
                "framing": "cut" if beyond[t] else "whole",
                "view": view_name(_view(hands[0], rotations[t], translations[t]), side),
                "camera": standpoint,
                **lens_tags(focal_mm),
            }
            for t in range(1, rows - 1)
        ),
        look_seed=(seed, CLIPS, number, 1),
    )


def finger_motion(hand: RightHand, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 15, 3) angles in radians: from pose to pose with a short rest at each.

    Between two poses every angle eases from one value to the other, so all stay within their ranges.
    """
    kinds = tuple(POSES)
    here = random_pose(kinds[rng.integers(len(kinds))], hand, rng)
    motion: list[np.ndarray] = []
    while len(motion) < count:
        steps = int(rng.integers(*_KEY_FRAMES))
        eased = np.linspace(0.0, 1.0, steps, endpoint=False)
        eased = (eased**2 * (3 - 2 * eased))[:, None, None]
        best, depth = None, np.inf
        for _ in range(8):
            there = random_pose(kinds[rng.integers(len(kinds))], hand, rng)
            way = (1 - eased) * here + eased * there
            found = float(penetration(hand.keypoints(way), hand.scale).max())
            if found < depth:
                best, depth = (way, there), found
            if depth < _DEEPEST:
                break
        assert best is not None
        motion.extend(best[0])
        here = best[1]
        motion.extend([here] * int(rng.integers(0, 6)))
    return np.array(motion[:count])


def _wander(count: int, every: int, size: float, columns: int, rng: np.random.Generator) -> np.ndarray:
    """(count, columns): a smooth way through random points, one `every` so many frames (Catmull-Rom)."""
    keys = rng.normal(0.0, size, (count // every + 4, columns))
    at = np.arange(count) / every
    i, u = at.astype(int), (at % 1.0)[:, None]
    p0, p1, p2, p3 = keys[i], keys[i + 1], keys[i + 2], keys[i + 3]
    return 0.5 * (
        2 * p1 + (p2 - p0) * u + (2 * p0 - 5 * p1 + 4 * p2 - p3) * u**2 + (3 * p1 - p0 - 3 * p2 + p3) * u**3
    )


def _hand_held(count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 4, 4) motion of the room before a camera that is held by hand."""
    motion = np.tile(np.eye(4), (count, 1, 1))
    motion[:, :3, :3] = rotvec_to_rotmat(_wander(count, 20, 0.015, 3, rng))
    motion[:, :3, 3] = _wander(count, 20, 0.004, 3, rng)
    return motion


def _stay_apart(hands: list[Placed], fingers: list[np.ndarray]) -> bool:
    """True if two hands that only move their fingers never meet."""
    points = []
    for hand, angles in zip(hands, fingers, strict=True):
        poses = hand_pose_from_angles(angles, hand.side)
        zero = np.zeros((len(poses), 3))
        points.append(hand.carried(model_of(hand.side).keypoints(hand.betas, zero, poses, zero)))
    rows = range(0, len(points[0]), 3)
    return all(clearance(points[0][t], points[1][t], hands[0].scale) > 0.0 for t in rows)


def _view(hand: Placed, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(3,) direction from the hand to the camera in the hand's own frame."""
    towards = -(rotation @ hand.points.mean(axis=0) + translation)
    towards = hand.rotation.T @ rotation.T @ towards
    return towards / np.linalg.norm(towards)


def _well_seen(
    moving: list[ShotHand],
    hands: list[Placed],
    camera: Intrinsics,
    rotations: np.ndarray,
    translations: np.ndarray,
    size: int,
) -> bool:
    """True if the hands stay in the picture and before the camera, and the camera out of the sleeves."""
    points = np.concatenate([hand.keypoints() for hand in moving], axis=1)
    if points[..., 2].min() < 0.06:
        return False
    beyond = outside(camera.project(points), size)
    if beyond.max() > _MOST_OUTSIDE or np.mean(beyond > 0) > 0.2:
        return False
    for hand in hands:
        views = [_view(hand, r, t) for r, t in zip(rotations, translations, strict=True)]
        if np.any(np.array(views) @ hand.elbow > np.cos(LEAST_ANGLE_TO_ARM)):
            return False
        axis = arm_capsules(hand)[0] @ np.swapaxes(rotations, -1, -2) + translations[:, None]
        if np.linalg.norm(axis, axis=-1).min() < 0.08:
            return False
    return True
