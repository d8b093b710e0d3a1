"""Accelerations and their derivatives, against finite differences and what they are by hand."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from handfit_core.fit.terms.motion import inverse_right_jacobian, place_acceleration, rotation_acceleration
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from tests.core.fit.differences import by_each, close, random, unit

AXES = unit(random(8, 3, seed=3))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.99e-4, 1.01e-4, 1e-3, 0.5, 2.0, 3.1, np.pi - 1e-5])
def test_inverse_right_jacobian(angle: float) -> None:
    """log(exp(w) exp(d)) = w + Jr^-1 d, for small d; beyond pi the logarithm jumps."""
    for axis in AXES:
        turn = rotvec_to_rotmat(axis * angle)
        expected = by_each(lambda d, turn=turn: rotmat_to_rotvec(turn @ rotvec_to_rotmat(d)), np.zeros(3))
        close(inverse_right_jacobian(axis * angle), expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize("spread", [0.0, 1e-6, 0.02, 0.5, 2.0])
def test_derivatives_of_rotation_acceleration(spread: float) -> None:
    turns = rotvec_to_rotmat(np.concatenate([random(1, 2, 3), random(4, 2, 3, seed=1) / 2 * spread]))
    rotations = [turns[0]]
    for turn in turns[1:]:
        rotations.append(rotations[-1] @ turn)
    jacobian = rotation_acceleration(np.array(rotations))[1]
    expected = by_each(
        lambda d: rotation_acceleration(rotations @ rotvec_to_rotmat(d))[0], np.zeros((5, 2, 3))
    )
    expected = expected.reshape(3, 2, 3, 5, 2, 3)
    found = np.zeros_like(expected)
    for t, frame, joint in product(range(3), range(3), range(2)):
        found[t, joint, :, t + frame, joint] = jacobian[t, frame, joint]
    close(found, expected, rtol=0, atol=1e-7)


def test_rotation_acceleration_about_one_axis() -> None:
    """Then it is the second difference of the angle, also over a full circle."""
    angle = np.cumsum([0.0, 0.1, 0.3, 0.2, -0.1, 2.5, 2.5, 2.5, 2.5])
    residual, _ = rotation_acceleration(rotvec_to_rotmat(angle[:, None] * AXES[0]))
    close(residual, np.diff(angle, 2)[:, None] * AXES[0], rtol=0, atol=1e-12)


def test_place_acceleration() -> None:
    t, a = np.arange(6.0)[:, None], np.array([0.01, -0.02, 0.03])
    close(place_acceleration(0.5 * a * t**2 + 2.0 * t + 1.0), np.tile(a, (4, 1)))
