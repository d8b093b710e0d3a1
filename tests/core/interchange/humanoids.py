"""Takes for humanoids, and what a humanoid's hands are to look like then, by the take's joints alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model.poses import ready_poses
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, KEYPOINT_SOURCE, SIDES, Side
from handfit_core.take import HandTrack, Take
from tests.takes import take_of, track_of

CAMERA = Intrinsics.assumed(320, 240)
POSES = ("Flat", "Fist", "Pinch")
UNSEEN = 2
"""The row in which the left hand is not there"""
NUMBERS = np.array([10, 11, 12, 14, 15])


def clip(sides: Sequence[Side] = SIDES, **fields) -> Take:
    """Flat, fist, pinch and two random poses, each hand turned otherwise; the left one is not always seen."""
    rng, tracks = np.random.default_rng(5), []
    for side in sides:
        ready = [ready_poses()[name].pose.on(side) for name in POSES]
        pose = np.concatenate([ready, rng.normal(scale=0.4, size=(2, 45))])
        seen = np.arange(len(NUMBERS)) != (UNSEEN if side == "left" else -1)
        given = rng.normal(size=(5, 3)), pose, np.tile([0.0, 0.0, 0.6], (5, 1))
        track = track_of(side, *given, CAMERA, detected=seen)
        known = {
            name: np.where(seen.reshape(-1, *[1] * (np.ndim(values) - 1)), values, np.nan)
            for name in ("global_orient", "hand_pose", "transl", "joints_3d", "keypoints_2d")
            for values in [getattr(track, name)]
        }
        tracks.append(replace(track, **known))
    return take_of(tracks, CAMERA, 320, 240, **{"frame_numbers": NUMBERS, "fps": 20.0} | fields)


def wanted(track: HandTrack, row: int | np.integer) -> np.ndarray:
    """(15, 3) where a hand's segments point, seen from the hand, which lies as in VRM's T-pose: MANO's model
    frame has the same axes."""
    points = np.empty((21, 3))
    points[list(KEYPOINT_SOURCE)] = track.joints_3d[row]
    return directions((points - points[0]) @ rotvec_to_rotmat(track.global_orient[row]))


def directions(points: np.ndarray) -> np.ndarray:
    """(15, 3) unit vectors of each finger's three segments, from joints and fingertips (21, 3)."""
    found = np.array(
        [
            points[[second, third, 16 + f]] - points[[first, second, third]]
            for f, (first, second, third) in enumerate(FINGER_JOINTS[finger] for finger in FINGERS)
        ]
    ).reshape(-1, 3)
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """The largest angle between directions, in degrees."""
    return float(np.degrees(2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2.0, 0.0, 1.0))).max())


def named(places: Mapping[str, Sequence[float] | np.ndarray], side: str) -> np.ndarray:
    """(21, 3) a hand's joints and fingertips, from the places of a humanoid's bones by VRM's names."""
    order = [f"{side}Hand"] * 16
    for finger, joints in FINGER_JOINTS.items():
        first = "Metacarpal" if finger == "thumb" else "Proximal"
        parts = (first, "Proximal" if finger == "thumb" else "Intermediate", "Distal")
        for joint, part in zip(joints, parts, strict=True):
            order[joint] = f"{side}{finger.title()}{part}"
    return np.array([places[name] for name in [*order, *(f"{side}{f.title()}Tip" for f in FINGERS)]])
