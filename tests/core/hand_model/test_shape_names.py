"""Names of shape coefficients, from movements that are made here in another way than in the module."""

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_BETAS, Side
from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.shape_names import effect_shares, shape_names
from tests.imitation_mano import imitation_model

OPEN_HAND_NAMES = (
    "Larger Hand",
    None,
    "Shorter Thumb",
    "Longer Middle Finger",
    "Longer Ring Finger",
    "Shorter Little Finger",
    "Thinner Hand",
    None,
    "Narrower Palm",
    None,
)


def with_shapes(model: HandModel, *movements: np.ndarray) -> HandModel:
    """The model with these (V, 3) movements as its first shape directions, and nothing in the others."""
    dirs = np.zeros((*model.v_template.shape, NUM_BETAS))
    dirs[:, :, : len(movements)] = np.stack(movements, axis=-1)
    return replace(model, shapedirs=dirs)


def of_finger(model: HandModel, finger: str) -> np.ndarray:
    """(V,) mask"""
    return np.isin(model.weights.argmax(axis=1), FINGER_JOINTS[finger])


def pulled_out(model: HandModel, finger: str) -> np.ndarray:
    """(V, 3) a finger stretched along the line from its base to its tip."""
    base, tip = model.shaped().joints[FINGER_JOINTS[finger][0]], model.shaped().tips[FINGERS.index(finger)]
    line = (tip - base) / np.linalg.norm(tip - base)
    along = (model.v_template - base) @ line
    return np.where(of_finger(model, finger)[:, None], along[:, None] * line, 0.0)


@pytest.fixture(scope="module", params=["right", "left"])
def model(request: pytest.FixtureRequest) -> HandModel:
    return imitation_model(request.param)


def test_each_effect_by_its_name(model: HandModel) -> None:
    x = model.v_template
    shaped = with_shapes(
        model,
        x * 0.1 + [0.02, -0.3, 0.1],  # wherever the larger hand is put
        -0.2 * pulled_out(model, "thumb"),
        0.3 * pulled_out(model, "index"),
        -np.sum([pulled_out(model, f) for f in FINGERS[1:]], axis=0),
    )
    names = "Larger Hand", "Shorter Thumb", "Longer Index Finger", "Shorter Fingers"
    assert shape_names(shaped) == (*names, *(None,) * 6)


def test_no_name_where_nothing_dominates(model: HandModel) -> None:
    rng = np.random.default_rng(3)
    three = [pulled_out(model, finger) for finger in ("thumb", "middle", "little")]
    equal = np.sum([movement / np.linalg.norm(movement) for movement in three], axis=0)
    turned = np.cross([0.1, 0.2, 0.3], model.v_template) + [0.01, 0.0, 0.0]
    shaped = with_shapes(model, rng.normal(0, 0.001, model.v_template.shape), equal, turned)
    assert shape_names(shaped) == (None,) * NUM_BETAS
    # A hand that is only put elsewhere has its shape still.
    assert effect_shares(shaped)[2:] == ({},) * 8


def test_names_are_unique(model: HandModel) -> None:
    pure = pulled_out(model, "ring")
    noise = np.random.default_rng(4).normal(0, 1, pure.shape)
    mixed = pure + noise * (0.5 * np.linalg.norm(pure) / np.linalg.norm(noise))
    assert shape_names(with_shapes(model, mixed, -pure))[:2] == (None, "Shorter Ring Finger")


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_open_hand(side: Side) -> None:
    model = load_model(None, side)
    assert shape_names(model) == OPEN_HAND_NAMES
