"""Robust kernels as weights for iteratively re-weighted least squares.

A kernel rho(s) of a squared residual s (in units of its sigma squared) is minimised by weighing the
residual with w = rho'(s). Cf. Barron, "A General and Adaptive Robust Loss Function", 2019.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Kernel(Protocol):
    """rho and its derivative."""

    def cost(self, squared: np.ndarray) -> np.ndarray:
        """rho(s), elementwise."""
        ...

    def weight(self, squared: np.ndarray) -> np.ndarray:
        """rho'(s), elementwise."""
        ...


@dataclass(frozen=True)
class Huber:
    """Quadratic to `delta`, linear beyond: rho = s, or 2 delta sqrt(s) - delta^2."""

    delta: float

    def cost(self, squared: np.ndarray) -> np.ndarray:
        """rho(s), elementwise."""
        root = np.sqrt(squared)
        inner = np.minimum(root, self.delta)
        return inner * (2 * root - inner)

    def weight(self, squared: np.ndarray) -> np.ndarray:
        """rho'(s), elementwise."""
        return self.delta / np.sqrt(np.maximum(squared, self.delta**2))


@dataclass(frozen=True)
class GemanMcClure:
    """Saturates at `scale`^2: rho = scale^2 s / (scale^2 + s)."""

    scale: float

    def cost(self, squared: np.ndarray) -> np.ndarray:
        """rho(s), elementwise."""
        return self.scale**2 * squared / (self.scale**2 + squared)

    def weight(self, squared: np.ndarray) -> np.ndarray:
        """rho'(s), elementwise."""
        return (self.scale**2 / (self.scale**2 + squared)) ** 2


@dataclass(frozen=True, eq=False)
class QuadraticWhere:
    """Squares where `certain` says so, else another kernel."""

    certain: np.ndarray
    """bool, of the residuals' shape"""
    other: Kernel

    def cost(self, squared: np.ndarray) -> np.ndarray:
        """rho(s), elementwise."""
        return np.where(self.certain, squared, self.other.cost(squared))

    def weight(self, squared: np.ndarray) -> np.ndarray:
        """rho'(s), elementwise."""
        return np.where(self.certain, 1.0, self.other.weight(squared))
