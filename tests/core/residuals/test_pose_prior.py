import torch

from handfit_core.residuals.pose_prior import pose_prior
from tests.core.residuals.differences import by_each, of_own_finger, random

MEAN = random(5, 9, seed=1, scale=0.3)
ROOT = random(5, 9, 12, seed=2)
COVARIANCE = ROOT @ ROOT.mT
WHITEN = torch.linalg.inv(torch.linalg.cholesky(COVARIANCE))


def test_cost_is_the_mahalanobis_distance() -> None:
    angles = random(3, 5, 9)
    deviation = (angles - MEAN).unsqueeze(-1)
    expected = (deviation.mT @ torch.linalg.inv(COVARIANCE) @ deviation).reshape(3, 5)
    found = pose_prior(angles, MEAN, WHITEN).residual.square().sum(dim=-1)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


def test_zero_at_the_mean() -> None:
    assert pose_prior(MEAN[None], MEAN, WHITEN).residual.abs().max() == 0


def test_jacobian_by_angles() -> None:
    angles = random(1, 5, 9)
    differences = of_own_finger(by_each(lambda a: pose_prior(a, MEAN, WHITEN).residual[0], angles))
    torch.testing.assert_close(
        pose_prior(angles, MEAN, WHITEN).jacobian[0], differences, rtol=1e-6, atol=1e-7
    )


def test_batch_equals_loop() -> None:
    angles = random(3, 5, 9)
    whole = pose_prior(angles, MEAN, WHITEN)
    for i in range(3):
        torch.testing.assert_close(whole.residual[i], pose_prior(angles[i : i + 1], MEAN, WHITEN).residual[0])
