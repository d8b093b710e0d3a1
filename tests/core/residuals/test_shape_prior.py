import numpy as np

from handfit_core.residuals.shape_prior import shape_prior
from tests.core.residuals.differences import by_each, close, random

SIGMA = np.abs(random(10, seed=1)) + 0.5


def test_residuals_and_their_derivatives() -> None:
    betas = random(1, 10)
    residual, slope = shape_prior(betas, SIGMA)
    close(residual * SIGMA, betas)
    differences = by_each(lambda b: shape_prior(b, SIGMA)[0][0], betas)
    close(np.diag(slope), differences, rtol=1e-6, atol=1e-8)


def test_about_another_mean() -> None:
    betas, mean = random(3, 10), random(10, seed=2)
    residual, slope = shape_prior(betas, SIGMA, mean)
    close(residual, shape_prior(betas - mean, SIGMA)[0])
    close(slope, shape_prior(betas, SIGMA)[1])
    assert np.abs(shape_prior(mean[None], SIGMA, mean)[0]).max() == 0


def test_the_mean_shape_costs_nothing() -> None:
    assert np.abs(shape_prior(np.zeros((2, 10)), SIGMA)[0]).max() == 0
