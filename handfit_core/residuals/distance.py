"""How far a wrist has left its distance from the camera."""

from __future__ import annotations

import numpy as np


def distance(wrist: np.ndarray, start: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """wrist (B, 3) and start (B, 3) metres, camera frame, `start` not at the camera; sigma (B,) as a part of
    start's distance -> residuals (B,) and their derivatives (B, 3) by the wrist.

    r = (w . s / |s|^2 - 1) / sigma: along the line of sight only; across it the wrist is free.
    """
    slope = start / (np.square(start).sum(axis=1) * sigma)[:, None]
    return (wrist * slope).sum(axis=1) - 1.0 / sigma, slope
