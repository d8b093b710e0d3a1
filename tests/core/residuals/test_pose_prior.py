import numpy as np

from handfit_core.residuals.pose_prior import pose_prior
from tests.core.residuals.differences import by_each, close, of_own_finger, random

MEAN = random(5, 9, seed=1, scale=0.3)
ROOT = random(5, 9, 12, seed=2)
COVARIANCE = ROOT @ ROOT.swapaxes(-1, -2)
WHITEN = np.linalg.inv(np.linalg.cholesky(COVARIANCE))


def test_cost_is_the_mahalanobis_distance() -> None:
    angles = random(3, 5, 9)
    deviation = (angles - MEAN)[..., None]
    expected = (deviation.swapaxes(-1, -2) @ np.linalg.inv(COVARIANCE) @ deviation).reshape(3, 5)
    found = np.square(pose_prior(angles, MEAN, WHITEN).residual).sum(axis=-1)
    close(found, expected, rtol=1e-9, atol=1e-9)


def test_zero_at_the_mean() -> None:
    assert np.abs(pose_prior(MEAN[None], MEAN, WHITEN).residual).max() == 0


def test_jacobian_by_angles() -> None:
    angles = random(1, 5, 9)
    differences = of_own_finger(by_each(lambda a: pose_prior(a, MEAN, WHITEN).residual[0], angles))
    close(pose_prior(angles, MEAN, WHITEN).jacobian[0], differences, rtol=1e-6, atol=1e-7)


def test_batch_equals_loop() -> None:
    angles = random(3, 5, 9)
    whole = pose_prior(angles, MEAN, WHITEN)
    for i in range(3):
        close(whole.residual[i], pose_prior(angles[i : i + 1], MEAN, WHITEN).residual[0])
