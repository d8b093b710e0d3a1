"""The energy's gradient and matrices against finite differences of its cost."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

from handfit_core.hand_model.anatomy import joint_limits
from handfit_core.hand_model.length import betas_of_length, length_rates
from handfit_core.residuals.robust import Huber
from handfit_core.skeleton import SIDES, Side
from handfit_core.solvers.fast.blocks import Blocks
from handfit_core.solvers.fast.chain import Chain, State
from handfit_core.solvers.fast.energy import Energy, MeasuredHand, PosePrior, Weights
from tests.core.residuals.differences import close, of_increments
from tests.core.solvers.fast.hands import (
    OFFSETS,
    chain_of,
    energy_of,
    make_state,
    observe,
    prior_about_relaxed,
    repeated,
)


def gradients_of(blocks: Blocks) -> np.ndarray:
    """(B, n + 45)"""
    return np.concatenate([blocks.hand_gradient, blocks.finger_gradient.reshape(-1, 45)], axis=1)


def moved_by(chain: Chain, state: State, increments: np.ndarray, n: int) -> State:
    """The first hand by each of the increments (B, n + 45)."""
    states = repeated(state, len(increments))
    return chain.moved(states, increments[:, :n], increments[:, n:].reshape(-1, 5, 9))


def matrix_of(blocks: Blocks) -> np.ndarray:
    """(n + 45, n + 45) of the first problem."""
    n = blocks.hand.shape[-1]
    whole = np.zeros((n + 45, n + 45))
    whole[:n, :n] = blocks.hand[0]
    mixed = blocks.mixed[0].reshape(45, n)
    whole[n:, :n], whole[:n, n:] = mixed, mixed.T
    whole[n:, n:] = block_diag(*blocks.finger[0])
    return whole


CASES = [
    pytest.param(Weights(tips=0.5, reprojection=2.0), 0.5, id="quadratic"),
    pytest.param(Weights(pixel_kernel=Huber(0.05), depth_kernel=Huber(0.02)), 20.0, id="Huber"),
    pytest.param(Weights(depth=0.3, prior=0.2, shape_sigma=2.0), 3.0, id="weighted"),
]


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("shape", [False, True])
@pytest.mark.parametrize(("weights", "noise"), CASES)
def test_gradient_is_that_of_the_cost(weights: Weights, noise: float, shape: bool, side: Side) -> None:
    """cost = sum of squares, gradient = J^T r: half of its derivative."""
    chain = chain_of(side, OFFSETS)
    energy = energy_of(chain, weights)
    state, truth = make_state(1, chain, seed=1), make_state(1, chain, seed=1, spread=0.2)
    seen = observe(chain.pose(truth).points, noise=noise)
    _check_gradient(chain, energy, state, seen, shape)


@pytest.mark.parametrize("shape", [False, True])
def test_gradient_with_world_landmarks(shape: bool) -> None:
    chain = chain_of("right", OFFSETS)
    energy = energy_of(chain, Weights(world=0.7, depth_kernel=Huber(1e3)))
    state = make_state(1, chain, seed=1, offsets=4)
    seen = observe(chain.pose(make_state(1, chain, seed=1, spread=0.2)).points, noise=1.0, world=True)
    _check_gradient(chain, energy, state, seen, shape)


def test_gradient_with_a_measured_length() -> None:
    chain = chain_of("right", OFFSETS)
    betas = betas_of_length(chain.model, 0.17)
    measured = MeasuredHand(betas, length_rates(chain.model, betas))
    energy = Energy(chain, prior_about_relaxed(), joint_limits("right"), Weights(), measured)
    state = make_state(1, chain, seed=1)
    seen = observe(chain.pose(make_state(1, chain, seed=1, spread=0.2)).points, noise=1.0)
    _check_gradient(chain, energy, state, seen, shape=True)


def _check_gradient(chain, energy, state: State, seen, shape: bool) -> None:
    n = 6 + state.offsets.shape[1] + (10 if shape else 0)
    weight = 0.25

    def cost(increments: np.ndarray) -> np.ndarray:
        moved = moved_by(chain, state, increments, n)
        all_seen = seen.select(np.zeros(len(increments), dtype=int))
        return energy.of(chain.pose(moved), all_seen, shape=shape, shape_weight=weight).cost

    blocks = energy.of(chain.pose(state), seen, shape=shape, shape_weight=weight)
    differences = of_increments(cost, n + 45)
    found = 2 * gradients_of(blocks)[0]
    assert blocks.hand_gradient.shape == (1, n)
    assert float(np.abs(found - differences).max() / np.abs(differences).max()) < 1e-6


def test_matrices_are_half_the_hessian_at_zero_residual() -> None:
    """Where points fit exactly and only they count, Gauss-Newton's matrix is the Hessian."""
    chain = chain_of("right", OFFSETS)
    weights = Weights(prior=1e-12, coupling_sigma=1e6, limits_sigma=1e6, shape_sigma=1e6)
    energy, state = energy_of(chain, weights), make_state(1, chain)
    points = chain.pose(state).points
    seen = observe(points)
    along = (points @ seen.ray[..., None]).squeeze(-1)
    state = State(state.root, state.local, state.wrist, state.betas, along.mean(axis=1, keepdims=True))
    n = 17

    def gradient(increments: np.ndarray) -> np.ndarray:
        moved = moved_by(chain, state, increments, n)
        all_seen = seen.select(np.zeros(len(increments), dtype=int))
        return gradients_of(energy.of(chain.pose(moved), all_seen, shape=True))

    blocks = energy.of(chain.pose(state), seen, shape=True)
    assert blocks.cost[0] < 1e-9
    hessian = of_increments(gradient, n + 45)
    found, size = matrix_of(blocks), np.abs(hessian).max()
    assert float(np.abs(found - hessian).max() / size) < 1e-6


