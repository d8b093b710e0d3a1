"""What the lifter learns from: projections of the open hand, made anew for every epoch, and spoilt.

Pictures have sides of one and the middle at nought; hands are right ones, since the lifter mirrors left ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import torch

from handfit_core.detect.correction.canonical import Canonical
from handfit_core.detect.correction.network import LOG_SIGMA, MAX_FEATURE
from handfit_core.fit.observation import lines_of_sight
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import turn_from_axis
from handfit_core.hand_model.chain import Chain, State
from handfit_core.hand_model.landmarks import detector_landmarks
from handfit_core.interchange.lift import FEATURES, Plane, canonical_plane
from handfit_core.interchange.recording import LEAST_POINTS
from handfit_core.skeleton import JOINTS_BY_FINGER, NUM_BETAS, NUM_KEYPOINTS
from scripts.benchmark.closed import CLOSED, closed_pose
from scripts.benchmark.kinematics import RightHand, model_of
from scripts.benchmark.people import random_betas
from scripts.benchmark.poses import POSES, random_pose
from scripts.benchmark.views import FOCAL_MM, LEAST_ANGLE_TO_ARM

HIDDEN: Final = 256
EPOCHS: Final = 100
BATCH: Final = 256
DROPOUT: Final = 0.05
"""Of both hidden layers, while it learns"""
COVERAGE: Final = (0.06, 0.80)
"""Longer side of a hand's box over the picture's: that of the whole body's keypoints is small"""
MIXED: Final = 0.4
"""Of the hands of an epoch, those that are on the way from one pose to another"""
NOISE: Final = (0.008, 0.06)
"""What points err, of the hand's size in the picture as if it were seen from its front: least and most"""
_SIZE: Final = 0.075
"""metres, that size: a palm's length"""
CONVENTION: Final = 0.002
"""metres that a program's idea of a point lies from ours"""
FINGERS: Final = 1.0
"""of a point's noise: what all points of a finger err together"""
LOOSE: Final = 0.4
"""radians that frames are turned where points are missing, and parts of the size that they are moved and
wider"""
WILD: Final = 0.01
"""of the points are somewhere near the hand"""


def poses_of(seed: int, each: int, each_closed: int) -> np.ndarray:
    """(N, 15, 3) angles in radians of right hands: so many of each usual kind, and of each closed one."""
    kinds = [kind for kind in POSES for _ in range(each)] + [
        kind for kind in CLOSED for _ in range(each_closed)
    ]
    found = []
    for number, kind in enumerate(kinds):
        rng = np.random.default_rng([seed, number])
        draw = closed_pose if kind in CLOSED else random_pose
        found.append(draw(kind, RightHand(random_betas(rng)), rng))
    return np.array(found)


def samples_of(angles: np.ndarray, plane: Plane, rng: np.random.Generator) -> tuple[Canonical, np.ndarray]:
    """A view of each pose (N, 15, 3), as a program tells of it, and (N, 21, 3) where the points truly are, in
    the canonical frame, as `learn.targets` has them."""
    truth, size = _pictures(angles, rng)
    seen, confidence = _spoilt(truth[..., :2], size, rng)
    canonical = canonical_plane(plane, seen, confidence, np.zeros(len(seen), dtype=bool))
    return canonical, canonical.from_picture(truth)


def plane_of(angles: np.ndarray, rng: np.random.Generator) -> Plane:
    """Mean and covariance of complete hands in those poses, framed as loosely as hands are of which points
    are missing: a frame that were exact would hold guesses to where it was laid first."""
    truth, _ = _pictures(angles, rng)
    nobody = Plane(np.zeros(2 * NUM_KEYPOINTS), np.eye(2 * NUM_KEYPOINTS))
    ones, right = np.ones(truth.shape[:2]), np.zeros(len(truth), dtype=bool)
    points = canonical_plane(nobody, truth[..., :2], ones, right).fused[..., :2]
    turn = rng.normal(0.0, LOOSE, len(truth))
    sin, cos = np.sin(turn), np.cos(turn)
    around = np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)
    scale = np.exp(rng.normal(0.0, LOOSE, len(truth)))[:, None, None]
    points = scale * points @ np.swapaxes(around, 1, 2) + rng.normal(0.0, LOOSE, (len(truth), 1, 2))
    points = points.reshape(len(truth), -1)
    return Plane(points.mean(axis=0), np.cov(points.T))


