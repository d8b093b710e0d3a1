import math

import numpy as np
import pytest

from handfit_core.residuals.limits import SPREAD_LEFT, limits
from tests.core.residuals.differences import by_each, close, of_own_finger, random

SIGMA = math.radians(2)
LOWER = np.full((5, 9), math.radians(-20))
UPPER = np.full((5, 9), math.radians(30))
KNUCKLES = np.array([0.0, 1.0, 1.0, 1.0, 1.0])
BEND, SPREAD = 2, 1


def of(angles: np.ndarray):
    return limits(angles, LOWER, UPPER, SIGMA, KNUCKLES)


def test_nothing_inside_the_range() -> None:
    rows = of(np.full((2, 5, 9), math.radians(5)))
    assert np.abs(rows.residual).max() == 0
    assert np.abs(rows.jacobian).max() == 0


def test_distance_from_the_nearer_end_in_sigmas() -> None:
    angles = np.zeros((1, 5, 9))
    angles[0, 1, 5] = math.radians(37)
    angles[0, 2, 8] = math.radians(-26)
    residual = of(angles).residual
    assert float(residual[0, 1, 5]) == pytest.approx(3.5)
    assert float(residual[0, 2, 8]) == pytest.approx(-3.0)
    assert float(np.abs(residual).sum()) == pytest.approx(6.5)


@pytest.mark.parametrize(("finger", "left"), [(0, 1.0), (1, (1 + SPREAD_LEFT) / 2)])
def test_a_knuckles_spread_tightens_as_it_bends(finger: int, left: float) -> None:
    """Half of the way at 45 degrees; not the thumb's."""
    angles = np.zeros((1, 5, 9))
    angles[0, finger, BEND] = math.radians(45)
    angles[0, finger, SPREAD] = math.radians(30 * left + 4)
    assert float(of(angles).residual[0, finger, SPREAD]) == pytest.approx(2.0)


@pytest.mark.parametrize("seed", range(4))
def test_jacobian_by_angles(seed: int) -> None:
    angles = random(1, 5, 9, seed=seed, scale=0.8)
    angles[0, 3, BEND] = 2.0  # beyond 90 degrees the spread's range stays
    angles[0, 4, BEND] = -0.2
    differences = of_own_finger(by_each(lambda a: of(a).residual[0], angles))
    close(of(angles).jacobian[0], differences, rtol=1e-6, atol=1e-6)


def test_batch_equals_loop() -> None:
    angles = random(4, 5, 9, seed=9, scale=0.8)
    whole = of(angles)
    for i in range(4):
        one = of(angles[i : i + 1])
        close(whole.residual[i], one.residual[0])
        close(whole.jacobian[i], one.jacobian[0])
