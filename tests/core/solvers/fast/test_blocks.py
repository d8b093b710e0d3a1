"""The structured step against a dense solve of the same damped system."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from handfit_core.solvers.fast.blocks import Blocks
from tests.core.residuals.differences import random

FLOOR = 1e-6
"""Added to every diagonal beside the relative damping"""


def make_blocks(batch: int, n: int, seed: int = 0) -> tuple[Blocks, torch.Tensor, torch.Tensor]:
    """Blocks, and the whole matrices (B, n + 45, n + 45) and gradients (B, n + 45) that they are parts of."""
    rows = random(batch, 5, 12, n + 9, seed=seed)
    own = random(batch, 3, n, seed=seed + 1)
    gradient = random(batch, n + 45, seed=seed + 2)
    whole = torch.zeros(batch, n + 45, n + 45, dtype=torch.float64)
    whole[:, :n, :n] = own.mT @ own
    for f in range(5):
        columns = [*range(n), *range(n + 9 * f, n + 9 * f + 9)]
        part = rows[:, f].mT @ rows[:, f]
        for i, column in enumerate(columns):
            whole[:, column, columns] += part[:, i]
    finger = torch.stack(
        [whole[:, n + 9 * f : n + 9 * f + 9, n + 9 * f : n + 9 * f + 9] for f in range(5)], 1
    )
    mixed = whole[:, n:, :n].reshape(batch, 5, 9, n)
    blocks = Blocks(
        whole[:, :n, :n],
        mixed,
        finger,
        gradient[:, :n],
        gradient[:, n:].reshape(batch, 5, 9),
        random(batch, seed=seed + 3).abs(),
    )
    return blocks, whole, gradient


def damped(whole: torch.Tensor, damping: torch.Tensor) -> torch.Tensor:
    diagonal = whole.diagonal(dim1=-2, dim2=-1)
    return whole + torch.diag_embed(diagonal * damping[:, None] + FLOOR)


@pytest.mark.parametrize("n", [7, 17, 20])
def test_step_equals_a_dense_solve(n: int) -> None:
    blocks, whole, gradient = make_blocks(4, n)
    damping = torch.tensor([1e-7, 1e-3, 0.1, 100.0], dtype=torch.float64)
    expected = -torch.linalg.solve(damped(whole, damping), gradient)
    of_hand, of_fingers = blocks.step(damping)
    torch.testing.assert_close(of_hand, expected[:, :n], rtol=1e-7, atol=1e-9)
    torch.testing.assert_close(of_fingers, expected[:, n:].view(4, 5, 9), rtol=1e-7, atol=1e-9)


def test_shared_step_equals_one_dense_solve() -> None:
    """The last 10 variables are the same in all problems: one matrix of 3 (7 + 45) + 10."""
    n, shared, batch = 17, 10, 3
    blocks, whole, gradient = make_blocks(batch, n)
    damping = torch.full((batch,), 1e-2, dtype=torch.float64)
    own, size = n - shared, n - shared + 45
    total = torch.zeros(batch * size + shared, batch * size + shared, dtype=torch.float64)
    right = torch.zeros(batch * size + shared, dtype=torch.float64)
    private = [*range(own), *range(n, n + 45)]
    for i, matrix in enumerate(damped(whole, damping)):
        columns = np.array([*range(i * size, i * size + size), *range(batch * size, batch * size + shared)])
        order = [*private, *range(own, n)]
        total[np.ix_(columns, columns)] += matrix[order][:, order]
        right[columns] += gradient[i][order]
    expected = -torch.linalg.solve(total, right)
    of_hand, of_fingers = blocks.step(damping, shared=shared)
    frames = expected[: batch * size].view(batch, size)
    torch.testing.assert_close(of_hand[:, :own], frames[:, :own], rtol=1e-7, atol=1e-9)
    torch.testing.assert_close(of_fingers.reshape(batch, 45), frames[:, own:], rtol=1e-7, atol=1e-9)
    for i in range(batch):
        torch.testing.assert_close(of_hand[i, own:], expected[batch * size :], rtol=1e-7, atol=1e-9)


def test_batch_equals_loop() -> None:
    blocks, _, _ = make_blocks(5, 17)
    damping = torch.logspace(-6, 2, 5, dtype=torch.float64)
    of_hand, of_fingers = blocks.step(damping)
    for i in range(5):
        index = torch.tensor([i])
        one_hand, one_fingers = blocks.select(index).step(damping[index])
        torch.testing.assert_close(of_hand[i], one_hand[0])
        torch.testing.assert_close(of_fingers[i], one_fingers[0])


def test_a_problem_of_nan_harms_no_other() -> None:
    blocks, _, _ = make_blocks(3, 17)
    damping = torch.full((3,), 1e-3, dtype=torch.float64)
    expected, _ = blocks.step(damping)
    for name in ("hand", "mixed", "finger", "hand_gradient", "finger_gradient"):
        getattr(blocks, name)[1] = torch.nan
    found, fingers = blocks.step(damping)
    torch.testing.assert_close(found[[0, 2]], expected[[0, 2]])
    assert fingers[[0, 2]].isfinite().all()


def test_huge_damping_is_a_short_step_down_the_gradient() -> None:
    blocks, whole, gradient = make_blocks(1, 7)
    of_hand, _ = blocks.step(torch.tensor([1e9], dtype=torch.float64))
    diagonal = whole[0].diagonal()
    torch.testing.assert_close(of_hand[0], -(gradient[0] / diagonal / 1e9)[:7], rtol=1e-6, atol=0)


def test_where_chooses_problem_by_problem() -> None:
    first, _, _ = make_blocks(2, 7, seed=0)
    second, _, _ = make_blocks(2, 7, seed=9)
    mixed = first.where(torch.tensor([False, True]), second)
    for name in Blocks.__dataclass_fields__:
        assert torch.equal(getattr(mixed, name)[0], getattr(second, name)[0])
        assert torch.equal(getattr(mixed, name)[1], getattr(first, name)[1])


def test_held_variables_stay_and_the_others_are_solved_without_them() -> None:
    """Against a dense solve without their rows and columns; another set in each problem."""
    n = 7
    blocks, whole, gradient = make_blocks(3, n)
    held = random(3, n + 45, seed=5) > 0.8
    held[0, :6] = True
    held[1] = False
    damping = torch.tensor([1e-3, 0.1, 1e-7], dtype=torch.float64)
    of_hand, of_fingers = blocks.holding(held[:, :n], held[:, n:].view(3, 5, 9)).step(damping)
    found = torch.cat([of_hand, of_fingers.flatten(1)], dim=1)
    full = damped(whole, damping)
    for i in range(3):
        free = torch.nonzero(~held[i])[:, 0]
        expected = -torch.linalg.solve(full[i][free][:, free], gradient[i][free])
        torch.testing.assert_close(found[i][free], expected, rtol=1e-7, atol=1e-9)
        assert (found[i][held[i]] == 0).all()
    # The blocks themselves are left as they are.
    again, _ = blocks.step(damping)
    assert (again[0, :6] != 0).all()