def _pictures(angles: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(N, 21, 3) where points are in pictures, with their depth, and the hands' sizes (N,) there as if they
    were seen from the front."""
    points, focal = _before_cameras(_hands(_mixed(angles, rng), rng), rng)
    pixels = focal[:, None, None] * points[..., :2] / points[..., 2:]
    ray = lines_of_sight(pixels, Intrinsics(1.0, 1.0, 0.0, 0.0))
    along = (points @ ray[..., None])[..., 0]
    mean = along.mean(axis=1, keepdims=True)
    depth = (along - mean) * focal[:, None] / mean
    return np.concatenate([pixels, depth[..., None]], axis=2), focal * _SIZE / mean[:, 0]


def _mixed(angles: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    part = rng.uniform(0.0, 1.0, (len(angles), 1, 1)) * (rng.random((len(angles), 1, 1)) < MIXED)
    return angles + part * (angles[rng.permutation(len(angles))] - angles)


def _hands(angles: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(N, 21, 3) metres, each hand with a shape of its own, about their middle."""
    chain = Chain(model_of("right"), detector_landmarks())
    count = len(angles)
    betas = np.clip(rng.normal(size=(count, NUM_BETAS)), -2.0, 2.0)
    of_fingers = angles[:, JOINTS_BY_FINGER - 1].reshape(count, 5, 9)
    root = np.broadcast_to(np.eye(3), (count, 3, 3))
    points = chain.points(State(root, of_fingers, np.zeros((count, 3)), betas, np.zeros(count)))
    points = points + rng.normal(0.0, CONVENTION, points.shape)
    return points - points.mean(axis=1, keepdims=True)


def _before_cameras(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(N, 21, 3) in cameras' frames, and their focal lengths (N,), of views as `benchmark.views` has them."""
    count = len(points)
    usual = rng.random(count) < 0.5
    view = rng.normal(size=(count, 3)) * np.where(usual, 0.45, 1.0)[:, None]
    view[:, 1] += usual * rng.choice([-1.0, 1.0], count)
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    # A right hand's arm comes from +x.
    view[view[:, 0] > np.cos(LEAST_ANGLE_TO_ARM), 0] *= -1.0
    roll = rng.uniform(-np.pi, np.pi, count)
    around = np.zeros((count, 3, 3))
    around[:, 0, 0] = around[:, 1, 1] = np.cos(roll)
    around[:, 1, 0], around[:, 0, 1], around[:, 2, 2] = np.sin(roll), -np.sin(roll), 1.0
    # The view turns against the line of sight: it goes to +z, then half a turn about x leads to -z.
    facing = around @ np.diag([1.0, -1.0, -1.0]) @ np.swapaxes(turn_from_axis(_off_pole(view)), 1, 2)
    focal = _between(FOCAL_MM, rng, count) / 36.0
    turned = points @ np.swapaxes(facing, 1, 2)
    extent = np.ptp(turned[..., :2], axis=1).max(axis=1)
    distance = focal * extent / _between(COVERAGE, rng, count)
    distance = np.maximum(distance, 0.05 - turned[..., 2].min(axis=1))
    middle = rng.uniform(-0.4, 0.4, (count, 2)) / focal[:, None]
    ray = np.concatenate([middle, np.ones((count, 1))], axis=1)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    placed = (
        turned @ np.swapaxes(turn_from_axis(ray), 1, 2) + (ray * (distance / ray[:, 2])[:, None])[:, None]
    )
    nearest = np.maximum(0.03 - placed[..., 2].min(axis=1), 0.0)
    placed[..., 2] += nearest[:, None]
    return placed, focal


def _between(ends: tuple[float, float], rng: np.random.Generator, shape: int | tuple[int, int]) -> np.ndarray:
    """Numbers uniform in their logarithm."""
    low, high = np.log(ends)
    return np.exp(rng.uniform(low, high, shape))


def _off_pole(view: np.ndarray) -> np.ndarray:
    """Directions (N, 3) that `turn_from_axis` leads to: it knows no way to -z itself."""
    return np.where(view[:, 2:] > -0.9999, view, np.array([0.01, 0.0, -0.9999]))


def _spoilt(pixels: np.ndarray, size: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 21, 2) of hands of that size (N,) as a program finds them, NaN where it does not, and how
    sure it says it is (N, 21)."""
    count = len(pixels)
    level = _between(NOISE, rng, (count, 1))
    of_point = level * np.exp(rng.normal(0.0, 0.5, (count, NUM_KEYPOINTS)))
    of_finger = FINGERS * level * rng.random((count, 1))
    shift = np.zeros((count, NUM_KEYPOINTS, 2))
    shift[:, 1:] = (of_finger[..., None] * rng.normal(size=(count, 5, 2))).repeat(4, axis=1)
    wild = rng.random(of_point.shape) < WILD
    error = np.where(wild, 0.7, of_point)[..., None] * rng.normal(size=pixels.shape) + shift
    # Programs mean different things by their confidence; some tell none.
    slope = rng.uniform(0.0, 0.35, (count, 1)) * (rng.random((count, 1)) < 0.8)
    best = rng.uniform(0.6, 1.0, (count, 1)) ** (slope > 0)
    surer = np.log(np.where(wild, 0.5, of_point) / NOISE[0])
    told = best - slope * np.maximum(surer, 0.0) + 0.05 * (slope > 0) * rng.normal(size=of_point.shape)
    told = np.clip(told, 0.02, 1.0)
    seen = pixels + error * size[:, None, None]
    seen[~_found(pixels, rng)] = np.nan
    return seen, told


def _found(pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(N, 21) bool: all points of half the hands; of others single ones are missing, whole fingers, or what
    lies beyond a line."""
    count = len(pixels)
    kind = rng.random((count, 1))
    single = rng.random((count, NUM_KEYPOINTS)) < rng.uniform(0.0, 0.4, (count, 1))
    finger = np.zeros((count, NUM_KEYPOINTS), dtype=bool)
    # A finger is missing from one of its points on.
    start = np.where(rng.random((count, 5)) < 0.25, rng.integers(0, 4, (count, 5)), 4)
    finger[:, 1:] = (np.arange(4) >= start[..., None]).reshape(count, 20)
    angle = rng.uniform(-np.pi, np.pi, count)
    along = (pixels * np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]).sum(axis=2)
    beyond = along > np.quantile(along, 0.55, axis=1, keepdims=True) + 0.4 * rng.random((count, 1)) * np.ptp(
        along, axis=1, keepdims=True
    )
    missing = np.select(
        [kind < 0.5, kind < 0.75, kind < 0.9], [np.zeros_like(single), single, finger], beyond
    )
    found = ~missing
    few = found.sum(axis=1) < LEAST_POINTS
    found[few] = True
    return found


def train(angles: np.ndarray, seed: int, epochs: int, report: Callable[[str], None]) -> dict[str, np.ndarray]:
    """The lifter's arrays, as `network.Layers` reads them."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    plane = plane_of(angles, rng)
    probe = samples_of(angles, plane, rng)[0].features
    mean, deviation = probe.mean(axis=0), probe.std(axis=0) + 1e-3
    last = torch.nn.Linear(HIDDEN, 6 * NUM_KEYPOINTS)
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.zeros_(last.bias)
    network = torch.nn.Sequential(
        torch.nn.Linear(FEATURES, HIDDEN), torch.nn.GELU(approximate="tanh"), torch.nn.Dropout(DROPOUT),
        torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.GELU(approximate="tanh"), torch.nn.Dropout(DROPOUT),
        last,
    )  # fmt: skip
    steps = epochs * -(-len(angles) // BATCH)
    optimiser = torch.optim.AdamW(network.parameters(), 2e-3, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, total_steps=steps)
    for epoch in range(epochs):
        seen, truth = samples_of(angles, plane, rng)
        features = torch.tensor(
            np.clip((seen.features - mean) / deviation, -MAX_FEATURE, MAX_FEATURE), dtype=torch.float32
        )
        goal = torch.tensor(truth - seen.fused, dtype=torch.float32)
        total = 0.0
        for batch in torch.randperm(len(features)).split(BATCH):
            out = network(features[batch]).view(-1, NUM_KEYPOINTS, 6)
            log_sigma = out[..., 3:] + LOG_SIGMA
            # Laplace's likelihood: outliers do not rule.
            loss = ((out[..., :3] - goal[batch]).abs() * torch.exp(-log_sigma) + log_sigma).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += loss.item() * len(batch)
        if epoch % 10 == 9:
            report(f"epoch {epoch + 1}/{epochs}: {total / len(features):.3f}")
    network.eval()
    # What is expected of errors was for training; the landmark network says that of detections.
    last.weight.data = last.weight.data.view(NUM_KEYPOINTS, 6, HIDDEN)[:, :3].reshape(-1, HIDDEN)
    last.bias.data = last.bias.data.view(NUM_KEYPOINTS, 6)[:, :3].reshape(-1)
    linear = [m for m in network if isinstance(m, torch.nn.Linear)]
    arrays = {f"weight_{i}": m.weight.detach().numpy().astype(np.float16) for i, m in enumerate(linear)}
    arrays |= {f"bias_{i}": m.bias.detach().numpy().astype(np.float32) for i, m in enumerate(linear)}
    found = {
        "mean": mean,
        "deviation": deviation,
        "plane_mean": plane.mean,
        "plane_covariance": plane.covariance,
    }
    return arrays | {name: values.astype(np.float32) for name, values in found.items()}
