"""People whose arms and hands are known, and what a perfect body network would see of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.capturing.arms import _axes
from handfit_core.common.skeleton import SIDES
from handfit_core.detect.body import ELBOWS, NUM_BODY_POINTS, SHOULDERS, WRISTS, BodyTrack
from handfit_core.fit.arms import ARMS
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model import load_model
from handfit_core.take import HandTrack
from tests.takes import track_of

CAMERA = Intrinsics(1000.0, 1000.0, 640.0, 360.0)
FPS = 25.0


@dataclass(frozen=True)
class Person:
    """Both arms of somebody who gestures before the camera, T frames."""

    hands: tuple[HandTrack, HandTrack]
    points: np.ndarray
    """(2, T, 3, 3) metres: shoulder, elbow and wrist, left and right"""
    body: BodyTrack


def person(
    count: int = 60,
    distance: float = 1.2,
    speed: float = 1.0,
    bend: float = 0.0,
    build: tuple[float, float] = (1.0, 1.0),
) -> Person:
    """`speed` 0 holds still; `bend`, radians, is the wrists'; `build`: how much longer upper arms and
    forearms are than most people's with such hands."""
    time = speed * np.arange(count) / FPS
    hands, arms = [], []
    for side, mirror in zip(SIDES, (1.0, -1.0), strict=True):
        model = load_model("open-hand", side)
        rest = track_of(side, np.zeros((1, 3)), np.zeros((1, 45)), np.zeros((1, 3)), CAMERA)
        bones = np.diff(rest.joints_3d[0, [0, 9, 10, 11, 12]], axis=0)
        length = float(np.linalg.norm(bones, axis=1).sum())
        wave = 0.3 * np.sin(2.0 * time + mirror)
        upper = _unit(np.stack([0.25 * mirror + wave, 0.9 + 0.0 * time, -0.35 + 0.5 * wave], axis=1))
        forearm = _unit(np.stack([-0.35 * mirror + wave, -0.6 + wave, -0.5 + 0.0 * time], axis=1))
        sway = 0.02 * np.sin(time)[:, None] * [1.0, 0.0, 0.5]
        shoulder = sway + [0.5 * mirror * ARMS.shoulders * length, 0.0, distance]
        elbow = shoulder + build[0] * ARMS.upper_arm * length * upper
        wrist = elbow + build[1] * ARMS.forearm * length * forearm
        # The palm faces the camera, more or less.
        normal = _unit(np.cross(forearm, [1.0, 0.2, 0.0]))
        along = np.cos(bend) * forearm + np.sin(bend) * normal
        normal = np.cos(bend) * normal - np.sin(bend) * forearm
        wanted = np.stack([along, normal, np.cross(normal, along)], axis=1)
        turn = wanted.swapaxes(1, 2) @ _axes(rest)[0]
        orient = rotmat_to_rotvec(turn)
        hands.append(track_of(side, orient, np.zeros((count, 45)), wrist - model.shaped().joints[0], CAMERA))
        arms.append(np.stack([shoulder, elbow, wrist], axis=1))
    points = np.stack(arms)
    return Person((hands[0], hands[1]), points, body_of(points))


def body_of(points: np.ndarray, noise: float = 0.0) -> BodyTrack:
    """What is seen of arms (2, T, 3, 3); `noise`: metres, of each point in each frame by itself."""
    count = points.shape[1]
    noisy = points + noise * np.random.default_rng(0).normal(size=points.shape)
    pixels, world = np.full((count, NUM_BODY_POINTS, 2), 0.0), np.zeros((count, NUM_BODY_POINTS, 3))
    for arm, side in zip(noisy, SIDES, strict=True):
        of_arm = [of[side] for of in (SHOULDERS, ELBOWS, WRISTS)]
        pixels[:, of_arm] = CAMERA.project(arm)
        world[:, of_arm] = arm - noisy[:, :, 0].mean(axis=0)[:, None]
    return BodyTrack(
        keypoints=pixels,
        visibility=np.full((count, NUM_BODY_POINTS), 0.95),
        world=world,
        score=np.full(count, 0.9),
        present=np.ones(count, dtype=bool),
        cut=np.zeros(count, dtype=bool),
    )


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
