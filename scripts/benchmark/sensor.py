"""What a camera's sensor and its JPEG add to a picture."""

from __future__ import annotations

import numpy as np


def with_noise(rgb: np.ndarray, gain: float, rng: np.random.Generator) -> np.ndarray:
    """Add noise to (H, W, 3) values 0..1: shot noise grows with the root of the light, read noise does not.

    `gain` is the standard deviation at white. Returns values 0..1.
    """
    spread = gain * np.sqrt(np.clip(rgb, 0.0, 1.0)) + 0.25 * gain
    return np.clip(rgb + spread * rng.standard_normal(rgb.shape), 0.0, 1.0)
