"""The length of a hand, and the shape that has it."""

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.length import betas_of_length, flat_hand_length, length_rates
from handfit_core.skeleton import SIDES, Side
from tests.imitation_mano import imitation_model


@pytest.fixture(params=["open-hand", "mano"])
def model(request: pytest.FixtureRequest) -> HandModel:
    return load_model(None, "right") if request.param == "open-hand" else imitation_model("right")


def test_flat_hand_length(model: HandModel) -> None:
    betas = np.linspace(-1, 1, 10)
    for shape in (None, betas):
        keypoints = model.posed(shape, np.zeros(3), np.zeros(45), np.zeros(3)).keypoints
        assert flat_hand_length(model, shape) == pytest.approx(np.linalg.norm(keypoints[12] - keypoints[0]))


@pytest.mark.parametrize("factor", [0.8, 0.95, 1.0, 1.1, 1.3])
def test_the_shape_has_the_length(model: HandModel, factor: float) -> None:
    length = factor * flat_hand_length(model)
    betas = betas_of_length(model, length)
    assert flat_hand_length(model, betas) == pytest.approx(length, abs=1e-5)
    # And no shape nearby that has it, too, is nearer to the mean.
    rng = np.random.default_rng(0)
    for _ in range(20):
        other = betas + 0.05 * rng.normal(size=10)
        slope = np.array(
            [flat_hand_length(model, other + 1e-5 * e) - flat_hand_length(model, other) for e in np.eye(10)]
        )
        slope /= 1e-5
        for _ in range(3):
            other = other + slope * (length - flat_hand_length(model, other)) / (slope @ slope)
        assert np.linalg.norm(other) > np.linalg.norm(betas) - 1e-4


@pytest.mark.parametrize("side", SIDES)
def test_an_average_hand_is_the_mean(side: Side) -> None:
    model = load_model(None, side)
    np.testing.assert_allclose(betas_of_length(model, flat_hand_length(model)), 0, atol=1e-9)
    assert 0.17 < flat_hand_length(model) < 0.20  # metres, of an adult


def test_a_model_without_shapes() -> None:
    model = load_model(None, "right")
    rigid = replace(model, shapedirs=np.zeros_like(model.shapedirs))
    np.testing.assert_array_equal(betas_of_length(rigid, 0.1), np.zeros(10))


def test_rates_are_the_lengths_derivatives(model: HandModel) -> None:
    betas = np.linspace(-1, 1, 10)
    step = 1e-6
    differences = [
        (flat_hand_length(model, betas + step * e) - flat_hand_length(model, betas - step * e)) / (2 * step)
        for e in np.eye(10)
    ]
    np.testing.assert_allclose(length_rates(model, betas), differences, atol=1e-8)
