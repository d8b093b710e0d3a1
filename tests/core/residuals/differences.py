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


def of_own_point(differences: np.ndarray) -> np.ndarray:
    """(21, c, 63) differences of one hand's rows by all its points -> (21, c, 3) by the row's own point.

    Fails where a row depends on another point: a term on points must not.
    """
    return _own(differences, 3)


def of_own_finger(differences: np.ndarray) -> np.ndarray:
    """(5, c, 45) differences of one hand's rows by all its angles -> (5, c, 9) by the row's own finger."""
    return _own(differences, 9)


def _own(differences: np.ndarray, size: int) -> np.ndarray:
    count, rows, _ = differences.shape
    whole = differences.reshape(count, rows, count, size)
    own = np.stack([whole[k, :, k] for k in range(count)])
    others = whole.copy()
    others[range(count), :, range(count)] = 0
    assert np.abs(others).max() == 0
    return own
