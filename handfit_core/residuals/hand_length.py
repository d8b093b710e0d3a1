"""Distance of a hand's length from the one that was measured."""

from __future__ import annotations

import numpy as np


def hand_length(
    betas: np.ndarray, expected: np.ndarray, rates: np.ndarray, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """betas (B, 10); expected (10,) of a hand of the right length; rates (10,) metres of length by beta;
    sigma in metres -> residuals (B,) and their derivatives (10,). The length is all but linear in betas."""
    slope = rates / sigma
    return (betas - expected) @ slope, slope
