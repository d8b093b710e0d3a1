"""A problem's gradient and matrices against finite differences of its cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.fit.blocks import Blocks
from handfit_core.fit.problem import Problem
from handfit_core.fit.terms import Limits, Shape, coupling, depth, distance, near_pose, reprojection
from handfit_core.hand_model.chain import HAND_SIZE, State
from handfit_core.hand_model.length import betas_of_length, length_rates
from tests.core.fit.differences import of_increments
from tests.core.fit.hands import (
    OFFSETS,
    anchored_near,
    chain_of,
    make_state,
    observe,
    prior_about_relaxed,
    problem_of,
    repeated,
)


def gradients_of(blocks: Blocks) -> np.ndarray:
    """(B, n + 45)"""
    return np.concatenate([blocks.hand[..., -1], blocks.finger[..., -1].reshape(-1, 45)], axis=1)


def matrix_of(blocks: Blocks) -> np.ndarray:
    """(n + 45, n + 45) of the first problem."""
    n = blocks.hand.shape[1]
    whole = np.zeros((n + 45, n + 45))
    whole[:n, :n] = blocks.hand[0, :, :-1]
    mixed = blocks.finger[0, ..., 9:-1].reshape(45, n)
    whole[n:, :n], whole[:n, n:] = mixed, mixed.T
    whole[n:, n:] = block_diag(*blocks.finger[0, ..., :9])
    return whole


def moved_by(problem: Problem, state: State, increments: np.ndarray) -> Blocks:
    """Those of the first hand, moved by each of the increments (B, n + 45)."""
    count, n = len(increments), increments.shape[1] - 45
    states = repeated(state, count).moved(increments[:, :n], increments[:, n:].reshape(-1, 5, 9))
    return problem.select(np.zeros(count, dtype=int)).blocks(states)


def problem_with(kind: str, side: Side) -> tuple[Problem, State]:
    chain = chain_of(side, OFFSETS)
    state, truth = make_state(1, chain, seed=1), make_state(1, chain, seed=1, spread=0.2)
    seen = observe(chain.points(truth), noise=20.0 if kind == "beyond one sigma" else 0.5)
    if kind == "length":
        betas = betas_of_length(chain.model, 0.17)
        shape = Shape(betas, length_rates(chain.model, betas))
        return problem_of(chain, seen, terms=(reprojection, depth, prior_about_relaxed(side), shape)), state
    if kind == "kept":
        seen = replace(seen, anchor=anchored_near(truth, 0.01), pinned=np.arange(21)[None] % 5 == 0)
        terms = (reprojection, depth, Limits(side), coupling, near_pose, distance)
        return problem_of(chain, seen, "given", terms), state
    return problem_of(chain, seen), state


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("kind", ["quadratic", "beyond one sigma", "length", "kept"])
def test_gradient_is_that_of_the_cost(kind: str, side: Side) -> None:
    """cost = sum of squares, gradient = J^T r: half of its derivative."""
    problem, state = problem_with(kind, side)
    blocks = problem.blocks(state)
    differences = of_increments(lambda by: moved_by(problem, state, by).cost, blocks.hand.shape[1] + 45)
    assert np.abs(2 * gradients_of(blocks)[0] - differences).max() < 1e-6 * np.abs(differences).max()


def test_matrices_are_half_hessians() -> None:
    """Where points fit exactly and only they count, Gauss-Newton's matrix is the Hessian."""
    chain = chain_of("right", OFFSETS)
    state = make_state(1, chain)
    points = chain.points(state)
    seen = observe(points)
    state = replace(state, depth_zero=(points @ seen.ray[..., None])[..., 0].mean(axis=1))
    problem = problem_of(chain, seen, terms=(reprojection, depth))
    blocks = problem.blocks(state)
    assert blocks.cost[0] < 1e-9
    hessian = of_increments(lambda by: gradients_of(moved_by(problem, state, by)), HAND_SIZE + 45)
    assert np.abs(matrix_of(blocks) - hessian).max() < 1e-6 * np.abs(hessian).max()
