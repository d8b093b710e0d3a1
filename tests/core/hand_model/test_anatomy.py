"""Angles of joints about anatomical axes, and how far they go."""

from itertools import product

import numpy as np
import pytest
import torch

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, SIDES, Side
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import (
    anatomical_angles,
    anatomical_axes,
    joint_limits,
    relaxed_pose,
    rotmats_from_angles,
)
from handfit_core.paper.terms import AnatomicalPenalty

MIRROR = np.array([1.0, -1.0, -1.0])
"""Mirroring in x turns a rotation vector (a, b, c) into (a, -b, -c)."""


def rotmats_of(angles: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(15, 3) twist, spread, bend -> local rotations: Rx(twist) Ry(spread) Rz(bend) in the joint's axes."""
    local = np.eye(3)
    for i in range(3):
        local = local @ rotvec_to_rotmat(angles[:, i : i + 1] * np.eye(3)[i])
    return axes @ local @ np.swapaxes(axes, -1, -2)


@pytest.mark.parametrize("side", SIDES)
def test_axes_and_positive_bends(side: Side) -> None:
    model = load_model(None, side)
    axes = anatomical_axes(model)
    np.testing.assert_allclose(axes @ np.swapaxes(axes, -1, -2), np.tile(np.eye(3), (15, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)
    sign = 1.0 if side == "right" else -1.0
    assert np.all(sign * axes[:12, 0, 0] > 0.8)  # twist points to the wrist: +x, left -x
    assert np.all(axes[:12, 1, 1] > 0.8)  # spread axis points out of the back of the hand
    zero = np.zeros(3)
    flat = model.keypoints(None, zero, np.zeros(45), zero)
    for f, finger in enumerate(FINGERS):
        for joint in FINGER_JOINTS[finger]:
            pose = np.zeros((15, 3))
            pose[joint - 1] = np.radians(20) * axes[joint - 1][:, 2]
            moved = model.keypoints(None, zero, pose.reshape(45), zero) - flat
            assert moved[4 + 4 * f, 1] < -0.002, "a positive bend closes the hand"
            assert np.abs(np.delete(moved[4::4], f, axis=0)).max() < 1e-9


@pytest.mark.parametrize("side", SIDES)
def test_thumb_reaches_little_finger(side: Side) -> None:
    """As every person's does; fists and letters need it."""
    model, limits = load_model(None, side), joint_limits(side)
    thumb = [j - 1 for j in FINGER_JOINTS["thumb"]]
    # All ends of its ranges, and the last joint anywhere between.
    ends = [*zip(limits.lower[thumb].ravel(), limits.upper[thumb].ravel(), strict=True)]
    ends[-1] = tuple(np.linspace(*ends[-1], 9))
    poses = np.array(list(product(*ends)))
    angles = np.zeros((len(poses), 15, 3))
    angles[:, thumb] = poses.reshape(-1, 3, 3)
    pose = rotmat_to_rotvec(rotmats_from_angles(angles, anatomical_axes(model))).reshape(-1, 45)
    zero = np.zeros((len(poses), 3))
    points = model.keypoints(None, zero, pose, zero)
    assert np.linalg.norm(points[:, 4] - points[:, 17], axis=1).min() < 0.027


@pytest.mark.parametrize("side", SIDES)
def test_open_hand_ranges(side: Side) -> None:
    """A hand file of one's own has the ranges that published figures give."""
    own, others = joint_limits(side), joint_limits(side, "MANO_RIGHT")
    wider = np.degrees(np.concatenate([own.upper - others.upper, others.lower - own.lower]))
    root = FINGER_JOINTS["thumb"][0] - 1
    assert wider[[root, root + 15]].sum() == pytest.approx(18.0)
    assert not np.delete(wider, [root, root + 15], axis=0).any()


@pytest.mark.parametrize("side", SIDES)
def test_angles_and_back(side: Side) -> None:
    axes, rng = anatomical_axes(load_model(None, side)), np.random.default_rng(4)
    angles = rng.uniform(-1.3, 1.3, (6, 15, 3))
    rotmats = rotmats_from_angles(angles, axes)
    np.testing.assert_allclose(anatomical_angles(rotmats, axes), angles, atol=1e-12)
    np.testing.assert_allclose(rotmats, [rotmats_of(each, axes) for each in angles], atol=1e-12)
    pose = rotvec_to_rotmat(rng.normal(scale=0.5, size=(15, 3)))
    np.testing.assert_allclose(rotmats_from_angles(anatomical_angles(pose, axes), axes), pose, atol=1e-12)


def test_relaxed_hands() -> None:
    relaxed = {side: relaxed_pose(load_model(None, side)).reshape(15, 3) for side in SIDES}
    np.testing.assert_allclose(relaxed["left"], relaxed["right"] * MIRROR, atol=1e-6)
    for side, pose in relaxed.items():
        axes, limits = anatomical_axes(load_model(None, side)), joint_limits(side)
        angles = anatomical_angles(rotvec_to_rotmat(pose), axes)
        assert np.all((limits.lower <= angles) & (angles <= limits.upper))
        assert np.all(np.degrees(angles[:12, 2]) > 10)  # every joint of the four fingers is bent
        assert np.all(np.degrees(angles[:, 2]) < 60)


def test_penalty_of_the_paper() -> None:
    axes, limits = anatomical_axes(load_model(None, "right")), joint_limits("right")
    penalty = AnatomicalPenalty(axes, limits)
    pose = np.random.default_rng(1).normal(scale=0.5, size=(4, 15, 3))
    found = penalty.angles(torch.tensor(pose.reshape(4, 45)))
    np.testing.assert_allclose(found.numpy(), anatomical_angles(rotvec_to_rotmat(pose), axes), atol=1e-12)
    assert torch.autograd.gradcheck(penalty, torch.tensor(pose[:1].reshape(1, 45), requires_grad=True))
    inside = (limits.lower + limits.upper) / 2
    outside = inside.copy()
    outside[4, 2] = limits.upper[4, 2] + 1.0
    costs = []
    for angles in (inside, outside):
        rotvecs = rotmat_to_rotvec(rotmats_of(angles, axes)).reshape(1, 45)
        costs.append(float(penalty(torch.tensor(rotvecs))))
        assert costs[-1] == pytest.approx(
            np.sum(np.exp(limits.lower - angles) + np.exp(angles - limits.upper))
        )
    assert costs[1] > costs[0]
