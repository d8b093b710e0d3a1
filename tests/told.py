"""Two hands that move, for tests that write them in other programs' layouts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import mirrored_pose
from handfit_core.hand_model.poses import FILE
from handfit_core.take import Take
from tests.takes import take_of, track_of

WIDTH, HEIGHT = 960, 540
CAMERA = Intrinsics(900.0, 900.0, 480.0, 270.0)
FRAMES = 6


@dataclass(frozen=True)
class Told:
    """A hand of both sides over six frames: a relaxed hand that closes, its back to the camera."""

    pixels: dict[Side, np.ndarray]
    """(6, 21, 2)"""
    depth: dict[Side, np.ndarray]
    """(6, 21) pixels, towards the scene, from the wrist"""
    points: dict[Side, np.ndarray]
    """(6, 21, 3) metres, camera frame, of the joints"""
    world: dict[Side, np.ndarray]
    """(6, 21, 3) metres about the middle"""
    take: Take


def told() -> Told:
    """The same hands every time."""
    ready = np.load(FILE)
    by_name = dict(zip(ready["names"].tolist(), ready["hand_poses"], strict=True))
    closed = by_name["Fist"]
    share = np.linspace(0.2, 0.9, FRAMES)[:, None]
    poses = share * closed
    orient = np.tile([0.0, 0.0, 1.4], (FRAMES, 1)) + 0.2 * share
    tracks, pixels, depth, points, world = [], {}, {}, {}, {}
    for side, x in zip(SIDES, (0.2, -0.2), strict=True):
        turned, bent = (orient, poses) if side == "right" else mirrored_pose(orient, poses)
        transl = np.column_stack([np.full(FRAMES, x), np.linspace(0.0, 0.03, FRAMES), np.full(FRAMES, 0.7)])
        tracks.append(track_of(side, turned, bent, transl, CAMERA))
        joints = load_model("open-hand", side).keypoints(None, turned, bent, transl)
        points[side], pixels[side] = joints, CAMERA.project(joints)
        depth[side] = (joints[..., 2] - joints[:, :1, 2]) * CAMERA.fx / joints[:, :1, 2]
        world[side] = joints - joints.mean(axis=1, keepdims=True)
    return Told(pixels, depth, points, world, take_of(tracks, CAMERA, WIDTH, HEIGHT))
