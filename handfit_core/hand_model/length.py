"""The length of a hand, and the shape of a hand of a given length. NumPy only."""

from __future__ import annotations

import logging

import numpy as np

from handfit_core.common.skeleton import FINGERS, NUM_BETAS
from handfit_core.hand_model.data import HandModel

_MIDDLE = FINGERS.index("middle")


log = logging.getLogger("handfit")


def flat_hand_length(model: HandModel, betas: np.ndarray | None = None) -> float:
    """Return the metres from the wrist joint to the tip of the middle finger of a model's flat hand of shape
    `betas` (10,); None: the mean shape."""
    shaped = model.shaped(betas)
    return float(np.linalg.norm(shaped.tips[_MIDDLE] - shaped.joints[0]))


def length_rates(model: HandModel, betas: np.ndarray) -> np.ndarray:
    """Return the metres (10,) by which the length of a hand of shape `betas` (10,) grows with each of
    them."""
    shaped = model.shaped(betas)
    along = shaped.tips[_MIDDLE] - shaped.joints[0]
    return _span_by_betas(model).T @ (along / max(float(np.linalg.norm(along)), 1e-9))


def _span_by_betas(model: HandModel) -> np.ndarray:
    """Return the derivatives (3, 10), in metres, by betas of the vector from the wrist joint to the tip of
    the middle finger."""
    at_wrist = np.einsum("v,vck->ck", model.joint_regressor[0], model.shapedirs)
    return model.shapedirs[model.tip_vertices[_MIDDLE]] - at_wrist


def betas_of_length(model: HandModel, length: float) -> np.ndarray:
    """Return the shape (10,) nearest to the mean whose flat hand has that length in metres.

    Its norm tells how far from the mean that is, in standard deviations. A model whose shapes do not change
    the length gives zeros.
    """
    betas = np.zeros(NUM_BETAS)
    for _ in range(8):
        now, slope = flat_hand_length(model, betas), length_rates(model, betas)
        steepness = float(slope @ slope)
        if steepness < 1e-12:
            return np.zeros(NUM_BETAS)
        # The least-norm solution of the length, linearised where the betas are now.
        betas = slope * ((length - now + slope @ betas) / steepness)
    return betas


def betas_of_measured(model: HandModel, length: float) -> np.ndarray:
    """Return the shape (10,) nearest to the mean that has that length in metres, no farther from the mean
    than meshes keep their form."""
    betas = betas_of_length(model, length)
    # The open hand's mesh begins to fold six and a half standard deviations from the mean shape.
    return betas * min(1.0, 6.0 / max(float(np.linalg.norm(betas)), 1e-9))


def warn_of_odd_shapes(model: HandModel, length: float) -> None:
    """Warn where a hand length in metres asks for a shape that hardly any hand has."""
    away = float(np.linalg.norm(betas_of_length(model, length)))
    if away <= 3.0:  # standard deviations from the mean shape
        return
    reached = flat_hand_length(model, betas_of_measured(model, length))
    log.warning(
        "a hand %.0f mm long is %.1f standard deviations from the model's average of %.0f mm; its "
        "proportions may look odd%s",
        length * 1e3,
        away,
        flat_hand_length(model) * 1e3,
        "" if abs(reached - length) < 5e-4 else f", and {reached * 1e3:.0f} mm is as far as it goes",
    )
