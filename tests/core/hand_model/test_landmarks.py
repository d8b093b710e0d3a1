"""Landmarks on bones, and the length of a hand with the shape that has it."""

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, SIDES
from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.anatomy import anatomical_axes
from handfit_core.hand_model.landmarks import NO_OFFSETS, Landmarks, bone_axes, hand_length
from handfit_core.hand_model.length import betas_of_length, flat_hand_length, length_rates
from tests.imitation_mano import imitation_model

STEP = 1e-6


@pytest.fixture(params=["open-hand", "mano"])
def model(request: pytest.FixtureRequest) -> HandModel:
    return load_model(None, "right") if request.param == "open-hand" else imitation_model("right")


def test_left_offsets_are_mirrored() -> None:
    """In the model frame, x changes its sign; bones have their anatomical axes."""
    landmarks = Landmarks(np.random.default_rng(0).normal(size=(21, 3)) * 0.05)
    in_model, carrying = {}, [0, *(FINGER_JOINTS[f][min(k, 2)] for f in FINGERS for k in range(4))]
    for side in SIDES:
        hand = load_model(None, side)
        axes = bone_axes(hand)
        np.testing.assert_array_equal(axes, [np.eye(3), *anatomical_axes(hand)])
        placed = landmarks.in_metres(hand)
        in_model[side] = np.einsum("kab,kb->ka", axes[carrying], placed)
        assert not NO_OFFSETS.in_metres(hand).any()
    np.testing.assert_allclose(in_model["left"], in_model["right"] * [-1.0, 1.0, 1.0], atol=1e-9)


def test_lengths(model: HandModel) -> None:
    """To the middle finger's knuckle, and to its tip."""
    for shape in (None, np.linspace(-1, 1, 10)):
        keypoints = model.posed(shape, np.zeros(3), np.zeros(45), np.zeros(3)).keypoints
        assert flat_hand_length(model, shape) == pytest.approx(np.linalg.norm(keypoints[12] - keypoints[0]))
        if shape is None:
            assert hand_length(model) == pytest.approx(np.linalg.norm(keypoints[9] - keypoints[0]))


def slope(model: HandModel, betas: np.ndarray) -> np.ndarray:
    """(10,) by differences."""
    ends = [flat_hand_length(model, betas + sign * STEP * e) for e in np.eye(10) for sign in (1, -1)]
    return -np.diff(ends)[::2] / (2 * STEP)


def test_rates_are_the_lengths_derivatives(model: HandModel) -> None:
    betas = np.linspace(-1, 1, 10)
    np.testing.assert_allclose(length_rates(model, betas), slope(model, betas), atol=1e-8)


@pytest.mark.parametrize("factor", [0.8, 1.1])
def test_the_shape_has_the_length(model: HandModel, factor: float) -> None:
    """And no shape nearby that has it, too, is nearer to the mean."""
    length = factor * flat_hand_length(model)
    betas = betas_of_length(model, length)
    assert flat_hand_length(model, betas) == pytest.approx(length, abs=1e-5)
    for off in 0.05 * np.random.default_rng(0).normal(size=(20, 10)):
        other = betas + off
        along = slope(model, other)
        for _ in range(3):
            other = other + along * (length - flat_hand_length(model, other)) / (along @ along)
        assert np.linalg.norm(other) > np.linalg.norm(betas) - 1e-4


@pytest.mark.parametrize("side", SIDES)
def test_an_average_hand_is_the_mean(side) -> None:
    model = load_model(None, side)
    np.testing.assert_allclose(betas_of_length(model, flat_hand_length(model)), 0, atol=1e-9)
    assert 0.17 < flat_hand_length(model) < 0.20  # metres, of an adult
    rigid = replace(model, shapedirs=np.zeros_like(model.shapedirs))
    np.testing.assert_array_equal(betas_of_length(rigid, 0.1), np.zeros(10))