def test_matrices_are_symmetric_and_not_negative() -> None:
    chain = chain_of()
    seen = observe(chain.pose(make_state(3, chain, seed=2)).points, noise=5.0)
    blocks = energy_of(chain).of(chain.pose(make_state(3, chain)), seen, shape=True)
    whole = matrix_of(blocks)
    close(whole, whole.T)
    assert np.linalg.eigvalsh(whole).min() > -1e-9 * np.abs(whole).max()


def test_batch_equals_loop() -> None:
    chain = chain_of("left")
    energy = energy_of(chain)
    state = make_state(4, chain)
    seen = observe(chain.pose(make_state(4, chain, seed=1)).points)
    whole = energy.of(chain.pose(state), seen, shape=True)
    for i in range(4):
        index = np.array([i])
        one = energy.of(chain.pose(state.select(index)), seen.select(index), shape=True)
        for name in Blocks.__dataclass_fields__:
            close(getattr(whole, name)[i], getattr(one, name)[0], rtol=1e-9, atol=1e-7)


def test_observation_select_keeps_what_is_absent() -> None:
    chain = chain_of()
    points = chain.pose(make_state(3, chain)).points
    some = observe(points, world=True).select(np.array([2, 0]))
    assert len(some) == 2
    assert some.world is not None
    assert some.world.shape == (2, 21, 3)
    assert np.array_equal(some.pixels[1], observe(points).pixels[0])
    assert observe(points).select(np.array([1])).world is None


def test_prior_of_a_left_hand_is_mirrored() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(5, 9, 9))
    prior = PosePrior(rng.normal(size=(5, 9)), root @ np.swapaxes(root, 1, 2))
    left = prior.of_side("left")
    sign = np.array([-1, -1, 1] * 3)
    angles = rng.normal(size=(5, 9))
    for f in range(5):
        here = angles[f] - prior.mean[f]
        there = angles[f] * sign - left.mean[f]
        distance = here @ np.linalg.solve(prior.covariance[f], here)
        assert there @ np.linalg.solve(left.covariance[f], there) == pytest.approx(distance)
    assert prior.of_side("right") is prior
    assert prior_about_relaxed().of_side("left").covariance.shape == (5, 9, 9)
