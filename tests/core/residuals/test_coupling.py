import numpy as np
import pytest

from handfit_core.residuals.coupling import coupling
from tests.core.residuals.differences import by_each, close, of_own_finger, random

SLOPE = np.array([0.0, 0.87, 0.79, 0.73, 0.73])
OFFSET = np.array([0.0, 0.4, 0.3, 0.35, 0.35])
SIGMA = np.array([np.inf, 0.3, 0.3, 0.3, 0.3])


def test_zero_where_the_last_joint_follows() -> None:
    angles = random(2, 5, 9, scale=0.5)
    angles[..., 8] = SLOPE * angles[..., 5] - OFFSET
    assert np.abs(coupling(angles, SLOPE, OFFSET, SIGMA).residual).max() < 1e-14


def test_a_last_joint_bent_alone_costs() -> None:
    angles = np.zeros((1, 5, 9))
    angles[0, 1, 8] = 0.5
    assert float(coupling(angles, SLOPE, OFFSET, SIGMA).residual[0, 1, 0]) == pytest.approx(0.9 / 0.3)


def test_the_thumb_has_no_such_rule() -> None:
    rows = coupling(random(2, 5, 9), SLOPE, OFFSET, SIGMA)
    assert np.abs(rows.residual[:, 0]).max() == 0
    assert np.abs(rows.jacobian[:, 0]).max() == 0


def test_jacobian_by_angles() -> None:
    angles = random(1, 5, 9)
    differences = by_each(lambda a: coupling(a, SLOPE, OFFSET, SIGMA).residual[0], angles)
    expected = of_own_finger(differences)
    close(coupling(angles, SLOPE, OFFSET, SIGMA).jacobian[0], expected)


def test_batch_equals_loop() -> None:
    angles = random(3, 5, 9)
    whole = coupling(angles, SLOPE, OFFSET, SIGMA)
    for i in range(3):
        one = coupling(angles[i : i + 1], SLOPE, OFFSET, SIGMA)
        close(whole.residual[i], one.residual[0])
        close(whole.jacobian[i], one.jacobian[0])
