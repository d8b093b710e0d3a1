"""Recovery of what a forward pass made, and each problem's own end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.skeleton import SIDES, Side
from handfit_core.solvers.fast.chain import Chain, State
from handfit_core.solvers.fast.energy import Energy, Weights
from handfit_core.solvers.fast.levenberg import Solution, solve
from handfit_core.solvers.fast.observation import Observation
from handfit_core.solvers.fast.start import relaxed_start
from tests.core.residuals.differences import close, random
from tests.core.solvers.fast.hands import RELAXED, chain_of, energy_of, make_state, observe

POINTS_ONLY = Weights(prior=0.05, coupling_sigma=10.0, shape_sigma=20.0)
"""Priors so weak that the landmarks decide"""


def fit(
    chain: Chain,
    energy: Energy,
    seen: Observation,
    *,
    max_iterations: int = 60,
    tolerance: float = 1e-8,
    start: State | None = None,
    shared_shape: bool = False,
) -> Solution:
    batch = len(seen)
    sign = np.array([-1.0, -1.0, 1.0] * 3) if chain.model.side == "left" else np.ones(9)
    angles = np.broadcast_to(RELAXED * sign, (batch, 5, 9))
    start = start or relaxed_start(chain, seen, angles, np.zeros((batch, 10)))

    def linearise(state: State, index: np.ndarray):
        return energy.of(chain.pose(state), seen.select(index), shape=True)

    return solve(
        chain, linearise, start, max_iterations=max_iterations, tolerance=tolerance, shared_shape=shared_shape
    )


@pytest.mark.parametrize("side", SIDES)
def test_recovers_hands_of_a_forward_pass(side: Side) -> None:
    """Exact landmarks, ever-present priors: the worst of 12 hands within 2 mm after removing its distance."""
    chain = chain_of(side)
    truth = make_state(12, chain)
    points = chain.pose(truth).points
    solution = fit(chain, energy_of(chain, POINTS_ONLY), observe(points, sigma=1.0))
    assert solution.converged.all()
    found = chain.pose(solution.state).points
    scale = np.linalg.norm(points, axis=-1).mean(axis=1) / np.linalg.norm(found, axis=-1).mean(axis=1)
    error = np.linalg.norm(found * scale[:, None, None] - points, axis=-1).mean(axis=1)
    assert float(error.max()) < 0.002


def test_cost_falls_with_every_iteration() -> None:
    chain = chain_of()
    energy = energy_of(chain)
    seen = observe(chain.pose(make_state(4, chain, seed=3, spread=0.4)).points, noise=3.0)
    costs = np.stack([fit(chain, energy, seen, max_iterations=i).cost for i in range(1, 12)])
    # A step that does not help is not taken: the cost may stay, never rise; and it falls by the end.
    assert (np.diff(costs, axis=0) <= 0).all()
    assert (costs[-1] < costs[0]).all()


def test_cost_is_that_of_the_state() -> None:
    chain = chain_of()
    energy = energy_of(chain)
    seen = observe(chain.pose(make_state(5, chain, seed=3)).points, noise=3.0)
    solution = fit(chain, energy, seen)
    again = energy.of(chain.pose(solution.state), seen, shape=True)
    close(solution.cost, again.cost)
    assert float(np.abs(again.hand_gradient).max()) < 1e-2 * float(np.abs(again.hand).max()) ** 0.5


def test_batch_equals_loop_each_with_its_own_end() -> None:
    chain = chain_of()
    energy = energy_of(chain)
    points = chain.pose(make_state(9, chain, seed=5, spread=0.4)).points
    seen = observe(points, noise=2.0)
    whole = fit(chain, energy, seen, tolerance=1e-4)
    assert len(set(whole.iterations.tolist())) > 1
    for i in range(9):
        one = fit(chain, energy, seen.select(np.array([i])), tolerance=1e-4)
        assert one.iterations[0] == int(whole.iterations[i])
        close(one.cost[0], whole.cost[i], rtol=1e-6, atol=1e-9)
        close(one.state.wrist[0], whole.state.wrist[i], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("what", ["pixels", "depth"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_problem_without_numbers_harms_no_other(what: str, value: float) -> None:
    chain = chain_of()
    energy = energy_of(chain)
    seen = observe(chain.pose(make_state(4, chain, seed=5)).points, noise=2.0)
    expected = fit(chain, energy, seen)
    spoiled = getattr(seen, what).copy()
    spoiled[1, 3] = value
    solution = fit(chain, energy, replace(seen, **{what: spoiled}))
    assert solution.converged.tolist() == [True, False, True, True]
    others = [0, 2, 3]
    close(solution.cost[others], expected.cost[others], rtol=1e-6, atol=1e-9)


def test_max_iterations_is_respected() -> None:
    chain = chain_of()
    seen = observe(chain.pose(make_state(3, chain, seed=5, spread=0.4)).points, noise=2.0)
    solution = fit(chain, energy_of(chain), seen, max_iterations=2, tolerance=0.0)
    assert solution.iterations.tolist() == [2, 2, 2]
    assert not solution.converged.any()


def test_at_the_minimum_it_ends_at_once() -> None:
    chain = chain_of()
    energy = energy_of(chain)
    seen = observe(chain.pose(make_state(3, chain, seed=5)).points, noise=2.0)
    first = fit(chain, energy, seen)
    again = fit(chain, energy, seen, start=first.state, tolerance=1e-5)
    assert again.converged.all()
    assert int(again.iterations.max()) <= 2
    close(again.cost, first.cost, rtol=1e-4, atol=0)


def test_a_shared_shape_is_one_shape() -> None:
    chain = chain_of()
    betas = np.broadcast_to(random(1, 10, scale=0.7), (4, 10))
    truth = replace(make_state(4, chain, seed=5), betas=betas)
    seen = observe(chain.pose(truth).points, noise=1.0)
    solution = fit(chain, energy_of(chain), seen, shared_shape=True)
    assert solution.converged.all()
    assert len(set(solution.iterations.tolist())) == 1
    close(solution.state.betas, np.broadcast_to(solution.state.betas[:1], (4, 10)))
    # One shape for all explains less than each hand's own.
    assert float(solution.cost.sum()) >= float(fit(chain, energy_of(chain), seen).cost.sum()) - 1e-6
