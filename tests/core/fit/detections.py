"""What a perfect detector would say of posed hands, and poses to show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, JOINTS_BY_FINGER, Side
from handfit_core.detect.keypoints import Detections, Track
from handfit_core.fit import doubt
from handfit_core.fit.fast import fitter_of
from handfit_core.fit.solution import Solution
from handfit_core.fit.terms.limits import CLOSED_HAND_MARGIN
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.anatomy import anatomical_axes, joint_limits
from handfit_core.hand_model.landmarks import Landmarks, detector_landmarks
from handfit_core.paper.placement import turn_to_ray
from scripts.benchmark.kinematics import MIRROR_ROTVEC

CAMERA = Intrinsics(640.0, 640.0, 320.0, 240.0)
"""What the solver assumes of a picture of 640 x 480 pixels"""
Pose = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""betas (N, 10), global_orient (N, 3), hand_pose (N, 45) and transl (N, 3)"""


@cache
def model_of(side: Side) -> HandModel:
    return load_model("open-hand", side)


def poses(count: int, seed: int = 0, side: Side = "right") -> Pose:
    """Hands bent and spread at random, palm or back to the camera, fingers up, give or take 40 degrees."""
    rng = np.random.default_rng(seed)
    axes = anatomical_axes(model_of("right"))
    bend = np.zeros((count, 15))
    for finger, joints in FINGER_JOINTS.items():
        most = np.radians((20, 30, 40) if finger == "thumb" else (70, 80, 50))
        for level, joint in enumerate(joints):
            bend[:, joint - 1] = rng.uniform(0.05, 0.6) * most[level] * rng.uniform(0.7, 1.3, count)
    spread = np.zeros((count, 15))
    knuckles = [joints[0] - 1 for joints in FINGER_JOINTS.values()]
    spread[:, knuckles] = np.radians(rng.uniform(-2, 8, (count, 5)))
    pose = (bend[..., None] * axes[:, :, 2] + spread[..., None] * axes[:, :, 1]).reshape(count, 45)
    upright = rotvec_to_rotmat(np.array([-np.pi / 2, 0.0, 0.0]))
    turns = rotvec_to_rotmat(rng.normal(size=(count, 3)) * np.radians(25))
    flipped = rotvec_to_rotmat(np.outer(np.arange(count) % 2, [0.0, np.pi, 0.0]))
    orient = rotmat_to_rotvec(turns @ flipped @ upright)
    transl = np.stack(
        [rng.uniform(-0.12, 0.12, count), rng.uniform(-0.02, 0.14, count), rng.uniform(0.45, 0.7, count)], -1
    )
    right = rng.normal(size=(count, 10)) * 0.5, orient, pose, transl
    return right if side == "right" else mirrored(*right)


def mirrored(betas: np.ndarray, orient: np.ndarray, pose: np.ndarray, transl: np.ndarray) -> Pose:
    """The same parameters for the mirror image by x -> -x, of the other side's model."""
    flip = MIRROR_ROTVEC
    return betas, orient * flip, pose * np.tile(flip, 15), transl * np.array([-1.0, 1.0, 1.0])


def keypoints_of(side: Side, *pose: np.ndarray) -> np.ndarray:
    """(N, 21, 3) the model's own keypoints, by the mesh."""
    return np.array([model_of(side).keypoints(*one) for one in zip(*pose, strict=True)])


def landmarks_of(
    side: Side,
    betas: np.ndarray,
    orient: np.ndarray,
    pose: np.ndarray,
    transl: np.ndarray,
    landmarks: Landmarks | None = None,
) -> np.ndarray:
    """(N, 21, 3) the model's keypoints with offsets, by the mesh and not by `Chain.pose`."""
    model = model_of(side)
    points = keypoints_of(side, betas, orient, pose, transl)
    offsets = (landmarks or detector_landmarks()).in_metres(model)
    axes = anatomical_axes(model)
    rotations = rotvec_to_rotmat(pose.reshape(-1, 15, 3))
    world = rotvec_to_rotmat(orient)
    points[:, 0] += world @ offsets[0]
    for f, finger in enumerate(FINGERS):
        frame = world
        for level, joint in enumerate(FINGER_JOINTS[finger]):
            frame = frame @ rotations[:, joint - 1]
            points[:, 1 + 4 * f + level] += frame @ axes[joint - 1] @ offsets[1 + 4 * f + level]
        last = FINGER_JOINTS[finger][-1]
        points[:, 4 + 4 * f] += frame @ axes[last - 1] @ offsets[4 + 4 * f]
    return points


