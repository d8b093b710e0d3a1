"""Distance of a hand's shape from what is expected."""

from __future__ import annotations

import numpy as np


def shape_prior(
    betas: np.ndarray, sigma: np.ndarray, mean: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """betas (B, 10), sigma (10,), mean (10,), which is zero where it is None -> residuals (B, 10) and their
    derivatives (10,), a diagonal."""
    away = betas if mean is None else betas - mean
    return away / sigma, 1.0 / sigma
