"""Clips as banded systems: their normal equations solved directly, and long clips window by window."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.fit.settings import SOLVER

S = TypeVar("S", bound=Batch)


def solve_windows(start: S, overlap: int, solve: Callable[[slice, S], S]) -> S:
    """Solve T consecutive frames window by window; two neighbouring windows share `overlap` frames.

    `solve` takes the slice of a window's frames and the states that they start from, and returns their
    solution. Of the frames that two windows share, the first half is taken from the earlier window.
    """
    count, state, first = len(start), start, 0
    while True:
        last = min(first + SOLVER.window_frames + overlap, count)
        window, keep = slice(first, last), overlap // 2 if first else 0
        found = solve(window, start.select(window))
        state = state.replaced(np.arange(first + keep, last), found.select(slice(keep, None)))
        if last == count:
            return state
        first += SOLVER.window_frames


def put_lower(band: np.ndarray, rows: slice, blocks: np.ndarray) -> None:
    """Write the blocks (t, m, n) of the frames `rows` into a band (T, n, width), which transposed is LAPACK's
    lower form. A block's rows are the frame's own n variables and, if m > n, those of the frames after it."""
    _, height, size = blocks.shape
    for column in range(size):
        band[rows, column, : height - column] = blocks[:, column:, column]


def solve_bordered(
    band: np.ndarray,
    right: np.ndarray,
    border: np.ndarray,
    corner: np.ndarray,
    corner_right: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The solutions (N,) and (k,) of a symmetric system, a band with a border:

        A x + B y = right    B^T x + C y = corner_right

    `band`: A in LAPACK's lower form; right (N,); `border`: B (N, k); `corner`: C (k, k).
    """
    found = solve_band(band, np.column_stack([right, border]))
    alone, coupled = found[:, 0], found[:, 1:]
    y = np.linalg.solve(corner - border.T @ coupled, corner_right - border.T @ alone)
    return alone - coupled @ y, y


def solve_band(band: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a positive definite banded system with matrix `band` in LAPACK's lower form, and
    return the solution. Both arrays are overwritten."""
    from scipy.linalg import solveh_banded  # slow to load

    return solveh_banded(band, right, overwrite_ab=True, overwrite_b=True, lower=True, check_finite=False)
