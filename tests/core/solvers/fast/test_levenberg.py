"""Recovery of what a forward pass made, and each problem's own end."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from handfit_core.skeleton import SIDES, Side
from handfit_core.solvers.fast.chain import Chain, State
from handfit_core.solvers.fast.energy import Energy, Weights
from handfit_core.solvers.fast.levenberg import Solution, solve
from handfit_core.solvers.fast.observation import Observation
from handfit_core.solvers.fast.start import relaxed_start
from tests.core.residuals.differences import random
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
    sign = torch.tensor([-1.0, -1.0, 1.0] * 3) if chain.model.side == "left" else torch.ones(9)
    angles = (torch.tensor(RELAXED) * sign).expand(batch, 5, 9).contiguous()
    start = start or relaxed_start(chain, seen, angles, torch.zeros(batch, 10, dtype=chain.dtype))

    def linearise(state: State, index: torch.Tensor):
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
    scale = points.norm(dim=-1).mean(dim=1) / found.norm(dim=-1).mean(dim=1)
    error = (found * scale[:, None, None] - points).norm(dim=-1).mean(dim=1)
    assert float(error.max()) < 0.002


def test_cost_falls_with_every_iteration() -> None:
    chain = chain_of()
    energy = energy_of(chain)
    seen = observe(chain.pose(make_state(4, chain, seed=3, spread=0.4)).points, noise=3.0)
    costs = torch.stack([fit(chain, energy, seen, max_iterations=i).cost for i in range(1, 12)])
    # A step that does not help is not taken: the cost may stay, never rise; and it falls by the end.
    assert (costs.diff(dim=0) <= 0).all()
    assert (costs[-1] < costs[0]).all()


def test_cost_is_that_of_the_state() -> None:
    chain = chain_of()
    energy = energy_of(chain)
    seen = observe(chain.pose(make_state(5, chain, seed=3)).points, noise=3.0)
    solution = fit(chain, energy, seen)
    again = energy.of(chain.pose(solution.state), seen, shape=True)
    torch.testing.assert_close(solution.cost, again.cost)
    assert float(again.hand_gradient.abs().max()) < 1e-2 * float(again.hand.abs().max()) ** 0.5


def test_batch_equals_loop_each_with_its_own_end() -> None:
    chain = chain_of()
    energy = energy_of(chain)
    points = chain.pose(make_state(9, chain, seed=5, spread=0.4)).points
    seen = observe(points, noise=2.0)
    whole = fit(chain, energy, seen, tolerance=1e-4)
    assert len(set(whole.iterations.tolist())) > 1
    for i in range(9):
        one = fit(chain, energy, seen.select(torch.tensor([i])), tolerance=1e-4)
        assert int(one.iterations) == int(whole.iterations[i])
        torch.testing.assert_close(one.cost[0], whole.cost[i], rtol=1e-6, atol=1e-9)
        torch.testing.assert_close(one.state.wrist[0], whole.state.wrist[i], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("what", ["pixels", "depth"])
@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_a_problem_without_numbers_harms_no_other(what: str, value: float) -> None:
    chain = chain_of()
    energy = energy_of(chain)
    seen = observe(chain.pose(make_state(4, chain, seed=5)).points, noise=2.0)
    expected = fit(chain, energy, seen)
    spoiled = getattr(seen, what).clone()
    spoiled[1, 3] = value
    solution = fit(chain, energy, replace(seen, **{what: spoiled}))
    assert solution.converged.tolist() == [True, False, True, True]
    others = [0, 2, 3]
    torch.testing.assert_close(solution.cost[others], expected.cost[others], rtol=1e-6, atol=1e-9)


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
    torch.testing.assert_close(again.cost, first.cost, rtol=1e-4, atol=0)


def test_a_shared_shape_is_one_shape() -> None:
    chain = chain_of()
    betas = random(1, 10, scale=0.7).expand(4, 10)
    truth = replace(make_state(4, chain, seed=5), betas=betas)
    seen = observe(chain.pose(truth).points, noise=1.0)
    solution = fit(chain, energy_of(chain), seen, shared_shape=True)
    assert solution.converged.all()
    assert len(set(solution.iterations.tolist())) == 1
    torch.testing.assert_close(solution.state.betas, solution.state.betas[:1].expand(4, 10))
    # One shape for all explains less than each hand's own.
    assert float(solution.cost.sum()) >= float(fit(chain, energy_of(chain), seen).cost.sum()) - 1e-6


def test_single_precision_finds_the_same() -> None:
    chain = chain_of()
    truth = make_state(6, chain, seed=5)
    points = chain.pose(truth).points
    double = fit(chain, energy_of(chain), observe(points, noise=2.0), tolerance=1e-5)
    single_chain = Chain(chain.model, chain_landmarks(), torch.float32)
    seen = observe(points, noise=2.0)
    single_seen = Observation(
        *(
            getattr(seen, n).float()
            for n in ("pixels", "pixel_sigma", "depth", "depth_sigma", "ray", "focal", "centre")
        )
    )
    angles = torch.tensor(RELAXED, dtype=torch.float32).expand(6, 5, 9).contiguous()
    start = relaxed_start(single_chain, single_seen, angles, torch.zeros(6, 10))
    single = fit(single_chain, energy_of(single_chain), single_seen, tolerance=1e-5, start=start)
    torch.testing.assert_close(single.cost.double(), double.cost, rtol=2e-3, atol=1e-3)


def chain_landmarks():
    from handfit_core.hand_model.landmarks import NO_OFFSETS

    return NO_OFFSETS
