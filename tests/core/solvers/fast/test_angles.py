import numpy as np
import pytest

from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.solvers.fast.angles import angles_of, rates_of, rotation_of
from tests.core.residuals.differences import by_each, close, random

ANGLES = np.concatenate([random(6, 3, scale=0.6), np.zeros((1, 3))])
"""The last one is a flat joint"""


def test_rotation_is_twist_then_spread_then_bend() -> None:
    expected = np.eye(3)
    for i in range(3):
        expected = expected @ rotvec_to_rotmat(ANGLES[:, i : i + 1] * np.eye(3)[i])
    np.testing.assert_allclose(rotation_of(ANGLES), expected, atol=1e-14)


def test_round_trip() -> None:
    close(angles_of(rotation_of(ANGLES)), ANGLES)


@pytest.mark.parametrize("index", range(len(ANGLES)))
def test_rates_by_finite_differences(index: int) -> None:
    angles = ANGLES[index]

    def after(increment: np.ndarray) -> np.ndarray:
        return angles_of(rotation_of(angles) @ np.array(rotvec_to_rotmat(increment)))

    differences = by_each(after, np.zeros(3))
    close(rates_of(angles), differences, rtol=1e-6, atol=1e-8)


def test_at_the_pole_all_is_finite() -> None:
    pole = np.array([[0.3, np.pi / 2, 0.2], [0.3, -np.pi / 2, 0.2]])
    assert np.isfinite(rates_of(pole)).all()
    assert np.isfinite(angles_of(rotation_of(pole))).all()
