"""From samples to what ships: calibrated landmarks, the pose prior and the landmark network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from handfit_core.detect.correction.canonical import FEATURES, Canonical, canonical_arrays
from handfit_core.detect.correction.network import LOG_SIGMA, MAX_FEATURE
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.geometry.similarity import align
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes
from handfit_core.hand_model.chain import Chain, Posed
from handfit_core.hand_model.landmarks import LANDMARK_BONES, NO_OFFSETS, Landmarks, hand_length
from handfit_core.paper.placement import turn_to_ray
from handfit_core.skeleton import JOINTS_BY_FINGER, SIDES, TIP_KEYPOINTS, Side
from scripts.benchmark.kinematics import model_of

Samples = dict[str, np.ndarray]
"""Those of `samples.sample`, stacked"""

WELL_SEEN = 0.014
"""metres; detections with a smaller error after alignment show where the detector puts its landmarks"""
PRIOR_WIDER = 1.3
"""What the spread of our own poses is widened by: people do more than our poses"""
PRIOR_FLOOR = np.radians(2.0)

HIDDEN = 256
EPOCHS = 30
BATCH = 256
NOISE = 0.02
"""Added to the features, in canonical units"""


def _of_side(samples: Samples, side: Side) -> np.ndarray:
    """(M,) which samples are of hands that were of that side before the picture was mirrored."""
    before = np.where(samples["mirrored"], 1 - samples["side"], samples["side"])
    return np.flatnonzero(before == SIDES.index(side))


def _true_hands(samples: Samples, side: Side, landmarks: Landmarks) -> tuple[np.ndarray, Posed]:
    """(M,) which samples are of that side, and their true hands, unmirrored, in the model's frame."""
    index = _of_side(samples, side)
    chain = Chain(model_of(side), landmarks)
    zero = np.zeros((len(index), 3))
    state = chain.state(samples["betas"][index], zero, samples["hand_pose"][index], zero, zero[:, 0])
    return index, chain.pose(replace(state, wrist=zero))


def calibrate(samples: Samples) -> np.ndarray:
    """(21, 3) landmark offsets as `hand_model.landmarks.Landmarks` keeps them: the median place, in the
    bone's axes, of well seen detections laid over the true hand.

    Fingertips only: what painted pictures say of the other landmarks (2 to 7 mm) makes fits of real pictures
    worse, and those of rendered ones no better.
    """
    collected = []
    fused = _fused(samples)
    for side in SIDES:
        index, posed = _true_hands(samples, side, NO_OFFSETS)
        points = posed.points
        of_joints = posed.frames.reshape(-1, 5, 3, 4, 3).swapaxes(2, 3)[:, :, :3]
        in_order = np.empty((len(points), 16, 3, 3))
        in_order[:, 0], in_order[:, JOINTS_BY_FINGER] = np.eye(3), of_joints
        for row, sample in enumerate(index):
            if samples["detected_side"][sample] != samples["side"][sample]:
                continue
            seen = fused[sample] * _unmirror(samples, sample)
            laid = align(seen, points[row], with_scale=True).apply(seen)
            offset = laid - points[row]
            if np.linalg.norm(offset, axis=1).mean() > WELL_SEEN:
                continue
            local = np.einsum("kab,ka->kb", in_order[row, list(LANDMARK_BONES)], offset)
            collected.append(local / hand_length(model_of(side)) * _as_right(side))
    offsets = np.zeros((21, 3))
    tips = list(TIP_KEYPOINTS)
    offsets[tips] = np.median(collected, axis=0)[tips]
    return offsets


def _as_right(side: Side) -> np.ndarray:
    """(21, 3) signs, the inverse of `Landmarks.in_metres`."""
    signs = np.ones((21, 3))
    if side == "left":
        signs[:, 2] = -1.0
        signs[0] = (-1.0, 1.0, 1.0)
    return signs


def _unmirror(samples: Samples, sample: int) -> np.ndarray:
    return np.array([-1.0 if samples["mirrored"][sample] else 1.0, 1.0, 1.0])


def _fused(samples: Samples) -> np.ndarray:
    """(N, 21, 3) pixels: both landmark sets, as the network's canonical frame fuses them."""
    seen = _canonical(samples, samples["detected_side"])
    return seen.to_picture(seen.fused)


def _canonical(samples: Samples, side: np.ndarray) -> Canonical:
    agreement = np.where(samples["detected_side"] == side, samples["score"], -samples["score"])
    return canonical_arrays(samples["keypoints"], samples["world"], side == SIDES.index("left"), agreement)


