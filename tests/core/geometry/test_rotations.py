"""Rotation conversions against SciPy-free closed forms, each other, and degenerate inputs."""

import math

import numpy as np
import pytest

from handfit_core.geometry.rotations import (
    euler_to_rotmat,
    quat_to_rotmat,
    rotmat_to_euler,
    rotmat_to_quat,
    rotmat_to_rotvec,
    rotvec_to_rotmat,
    skew,
    swings,
    turn_from_axis,
    unflip_quats,
    units,
)

ANGLES = [0.0, 1e-12, 1e-8, 1e-7, 1e-4, 0.3, math.pi / 2, 2.5, math.pi - 1e-7, math.pi]


def rotvecs(angle: float, count: int = 40) -> np.ndarray:
    """(count, 3) random axes, and the three of the frame, all turned by `angle`."""
    axes = np.random.default_rng(5).normal(size=(count, 3))
    axes = np.concatenate([axes, np.eye(3), -np.eye(3)])
    return angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)


def test_quarter_turn():
    rotmat = rotvec_to_rotmat(np.array([0.0, 0.0, math.pi / 2]))
    np.testing.assert_allclose(rotmat @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    half = math.sqrt(0.5)
    np.testing.assert_allclose(rotmat_to_quat(rotmat), [half, 0, 0, half], atol=1e-15)
    np.testing.assert_allclose(quat_to_rotmat(np.array([half, 0, 0, half])), rotmat, atol=1e-15)
    np.testing.assert_array_equal(rotvec_to_rotmat(np.zeros((2, 3))), np.stack([np.eye(3)] * 2))
    np.testing.assert_array_equal(rotmat_to_rotvec(np.eye(3)), np.zeros(3))


@pytest.mark.parametrize("angle", ANGLES)
def test_rotvec_is_matrix_exponential(angle):
    for rotvec in rotvecs(angle, 5):
        # Halved until small, a Taylor series, squared back: no trigonometry in common with ours.
        term, power = np.eye(3), np.eye(3)
        for n in range(1, 12):
            power = power @ skew(rotvec / 256) / n
            term = term + power
        np.testing.assert_allclose(
            rotvec_to_rotmat(rotvec), np.linalg.matrix_power(term, 256), rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("angle", ANGLES)
def test_round_trips(angle):
    rotvec = rotvecs(angle)
    rotmat = rotvec_to_rotmat(rotvec)
    np.testing.assert_allclose(rotmat @ np.swapaxes(rotmat, 1, 2), np.tile(np.eye(3), (46, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(rotmat), 1.0, atol=1e-14)
    quats = rotmat_to_quat(rotmat)
    np.testing.assert_allclose(np.linalg.norm(quats, axis=-1), 1.0, atol=1e-15)
    assert np.all(quats[:, 0] >= 0)
    np.testing.assert_allclose(quat_to_rotmat(-4 * quats), rotmat, atol=1e-14)
    back = rotmat_to_rotvec(rotmat)
    np.testing.assert_allclose(rotvec_to_rotmat(back), rotmat, atol=1e-14)
    if angle < math.pi - 1e-3:  # at pi both signs of the axis are right
        np.testing.assert_allclose(back, rotvec, rtol=0, atol=1e-14)
    assert np.all(np.linalg.norm(back, axis=1) <= math.pi + 1e-12)


def test_skew_is_the_cross_product():
    a, b = np.random.default_rng(2).normal(size=(2, 6, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", skew(a), b), np.cross(a, b), atol=1e-15)


def test_unflip_quats():
    rng = np.random.default_rng(3)
    angles = np.linspace(0, 4 * np.pi, 60)
    smooth = np.stack([np.cos(angles / 2), *(np.sin(angles / 2) * c for c in (0.6, 0.0, 0.8))], axis=-1)
    flipped = np.stack([smooth, smooth], axis=1) * rng.choice([-1, 1], size=(60, 2, 1))
    flipped[0] = smooth[0]
    before = flipped.copy()
    np.testing.assert_allclose(unflip_quats(flipped), np.stack([smooth, smooth], axis=1), atol=1e-15)
    np.testing.assert_array_equal(flipped, before)
    assert unflip_quats(np.zeros((0, 4))).shape == (0, 4)


def test_euler_to_rotmat():
    angles = np.concatenate([np.random.default_rng(0).normal(size=(6, 3)) * 0.6, np.zeros((1, 3))])
    expected = np.eye(3)
    for i in range(3):
        expected = expected @ rotvec_to_rotmat(angles[:, i : i + 1] * np.eye(3)[i])
    np.testing.assert_allclose(euler_to_rotmat(angles), expected, atol=1e-14)
    np.testing.assert_allclose(rotmat_to_euler(expected), angles, atol=1e-12)
    pole = np.array([[0.3, np.pi / 2, 0.2], [0.3, -np.pi / 2, 0.2]])
    back = euler_to_rotmat(rotmat_to_euler(euler_to_rotmat(pole)))
    np.testing.assert_allclose(back, euler_to_rotmat(pole), atol=1e-7)


def test_turn_from_axis():
    rays = np.random.default_rng(1).normal(size=(5, 3)) + [0.0, 0.0, 2.0]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    turns = turn_from_axis(rays)
    np.testing.assert_allclose(turns[:, :, 2], rays, atol=1e-12)
    np.testing.assert_allclose(turns @ turns.swapaxes(1, 2), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12)
    np.testing.assert_allclose((turns.trace(axis1=1, axis2=2) - 1) / 2, rays[:, 2], atol=1e-12)


def test_swings():
    start, end = units(np.random.default_rng(11).normal(size=(2, 50, 3)))
    # Beside opposite ones, any axis will do.
    for to, near in ((end, 1e-9), (start, 1e-9), (-start, 1e-9), (units(-start + 1e-6 * end), 1e-5)):
        turn = swings(start, to)
        np.testing.assert_allclose((turn @ start[..., None])[..., 0], to, atol=near)
        np.testing.assert_allclose(turn @ turn.swapaxes(1, 2), np.tile(np.eye(3), (50, 1, 1)), atol=1e-9)
        angle = np.linalg.norm(rotmat_to_rotvec(turn), axis=-1)
        expected = np.arctan2(np.linalg.norm(np.cross(start, to), axis=-1), (start * to).sum(axis=-1))
        np.testing.assert_allclose(angle, expected, atol=1e-5)
