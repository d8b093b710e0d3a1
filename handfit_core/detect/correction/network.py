"""The correction network: three layers in NumPy, a few hundred kilobytes of weights.

For a detection taken for a hand of one side it predicts corrected landmarks, the expected error of each
coordinate, and the probability that the side is right.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.skeleton import NUM_KEYPOINTS
from handfit_core.detect.correction.canonical import Canonical

FILE: Final = Path(__file__).parent / "data" / "landmark_network.npz"
MAX_FEATURE: Final = 4.0
"""Standard deviations to which features are clipped"""
LOG_SIGMA: Final = -2.0
"""Offset that is added to the network's log sigmas"""


@dataclass(frozen=True, eq=False)
class Correction:
    """The network's output for N detections, in the canonical frame."""

    points: np.ndarray
    """(N, 21, 3) landmarks"""
    sigma: np.ndarray
    """(N, 21, 3) mean absolute error expected of each coordinate"""
    right_side: np.ndarray
    """(N,) probability that the assumed side is the true one"""


class Layers:
    """The three layers' weights and forward pass."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self._mean = arrays["mean"].astype(np.float32)
        self._scale = 1.0 / arrays["deviation"].astype(np.float32)
        self._layers = [
            (arrays[f"weight_{i}"].astype(np.float32).T.copy(), arrays[f"bias_{i}"].astype(np.float32))
            for i in range(3)
        ]

    def __call__(self, features: np.ndarray) -> np.ndarray:
        """(N, inputs) -> (N, outputs)"""
        values = np.clip((features.astype(np.float32) - self._mean) * self._scale, -MAX_FEATURE, MAX_FEATURE)
        for weight, bias in self._layers[:-1]:
            values = _gelu(values @ weight + bias)
        weight, bias = self._layers[-1]
        return np.asarray(values @ weight + bias, dtype=np.float64)


class LandmarkNetwork:
    """Turns the layers' output into corrections."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self._layers = Layers(arrays)

    def __call__(self, detections: Canonical) -> Correction:
        """Correct N detections."""
        values = self._layers(detections.features)
        per_point = values[:, :-1].reshape(-1, NUM_KEYPOINTS, 6)
        return Correction(
            points=detections.fused + per_point[..., :3],
            sigma=np.exp(per_point[..., 3:] + LOG_SIGMA),
            right_side=1.0 / (1.0 + np.exp(-values[:, -1])),
        )


@lru_cache(maxsize=1)
def landmark_network() -> LandmarkNetwork:
    """The network that ships with the package."""
    with np.load(FILE, allow_pickle=False) as arrays:
        return LandmarkNetwork(dict(arrays))


def _gelu(x: np.ndarray) -> np.ndarray:
    """x Phi(x) in the approximation by tanh (Hendrycks and Gimpel, 2016)."""
    return (
        0.5 * x * (1.0 + np.tanh(np.float32(np.sqrt(2.0 / np.pi)) * (x + np.float32(0.044715) * x * x * x)))
    )


__all__ = ["FILE", "Correction", "LandmarkNetwork", "Layers", "landmark_network"]
