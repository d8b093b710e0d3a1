from itertools import product

import numpy as np
import pytest
import torch

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
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, Side

MIRROR = np.array([1.0, -1.0, -1.0])
"""Mirroring in x turns a rotation vector (a, b, c) into (a, -b, -c)."""


def rotmats_of(angles: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(15, 3) twist, spread, bend -> local rotations: Rx(twist) Ry(spread) Rz(bend) in the joint's axes."""
    local = np.eye(3)
    for i in range(3):
        local = local @ rotvec_to_rotmat(angles[:, i : i + 1] * np.eye(3)[i])
    return axes @ local @ np.swapaxes(axes, -1, -2)


@pytest.mark.parametrize("side", ["left", "right"])
def test_anatomical_axes(side: Side) -> None:
    axes = anatomical_axes(load_model(None, side))
    np.testing.assert_allclose(
        axes @ np.swapaxes(axes, -1, -2), np.broadcast_to(np.eye(3), (15, 3, 3)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)
    sign = 1.0 if side == "right" else -1.0
    fingers = axes[:12]
    assert np.all(sign * fingers[:, 0, 0] > 0.8)  # twist points to the wrist: +x, left -x
    assert np.all(fingers[:, 1, 1] > 0.8)  # spread axis points out of the back of the hand


@pytest.mark.parametrize("side", ["left", "right"])
def test_positive_bend_closes_the_hand(side: Side) -> None:
    model = load_model(None, side)
    axes = anatomical_axes(model)
    zero = np.zeros(3)
    flat = model.keypoints(None, zero, np.zeros(45), zero)
    for f, finger in enumerate(FINGERS):
        for joint in FINGER_JOINTS[finger]:
            pose = np.zeros((15, 3))
            pose[joint - 1] = np.radians(20) * axes[joint - 1][:, 2]
            moved = model.keypoints(None, zero, pose.reshape(45), zero)
            tip = 4 + 4 * f
            assert moved[tip, 1] < flat[tip, 1], (finger, joint)


@pytest.mark.parametrize("side", ["left", "right"])
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


@pytest.mark.parametrize("side", ["left", "right"])
def test_open_hand_ranges(side: Side) -> None:
    """A hand file of one's own has the ranges that published figures give."""
    own, others = joint_limits(side), joint_limits(side, "MANO_RIGHT")
    wider = np.degrees(np.concatenate([own.upper - others.upper, others.lower - own.lower]))
    root = FINGER_JOINTS["thumb"][0] - 1
    assert wider[[root, root + 15]].sum() == pytest.approx(18.0)
    assert not np.delete(wider, [root, root + 15], axis=0).any()


@pytest.mark.parametrize("side", ["left", "right"])
def test_rotmats_from_angles(side: Side) -> None:
    axes = anatomical_axes(load_model(None, side))
    rng = np.random.default_rng(4)
    angles = rng.uniform(-1.3, 1.3, (6, 15, 3))
    rotmats = rotmats_from_angles(angles, axes)
    np.testing.assert_allclose(anatomical_angles(rotmats, axes), angles, atol=1e-12)
    for one, expected in zip(rotmats, angles, strict=True):
        np.testing.assert_allclose(one, rotmats_of(expected, axes), atol=1e-12)
    # And the other way round, for rotations that no angles were chosen for.
    pose = rotvec_to_rotmat(rng.normal(scale=0.5, size=(15, 3)))
    np.testing.assert_allclose(rotmats_from_angles(anatomical_angles(pose, axes), axes), pose, atol=1e-12)


@pytest.mark.parametrize("side", ["left", "right"])
def test_relaxed_pose(side: Side) -> None:
    axes, limits = anatomical_axes(load_model(None, side)), joint_limits(side)
    rotmats = rotvec_to_rotmat(relaxed_pose(load_model(None, side)).reshape(15, 3))
    angles = anatomical_angles(rotmats, axes)
    assert np.all(angles >= limits.lower)
    assert np.all(angles <= limits.upper)
    assert np.all(np.degrees(angles[:12, 2]) > 10)  # every joint of the four fingers is bent
    assert np.all(np.degrees(angles[:, 2]) < 60)


def test_relaxed_hands_are_mirror_images() -> None:
    right, left = (relaxed_pose(load_model(None, side)).reshape(15, 3) for side in ("right", "left"))
    np.testing.assert_allclose(left, right * MIRROR, atol=1e-6)


def test_torch_angles_are_the_same() -> None:
    model = load_model(None, "right")
    axes = anatomical_axes(model)
    pose = np.random.default_rng(1).normal(scale=0.5, size=(4, 15, 3))
    expected = anatomical_angles(rotvec_to_rotmat(pose), axes)
    penalty = AnatomicalPenalty(axes, joint_limits("right"))
    found = penalty.angles(torch.tensor(pose.reshape(4, 45)))
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-12)


def test_penalty_gradient_and_value() -> None:
    model = load_model(None, "right")
    axes, limits = anatomical_axes(model), joint_limits("right")
    penalty = AnatomicalPenalty(axes, limits)
    pose = torch.tensor(np.random.default_rng(2).normal(scale=0.4, size=(1, 45)), requires_grad=True)
    assert torch.autograd.gradcheck(penalty, pose)
    inside = (limits.lower + limits.upper) / 2
    outside = inside.copy()
    outside[4, 2] = limits.upper[4, 2] + 1.0

    def cost(angles: np.ndarray) -> float:
        rotvecs = rotmat_to_rotvec(rotmats_of(angles, axes)).reshape(1, 45)
        theta = angles.reshape(-1)
        expected = np.exp(limits.lower.reshape(-1) - theta) + np.exp(theta - limits.upper.reshape(-1))
        value = float(penalty(torch.tensor(rotvecs)))
        assert value == pytest.approx(expected.sum())
        return value

    assert cost(outside) > cost(inside)


def test_mirrored_pose_has_mirrored_limits() -> None:
    right, left = load_model(None, "right"), load_model(None, "left")
    pose = np.random.default_rng(3).normal(scale=0.4, size=(15, 3))
    right_angles = anatomical_angles(rotvec_to_rotmat(pose), anatomical_axes(right))
    left_angles = anatomical_angles(rotvec_to_rotmat(pose * MIRROR), anatomical_axes(left))
    right_limits, left_limits = joint_limits("right"), joint_limits("left")
    np.testing.assert_allclose(left_angles[:, 2], right_angles[:, 2], atol=1e-9)
    np.testing.assert_allclose(
        left_angles - left_limits.lower,
        np.where([[True, True, False]], right_limits.upper - right_angles, right_angles - right_limits.lower),
        atol=1e-9,
    )
    assert np.all(left_limits.lower < left_limits.upper)