def pose_prior(samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Mean (5, 9) and covariance (5, 9, 9) of our own poses, as a right hand's, widened."""
    collected = []
    for side in SIDES:
        poses = np.unique(samples["hand_pose"][_of_side(samples, side)], axis=0)
        angles = anatomical_angles(
            rotvec_to_rotmat(poses.reshape(-1, 15, 3)), anatomical_axes(model_of(side))
        )
        collected.append(angles * (1.0 if side == "right" else np.array([-1.0, -1.0, 1.0])))
    order = JOINTS_BY_FINGER - 1
    fingers = np.concatenate(collected)[:, order].reshape(-1, 5, 9)
    covariance = np.stack([np.cov(fingers[:, f].T) for f in range(5)])
    return fingers.mean(axis=0), covariance * PRIOR_WIDER**2 + np.eye(9) * PRIOR_FLOOR**2


def true_landmarks(samples: Samples, landmarks: Landmarks) -> np.ndarray:
    """(N, 21, 3) where the landmarks truly are, metres, camera frame."""
    found = np.empty_like(samples["joints_3d"])
    for side in SIDES:
        index, seen = _true_hands(samples, side, landmarks)
        joints = _true_hands(samples, side, NO_OFFSETS)[1].points
        for row, sample in enumerate(index):
            flip = _unmirror(samples, sample)
            move = align(joints[row], samples["joints_3d"][sample] * flip, with_scale=False)
            found[sample] = move.apply(seen.points[row]) * flip
    return found


def targets(samples: Samples, points: np.ndarray, seen: Canonical) -> np.ndarray:
    """(N, 21, 3) the true points (N, 21, 3) in the canonical frame: x and y as they project; depth along the
    line of sight, in pixels at the hand's mean distance. That is what the solver's terms compare."""
    picture = np.empty_like(points)
    for i in range(len(points)):
        size = float(samples["size"][i])
        # The camera that the solver will assume, not the true one.
        turn = turn_to_ray(
            Intrinsics.assumed(int(size), int(size)), samples["keypoints"][i, :, :2].mean(axis=0)
        )
        along = points[i] @ turn
        camera = Intrinsics(samples["focal"][i], samples["focal"][i], *samples["centre"][i])
        picture[i, :, :2] = camera.project(points[i])
        picture[i, :, 2] = (along[:, 2] - along[:, 2].mean()) * (samples["focal"][i] / along[:, 2].mean())
    return seen.from_picture(picture)


def train(
    samples: Samples, landmarks: Landmarks, seed: int, report: Callable[[str], None]
) -> dict[str, np.ndarray]:
    """The network's arrays, as `LandmarkNetwork` reads them."""
    torch.manual_seed(seed)
    points = true_landmarks(samples, landmarks)
    as_true = _canonical(samples, samples["side"])
    wrong_side = _canonical(samples, 1 - samples["side"])

    def tensor(a: np.ndarray) -> torch.Tensor:
        return torch.tensor(a, dtype=torch.float32)

    features, goal = tensor(as_true.features), tensor(targets(samples, points, as_true) - as_true.fused)
    # The side is learned on the detector's own word and on its opposite.
    of_sides = torch.cat([features, tensor(wrong_side.features)])
    is_right = torch.cat([torch.ones(len(features)), torch.zeros(len(features))])
    mean, deviation = features.mean(dim=0), features.std(dim=0) + 1e-6
    last = torch.nn.Linear(HIDDEN, 21 * 6 + 1)
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.zeros_(last.bias)
    network = torch.nn.Sequential(
        torch.nn.Linear(FEATURES, HIDDEN), torch.nn.GELU(approximate="tanh"), torch.nn.Dropout(0.1),
        torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.GELU(approximate="tanh"), torch.nn.Dropout(0.1),
        last,
    )  # fmt: skip
    steps = EPOCHS * (len(features) // BATCH + 1)
    optimiser = torch.optim.AdamW(network.parameters(), 2e-3, weight_decay=3e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, total_steps=steps)

    def forward(x: torch.Tensor) -> torch.Tensor:
        x = x + NOISE * torch.randn_like(x)
        return network(((x - mean) / deviation).clamp(-MAX_FEATURE, MAX_FEATURE))

    loss = loss_side = torch.zeros(())
    for epoch in range(EPOCHS):
        for batch in torch.randperm(len(features)).split(BATCH):
            out = forward(features[batch])[:, :-1].view(-1, 21, 6)
            log_sigma = out[..., 3:] + LOG_SIGMA
            # Laplace's likelihood: outliers do not rule.
            loss = ((out[..., :3] - goal[batch]).abs() * torch.exp(-log_sigma) + log_sigma).mean()
            pairs = torch.randint(len(of_sides), (BATCH,))
            loss_side = torch.nn.functional.binary_cross_entropy_with_logits(
                forward(of_sides[pairs])[:, -1], is_right[pairs]
            )
            optimiser.zero_grad()
            (loss + 0.5 * loss_side).backward()
            optimiser.step()
            schedule.step()
        report(f"epoch {epoch + 1}/{EPOCHS}: landmarks {loss.item():.3f}, side {loss_side.item():.3f}")
    linear = [m for m in network if isinstance(m, torch.nn.Linear)]
    arrays = {f"weight_{i}": m.weight.detach().numpy().astype(np.float16) for i, m in enumerate(linear)}
    arrays |= {f"bias_{i}": m.bias.detach().numpy().astype(np.float32) for i, m in enumerate(linear)}
    return arrays | {"mean": mean.numpy(), "deviation": deviation.numpy()}