def seen(
    points: np.ndarray, side: Side, camera: Intrinsics = CAMERA, noise: float = 0.0, seed: int = 0
) -> Detections:
    """A detection of landmarks (21, 3): exact pixels; depth from the wrist and metres about the middle as if
    the camera looked at the hand, whose picture is all that a detector is given. `noise` in pixels."""
    rng = np.random.default_rng(seed)
    pixels = camera.project(points)
    along = points @ turn_to_ray(camera, pixels.mean(axis=0))
    per_pixel = along[:, 2].mean() / camera.fx
    keypoints = np.concatenate([pixels, (along[:, 2:] - along[0, 2]) / per_pixel], axis=1)
    return Detections.hand(
        side,
        0.97,
        keypoints + noise * rng.normal(size=(21, 3)),
        along - along.mean(axis=0) + noise * per_pixel * rng.normal(size=(21, 3)),
    )


def detections_of(side: Side, pose: Pose, noise: float = 0.0) -> list[Detections]:
    """Each of N hands as `seen`."""
    points = landmarks_of(side, *pose)
    return [seen(one, side, noise=noise, seed=seed) for seed, one in enumerate(points)]


def columns(hands: Sequence[Detections | None]) -> Detections:
    """One hand's detections in T frames; None where there is none."""
    return Detections.of([[] if hand is None else [hand] for hand in hands])


def track_of(side: Side, hands: Sequence[Detections | None], fps: float = 25.0) -> Track:
    """One hand's detections in T frames as a track."""
    return Track(side, columns(hands), len(hands), fps)


def mirror_image(detection: Detections, camera: Intrinsics = CAMERA) -> Detections:
    """What is seen when the picture is mirrored about the principal point."""
    keypoints, world = detection.keypoints.copy(), detection.world.copy()
    keypoints[..., 0] = 2 * camera.cx - keypoints[..., 0]
    world[..., 0] *= -1
    return replace(detection, side=1 - detection.side, keypoints=keypoints, world=world)


def ends_of_range(side: Side) -> tuple[np.ndarray, np.ndarray]:
    """(15, 3) radians: the least and the most that a hand bends joints to, closed as far as it goes."""
    ranges, closed = joint_limits(side), np.zeros((15, 3))
    closed[JOINTS_BY_FINGER - 1] = CLOSED_HAND_MARGIN.reshape(5, 3, 3)
    return ranges.lower, ranges.upper + closed


def laid_error(found: np.ndarray, aims: np.ndarray) -> np.ndarray:
    """(N,) metres, mean over the points after similarity transforms."""
    laid = np.array([align(f, a, with_scale=True).apply(f) for f, a in zip(found, aims, strict=True)])
    return np.linalg.norm(laid - aims, axis=-1).mean(axis=1)


class FrameFits(NamedTuple):
    """B pictures of hands, each fitted by itself."""

    pose: Pose
    solution: Solution
    expected_error: np.ndarray
    """(B, 5) metres"""

    @property
    def doubtful(self) -> np.ndarray:
        return doubt.doubtful(self.expected_error)


def fit_frames(side: Side, hands: Sequence[Detections], hand_length: float | None = None) -> FrameFits:
    fitter, detections = fitter_of(model_of(side), hand_length), columns(hands)
    seen, solution = fitter.solve_pictures(fitter.observe(detections, CAMERA))
    evidence = doubt.evidence(seen, fitter.chain.points(solution.state), doubt.side_logits(detections, side))
    factor = doubt.crop_spread_factor(detections) * doubt.lifted_thumb_factor(seen)
    return FrameFits(
        fitter.chain.parameters(solution.state), solution, doubt.expected_error(evidence, factor)
    )
