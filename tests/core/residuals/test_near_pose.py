import math

import torch

from handfit_core.residuals.near_pose import near_pose
from tests.core.residuals.differences import by_each, of_own_finger, random

START = random(3, 5, 9, seed=1, scale=0.5)
SIGMA = random(3, 5, seed=2).abs() + 0.05
SIGMA[:, 4] = torch.inf


def test_residual_counts_in_sigmas() -> None:
    found = near_pose(START + 0.1, START, SIGMA).residual
    torch.testing.assert_close(found, (0.1 / SIGMA)[..., None].expand(3, 5, 9))


def test_where_nothing_is_kept_nothing_counts() -> None:
    rows = near_pose(random(3, 5, 9), START, SIGMA)
    assert rows.residual[:, 4].abs().max() == 0.0
    assert rows.jacobian[:, 4].abs().max() == 0.0


def test_the_shorter_way_round() -> None:
    start = torch.full((1, 5, 9), math.pi - 0.1, dtype=torch.float64)
    sigma = torch.ones(1, 5, dtype=torch.float64)
    found = near_pose(0.1 - math.pi + torch.zeros_like(start), start, sigma)
    torch.testing.assert_close(found.residual, torch.full_like(start, 0.2))


def test_jacobian_by_angles() -> None:
    angles = START[:1] + random(1, 5, 9, seed=3, scale=0.3)
    differences = of_own_finger(by_each(lambda a: near_pose(a, START[:1], SIGMA[:1]).residual[0], angles))
    found = near_pose(angles, START[:1], SIGMA[:1]).jacobian[0]
    torch.testing.assert_close(found, differences, rtol=1e-6, atol=1e-7)


def test_batch_equals_loop() -> None:
    angles = random(3, 5, 9)
    whole = near_pose(angles, START, SIGMA)
    for i in range(3):
        one = near_pose(angles[i : i + 1], START[i : i + 1], SIGMA[i : i + 1])
        torch.testing.assert_close(whole.residual[i], one.residual[0])
        torch.testing.assert_close(whole.jacobian[i], one.jacobian[0])
