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


fingers_alone_or_coupled = pytest.mark.parametrize("coupled", [False, True])


@fingers_alone_or_coupled
@pytest.mark.parametrize("n", [7, 17])
def test_step_equals_a_dense_solve(n: int, coupled: bool) -> None:
    blocks, whole, gradient = make_blocks(4, n, coupled=coupled)
    damping = np.array([1e-7, 1e-3, 0.1, 100.0])
    expected = -np.linalg.solve(damped(whole, damping), gradient[..., None])[..., 0]
    of_hand, of_fingers = blocks.step(damping)
    close(of_hand, expected[:, :n], rtol=1e-7, atol=1e-9)
    close(of_fingers, expected[:, n:].reshape(4, 5, 9), rtol=1e-7, atol=1e-9)


def test_shared_step_equals_dense_solve() -> None:
    """The shape is the same in all problems: one matrix of 3 (7 + 45) + 10."""
    n, shared, batch = 17, 10, 3
    blocks, whole, gradient = make_blocks(batch, n)
    damping = np.full((batch,), 1e-2)
    own, size = n - shared, n - shared + 45
    total = np.zeros((batch * size + shared, batch * size + shared))
    right = np.zeros(batch * size + shared)
    mine, common = np.setdiff1d(np.arange(n), np.arange(n)[BETAS]), np.arange(n)[BETAS]
    private = [*mine, *range(n, n + 45)]
    for i, matrix in enumerate(damped(whole, damping)):
        columns = np.array([*range(i * size, i * size + size), *range(batch * size, batch * size + shared)])
        order = [*private, *common]
        total[np.ix_(columns, columns)] += matrix[order][:, order]
        right[columns] += gradient[i][order]
    expected = -np.linalg.solve(total, right)
    of_hand, of_fingers = blocks.step(damping, shared_shape=True)
    frames = expected[: batch * size].reshape(batch, size)
    close(of_hand[:, mine], frames[:, :own], rtol=1e-7, atol=1e-9)
    close(of_fingers.reshape(batch, 45), frames[:, own:], rtol=1e-7, atol=1e-9)
    for i in range(batch):
        close(of_hand[i, common], expected[batch * size :], rtol=1e-7, atol=1e-9)


def test_huge_damping() -> None:
    blocks, whole, gradient = make_blocks(1, 7)
    of_hand, _ = blocks.step(np.array([1e9]))
    diagonal = whole[0].diagonal()
    close(of_hand[0], -(gradient[0] / diagonal / 1e9)[:7], rtol=1e-6, atol=0)


@fingers_alone_or_coupled
def test_fixed_variables(coupled: bool) -> None:
    """Against a dense solve without their rows and columns; another set in each problem."""
    n = 7
    blocks, whole, gradient = make_blocks(3, n, coupled=coupled)
    held = random(3, n + 45, seed=5) > 0.8
    held[0, :6] = True
    held[1] = False
    damping = np.array([1e-3, 0.1, 1e-7])
    of_hand, of_fingers = blocks.with_fixed(held[:, :n], held[:, n:].reshape(3, 5, 9)).step(damping)
    found = np.concatenate([of_hand, of_fingers.reshape(-1, 45)], axis=1)
    full = damped(whole, damping)
    for i in range(3):
        free = np.flatnonzero(~held[i])
        expected = -np.linalg.solve(full[i][free][:, free], gradient[i][free])
        close(found[i][free], expected, rtol=1e-7, atol=1e-9)
        assert (found[i][held[i]] == 0).all()
    # The blocks themselves are left as they are.
    again, _ = blocks.step(damping)
    assert (again[0, :6] != 0).all()
