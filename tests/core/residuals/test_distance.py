import numpy as np
import pytest

from handfit_core.residuals.distance import distance
from tests.core.residuals.differences import by_each, close, random

START = random(4, 3, seed=1, scale=0.1) + np.array([0.0, 0.0, 0.6])
WRIST = START + random(4, 3, seed=2, scale=0.02)
SIGMA = np.array([0.01, 0.02, 0.05, np.inf])


def test_residual_counts_in_parts_of_the_distance() -> None:
    residual, _ = distance(1.03 * START, START, SIGMA)
    expected = np.array([3.0, 1.5, 0.6, 0.0])
    close(residual, expected)


def test_derivatives() -> None:
    for i in range(4):
        one = slice(i, i + 1)
        differences = by_each(lambda w, one=one: distance(w, START[one], SIGMA[one])[0], WRIST[one])
        slope = distance(WRIST[one], START[one], SIGMA[one])[1]
        close(slope, differences, rtol=1e-6, atol=1e-6)


def test_across_the_line_of_sight_the_wrist_is_free() -> None:
    across = np.linalg.cross(START, WRIST - START)
    residual, _ = distance(START + across, START, SIGMA)
    assert np.abs(residual).max() < 1e-10


def test_where_nothing_is_expected_nothing_is_held() -> None:
    residual, slope = distance(WRIST[3:], START[3:], SIGMA[3:])
    assert residual.item() == 0.0
    assert np.abs(slope).max() == 0.0


def test_batch_equals_loop() -> None:
    whole = distance(WRIST, START, SIGMA)
    for i in range(4):
        one = distance(WRIST[i : i + 1], START[i : i + 1], SIGMA[i : i + 1])
        assert one[0].item() == pytest.approx(whole[0][i].item(), rel=1e-12)
        close(one[1][0], whole[1][i])
