import math

import numpy as np

from handfit_core.residuals.near_pose import near_pose
from tests.core.residuals.differences import by_each, close, of_own_finger, random

START = random(3, 5, 9, seed=1, scale=0.5)
SIGMA = np.abs(random(3, 5, seed=2)) + 0.05
SIGMA[:, 4] = np.inf


def test_residual_counts_in_sigmas() -> None:
    found = near_pose(START + 0.1, START, SIGMA).residual
    close(found, np.broadcast_to((0.1 / SIGMA)[..., None], (3, 5, 9)))


def test_where_nothing_is_kept_nothing_counts() -> None:
    rows = near_pose(random(3, 5, 9), START, SIGMA)
    assert np.abs(rows.residual[:, 4]).max() == 0.0
    assert np.abs(rows.jacobian[:, 4]).max() == 0.0


def test_the_shorter_way_round() -> None:
    start = np.full((1, 5, 9), math.pi - 0.1)
    sigma = np.ones((1, 5))
    found = near_pose(0.1 - math.pi + np.zeros_like(start), start, sigma)
    close(found.residual, np.full_like(start, 0.2))


def test_jacobian_by_angles() -> None:
    angles = START[:1] + random(1, 5, 9, seed=3, scale=0.3)
    differences = of_own_finger(by_each(lambda a: near_pose(a, START[:1], SIGMA[:1]).residual[0], angles))
    found = near_pose(angles, START[:1], SIGMA[:1]).jacobian[0]
    close(found, differences, rtol=1e-6, atol=1e-7)


def test_batch_equals_loop() -> None:
    angles = random(3, 5, 9)
    whole = near_pose(angles, START, SIGMA)
    for i in range(3):
        one = near_pose(angles[i : i + 1], START[i : i + 1], SIGMA[i : i + 1])
        close(whole.residual[i], one.residual[0])
        close(whole.jacobian[i], one.jacobian[0])
