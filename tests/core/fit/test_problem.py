"""A problem's gradient and matrices against finite differences of its cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from handfit_core.fit.blocks import Blocks
from handfit_core.fit.problem import Held, Problem
from handfit_core.fit.terms import Limits, Shape, coupling, depth, distance, near_pose, reprojection
from handfit_core.hand_model.chain import FIXED_SHAPE, HAND_SIZE, State
from handfit_core.hand_model.length import betas_of_length, length_rates
from handfit_core.skeleton import SIDES, Side
from tests.core.fit.differences import close, of_increments
from tests.core.fit.hands import (
    OFFSETS,
    chain_of,
    kept_near,
    make_state,
    observe,
    points_alone,
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


def moved_by(problem: Problem, state: State, increments: np.ndarray) -> tuple[Problem, State]:
    """The first hand by each of the increments (B, n + 45)."""
    count, n = len(increments), increments.shape[1] - 45
    states = repeated(state, count).moved(increments[:, :n], increments[:, n:].reshape(-1, 5, 9))
    return problem.select(np.zeros(count, dtype=int)), states


def problem_with(kind: str, side: Side) -> tuple[Problem, State]:
    chain = chain_of(side, OFFSETS)
    state, truth = make_state(1, chain, seed=1), make_state(1, chain, seed=1, spread=0.2)
    noise = {"quadratic": 0.5, "beyond one sigma": 20.0}.get(kind, 3.0)
    seen = observe(chain.pose(truth).points, noise=noise)
    if kind == "shape given":
        return problem_of(chain, seen, "given"), state
    if kind == "length":
        betas = betas_of_length(chain.model, 0.17)
        terms = (
            reprojection,
            depth,
            prior_about_relaxed(side),
            Shape(betas, length_rates(chain.model, betas)),
        )
        return problem_of(chain, seen, terms=terms), state
    if kind == "kept":
        seen = replace(seen, kept=kept_near(truth, 0.01), pinned=np.arange(21)[None] % 5 == 0)
        terms = (reprojection, depth, Limits(side), coupling, near_pose, distance)
        return problem_of(chain, seen, "given", terms), state
    return problem_of(chain, seen), state


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("kind", ["quadratic", "beyond one sigma", "shape given", "length", "kept"])
def test_gradient_is_that_of_the_cost(kind: str, side: Side) -> None:
    """cost = sum of squares, gradient = J^T r: half of its derivative."""
    problem, state = problem_with(kind, side)
    n = HAND_SIZE if problem.shape == "each" else len(FIXED_SHAPE)

    def cost(increments: np.ndarray) -> np.ndarray:
        problems, states = moved_by(problem, state, increments)
        return problems.blocks(states).cost

    blocks = problem.blocks(state)
    differences = of_increments(cost, n + 45)
    assert blocks.hand.shape == (1, n, n + 1)
    assert np.abs(2 * gradients_of(blocks)[0] - differences).max() < 1e-6 * np.abs(differences).max()


def test_matrices_are_half_hessians() -> None:
    """Where points fit exactly and only they count, Gauss-Newton's matrix is the Hessian."""
    chain = chain_of("right", OFFSETS)
    state = make_state(1, chain)
    points = chain.pose(state).points
    seen = observe(points)
    state = replace(state, depth_zero=(points @ seen.ray[..., None])[..., 0].mean(axis=1))
    problem = problem_of(chain, seen, terms=(reprojection, depth))

    def gradient(increments: np.ndarray) -> np.ndarray:
        problems, states = moved_by(problem, state, increments)
        return gradients_of(problems.blocks(states))

    blocks = problem.blocks(state)
    assert blocks.cost[0] < 1e-9
    hessian = of_increments(gradient, HAND_SIZE + 45)
    assert np.abs(matrix_of(blocks) - hessian).max() < 1e-6 * np.abs(hessian).max()


def test_matrices_are_semidefinite() -> None:
    chain = chain_of()
    seen = observe(chain.pose(make_state(3, chain, seed=2)).points, noise=5.0)
    whole = matrix_of(problem_of(chain, seen).blocks(make_state(3, chain)))
    close(whole, whole.T)
    assert np.linalg.eigvalsh(whole).min() > -1e-9 * np.abs(whole).max()


def test_batch_equals_loop() -> None:
    chain = chain_of("left")
    state = make_state(4, chain)
    problem = problem_of(chain, observe(chain.pose(make_state(4, chain, seed=1)).points))
    whole = problem.blocks(state)
    for i in range(4):
        one = problem.select(np.array([i])).blocks(state.select(np.array([i])))
        for name, values in whole._rows():
            close(values[i], getattr(one, name)[0], rtol=1e-9, atol=1e-7)


def held_of(state: State, *joints: int) -> Held:
    """The first of two hands is held at those joints."""
    at = np.zeros((2, 16), dtype=bool)
    at[0, list(joints)] = True
    return Held(at, state)


def test_held_joints() -> None:
    """Thumb 13, 14, 15 and index 1, 2, 3 come first, then middle, ring and little finger."""
    chain = chain_of()
    state, other = make_state(2, chain), make_state(2, chain, seed=3)
    problem = problem_of(chain, observe(chain.pose(other).points), "given")
    for joint, first in ((13, 3), (1, 12), (4, 21), (10, 30), (7, 39)):
        assert np.flatnonzero(held_of(state, joint).variables[0]).tolist() == [first, first + 1, first + 2]
    held = held_of(other, 0, 1, 14)
    of_hand, of_fingers = replace(problem, held=held).blocks(state).step(np.full(2, 1e-3))
    assert not of_hand[0, :6].any()
    assert of_hand[0, 6] != 0
    still = (of_fingers[0].reshape(5, 3, 3) == 0).all(axis=-1)
    assert np.argwhere(still).tolist() == [[0, 1], [1, 0]]
    assert of_hand[1].all()
    assert of_fingers[1].all()
    found = held.put(state)
    assert np.array_equal(found.root[0], other.root[0])
    assert np.array_equal(found.wrist[0], other.wrist[0])
    expected = np.where(held.variables[:, 3:48].reshape(2, 5, 9), other.angles, state.angles)
    assert np.array_equal(found.angles, expected)
    part = held.select(np.array([1]))
    assert np.array_equal(part.put(state.select(np.array([1]))).angles, state.angles[1:])


def test_priors_may_be_weak() -> None:
    """What the other tests call landmarks alone still has a minimum of its own."""
    chain = chain_of()
    seen = observe(chain.pose(make_state(1, chain, seed=2)).points)
    whole = matrix_of(problem_of(chain, seen, terms=points_alone("right")).blocks(make_state(1, chain)))
    assert np.linalg.eigvalsh(whole).min() > 0.0
