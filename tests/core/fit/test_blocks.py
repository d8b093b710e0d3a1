"""The structured step against a dense solve of the same damped system."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.fit.blocks import Blocks
from handfit_core.fit.settings import SOLVER
from handfit_core.hand_model.chain import BETAS
from tests.core.fit.differences import close, random


def make_blocks(
    batch: int, n: int, seed: int = 0, *, coupled: bool = False
) -> tuple[Blocks, np.ndarray, np.ndarray]:
    """Blocks, of which fingers of all but the first problem may be coupled, and the whole matrices
    (B, n + 45, n + 45) and gradients (B, n + 45) that they are parts of."""
    rows = random(batch, 5, 12, n + 9, seed=seed)
    own = random(batch, 3, n, seed=seed + 1)
    gradient = random(batch, n + 45, seed=seed + 2)
    whole = np.zeros((batch, n + 45, n + 45))
    whole[:, :n, :n] = own.swapaxes(-1, -2) @ own
    for f in range(5):
        columns = [*range(n), *range(n + 9 * f, n + 9 * f + 9)]
        part = rows[:, f].swapaxes(-1, -2) @ rows[:, f]
        for i, column in enumerate(columns):
            whole[:, column, columns] += part[:, i]
    between = np.zeros((batch, 45, 45))
    if coupled:
        pairs = random(batch, 4, 45, seed=seed + 4)
        pairs[0] = 0.0
        between = pairs.swapaxes(-1, -2) @ pairs
        whole[:, n:, n:] += between
        np.einsum("bfifj->bfij", between.reshape(batch, 5, 9, 5, 9))[...] = 0.0
    finger = np.stack([whole[:, n + 9 * f : n + 9 * f + 9, n + 9 * f : n + 9 * f + 9] for f in range(5)], 1)
    mixed = whole[:, n:, :n].reshape(batch, 5, 9, n)
    hand = np.concatenate([whole[:, :n, :n], gradient[:, :n, None]], axis=2)
    fingers = [finger, mixed, gradient[:, n:].reshape(batch, 5, 9, 1)]
    blocks = Blocks(hand, np.concatenate(fingers, axis=3), np.abs(random(batch, seed=seed + 3)))
    blocks = replace(blocks, between=between) if coupled else blocks
    return blocks, whole, gradient


def damped(whole: np.ndarray, damping: np.ndarray) -> np.ndarray:
    diagonal = np.einsum("bii->bi", whole)
    return whole + (diagonal * damping[:, None] + SOLVER.diagonal_floor)[..., None] * np.eye(whole.shape[-1])


@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("n", [7, 17])
def test_step_equals_a_dense_solve(n: int, coupled: bool, fixed: bool) -> None:
    """Without the rows and columns of fixed variables, which are others in each problem."""
    blocks, whole, gradient = make_blocks(4, n, coupled=coupled)
    damping = np.array([1e-7, 1e-3, 0.1, 100.0])
    held = (random(4, n + 45, seed=5) > 0.8) & fixed & (np.arange(4) != 1)[:, None]
    given = blocks.with_fixed(held[:, :n], held[:, n:].reshape(4, 5, 9)) if fixed else blocks
    of_hand, of_fingers = given.step(damping)
    found = np.concatenate([of_hand, of_fingers.reshape(-1, 45)], axis=1)
    for i, matrix in enumerate(damped(whole, damping)):
        free = ~held[i]
        expected = -np.linalg.solve(matrix[free][:, free], gradient[i, free])
        close(found[i, free], expected, rtol=1e-7, atol=1e-9)
        assert (found[i, held[i]] == 0).all()
    close(blocks.hand[..., :n], whole[:, :n, :n])  # which are left as they are


def test_shared_step_equals_dense_solve() -> None:
    """The shape is the same in all problems: one matrix of 3 (7 + 45) + 10."""
    blocks, whole, gradient = make_blocks(3, 17)
    damping = np.full(3, 1e-2)
    own = np.setdiff1d(np.arange(62), np.arange(62)[BETAS])
    total, right = np.zeros((166, 166)), np.zeros(166)
    for i, matrix in enumerate(damped(whole, damping)):
        columns = np.empty(62, dtype=int)
        columns[own], columns[BETAS] = 52 * i + np.arange(52), 156 + np.arange(10)
        total[np.ix_(columns, columns)] += matrix
        right[columns] += gradient[i]
    expected = -np.linalg.solve(total, right)
    of_hand, of_fingers = blocks.step(damping, shared_shape=True)
    found = np.concatenate([of_hand, of_fingers.reshape(3, 45)], axis=1)
    close(found[:, own], expected[:156].reshape(3, 52), rtol=1e-7, atol=1e-9)
    close(found[:, BETAS], np.tile(expected[156:], (3, 1)), rtol=1e-7, atol=1e-9)


def test_common_information_is_that_of_a_dense_inverse() -> None:
    """Two cameras' variables and the betas, once three hands' own are eliminated."""
    blocks, whole, _ = make_blocks(3, 17 + 9)
    common = np.r_[np.arange(71)[:26][BETAS], 17:26]
    own = np.setdiff1d(np.arange(71), common)
    total = sum(
        matrix[np.ix_(common, common)]
        - matrix[np.ix_(common, own)] @ np.linalg.solve(matrix[np.ix_(own, own)], matrix[np.ix_(own, common)])
        for matrix in damped(whole, np.zeros(3))
    )
    close(blocks.common_information(), total, rtol=1e-7, atol=1e-9)
