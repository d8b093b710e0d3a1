"""Central differences, the independent formula for every analytic Jacobian."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

STEP = 1e-6


def close(found: object, expected: object, rtol: float = 1e-7, atol: float = 1e-7) -> None:
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=atol)  # type: ignore[arg-type]


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def by_each(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray) -> np.ndarray:
    """Derivatives of function(at), any shape, by every element of `at`: (*function's shape, at.size)."""
    columns = []
    for i in range(at.size):
        shift = np.zeros(at.size)
        shift[i] = STEP
        shift = shift.reshape(at.shape)
        columns.append((function(at + shift) - function(at - shift)) / (2 * STEP))
    return np.stack(columns, axis=-1)


def of_increments(function: Callable[[np.ndarray], np.ndarray], count: int) -> np.ndarray:
    """Derivatives at zero of function((2 count, count)) -> (2 count, ...), by each increment: (..., count).

    All shifts are one batch, which is faster than `by_each`.
    """
    shifts = np.eye(count) * STEP
    after = function(np.concatenate([shifts, -shifts]))
    return np.moveaxis((after[:count] - after[count:]) / (2 * STEP), 0, -1)


def random(*shape: int, seed: int = 0, scale: float = 1.0) -> np.ndarray:
    """Normal numbers."""
    return np.random.default_rng(seed).normal(size=shape) * scale
