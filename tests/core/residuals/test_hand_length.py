import numpy as np

from handfit_core.residuals.hand_length import hand_length
from tests.core.residuals.differences import by_each, close, random

EXPECTED, RATES = random(10, seed=1), random(10, seed=2) * 0.01


def test_residuals_and_their_derivatives() -> None:
    betas = random(1, 10)
    residual, slope = hand_length(betas, EXPECTED, RATES, 0.002)
    close(residual, ((betas - EXPECTED) * RATES).sum(axis=1) / 0.002)
    differences = by_each(lambda b: hand_length(b, EXPECTED, RATES, 0.002)[0], betas)
    close(slope[None], differences, rtol=1e-6, atol=1e-8)


def test_batch_equals_loop() -> None:
    betas = random(5, 10)
    whole = hand_length(betas, EXPECTED, RATES, 0.002)[0]
    each = [hand_length(b[None], EXPECTED, RATES, 0.002)[0] for b in betas]
    close(whole, np.concatenate(each))


def test_the_expected_shape_and_all_of_its_length_cost_nothing() -> None:
    across = random(10, seed=3)
    across = across - RATES * (across @ RATES) / (RATES @ RATES)
    for betas in (EXPECTED, EXPECTED + 3 * across):
        assert np.abs(hand_length(betas[None], EXPECTED, RATES, 0.002)[0]).max() < 1e-12
