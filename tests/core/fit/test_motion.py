"""Accelerations and their derivatives, against finite differences and the matrix exponential."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.fit.terms.motion import inverse_right_jacobian, place_acceleration, rotation_acceleration
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat

STEP = 1e-6
AXES = np.random.default_rng(3).normal(size=(8, 3))
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.99e-4, 1.01e-4, 1e-3, 0.5, 2.0, 3.1, np.pi - 1e-5])
def test_inverse_right_jacobian_by_differences(angle: float) -> None:
    """log(exp(w) exp(d)) = w + Jr^-1 d, for small d."""
    for axis in AXES:
        rotvec = axis * angle
        turn = rotvec_to_rotmat(rotvec)
        expected = np.empty((3, 3))
        for i in range(3):
            # A step that does not lead over pi, where the logarithm detect_cuts.
            d = np.eye(3)[i] * STEP
            ahead, back = (rotmat_to_rotvec(turn @ rotvec_to_rotmat(s * d)) for s in (1, -1))
            expected[:, i] = (ahead - back) / (2 * STEP)
        np.testing.assert_allclose(inverse_right_jacobian(rotvec), expected, atol=2e-6)


@pytest.mark.parametrize("spread", [0.0, 1e-6, 0.02, 0.5, 2.0])
def test_rotation_acceleration_by_differences(spread: float) -> None:
    rng = np.random.default_rng(0)
    turns = rotvec_to_rotmat(rng.normal(size=(4, 2, 3)) / 2 * spread)
    rotations = [rotvec_to_rotmat(rng.normal(size=(2, 3)))]
    for turn in turns:
        rotations.append(rotations[-1] @ turn)
    rotations = np.array(rotations)  # (5, 2, 3, 3)
    residual, jacobian = rotation_acceleration(rotations)
    assert residual.shape == (3, 2, 3)
    assert jacobian.shape == (3, 3, 2, 3, 3)
    for frame in range(5):
        for joint in range(2):
            for i in range(3):
                sides = []
                for sign in (1, -1):
                    moved = rotations.copy()
                    moved[frame, joint] = moved[frame, joint] @ rotvec_to_rotmat(sign * STEP * np.eye(3)[i])
                    sides.append(rotation_acceleration(moved)[0])
                change = (sides[0] - sides[1]) / (2 * STEP)
                expected = np.zeros_like(change)
                for t in range(3):
                    if 0 <= frame - t <= 2:
                        expected[t, joint] = jacobian[t, frame - t, joint, :, i]
                np.testing.assert_allclose(change, expected, atol=1e-7)


def test_even_turning_has_no_acceleration() -> None:
    start, turn = rotvec_to_rotmat(np.array([0.3, -1.0, 2.0])), rotvec_to_rotmat(np.array([0.1, 0.2, -0.05]))
    rotations = [start]
    for _ in range(60):  # through more than a full circle
        rotations.append(rotations[-1] @ turn)
    np.testing.assert_allclose(rotation_acceleration(np.array(rotations))[0], 0.0, atol=1e-12)


def test_rotation_acceleration_about_one_axis() -> None:
    """Then it is the second difference of the angle."""
    angle = np.array([0.0, 0.1, 0.4, 0.6, 0.5])
    residual, _ = rotation_acceleration(rotvec_to_rotmat(angle[:, None] * AXES[0]))
    np.testing.assert_allclose(residual, np.diff(angle, 2)[:, None] * AXES[0], atol=1e-12)


def test_place_acceleration() -> None:
    t = np.arange(6.0)[:, None]
    a = np.array([0.01, -0.02, 0.03])
    np.testing.assert_allclose(place_acceleration(0.5 * a * t**2 + 2.0 * t + 1.0), np.tile(a, (4, 1)))
