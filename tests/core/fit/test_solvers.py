"""Solvers against one table of problems: a known hand, where to start, and what must come out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest

from handfit_core.fit import levenberg
from handfit_core.fit.clips import smooth_clip
from handfit_core.fit.levenberg import solve
from handfit_core.fit.problem import MotionPrior, Problem
from handfit_core.fit.solution import Solution, Status
from handfit_core.fit.start import relaxed_start
from handfit_core.fit.terms import Limits
from handfit_core.hand_model.chain import State
from handfit_core.skeleton import Side
from tests.core.fit.differences import close, random
from tests.core.fit.hands import (
    MIRROR,
    OFFSETS,
    RELAXED,
    chain_of,
    make_state,
    observe,
    points_alone,
    problem_of,
)

Solve = Callable[[Problem, State], State]


@dataclass(frozen=True)
class Case:
    """Hands of a forward pass, seen exactly."""

    name: str
    side: Side
    spread: float
    """of their angles about a relaxed hand"""
    start: str
    """`relaxed`, or `near` for the truth, shaken"""
    most: float
    """metres that the worst point's hand may be off on average, but for its distance"""


CASES = [
    Case("a right hand", "right", 0.15, "relaxed", 0.002),
    Case("a left hand", "left", 0.15, "relaxed", 0.002),
    Case("bent fingers", "right", 0.25, "relaxed", 0.004),
    Case("from nearby", "left", 0.2, "near", 0.002),
]
SOLVERS: dict[str, Solve] = {
    "each by itself": lambda p, s: exactly(p, s).state,
    "one shape": lambda p, s: exactly(replace(p, shape="one"), s).state,
    "as a clip that may move as it likes": lambda p, s: smooth_clip(as_clip(p), s),
}


def exactly(problem: Problem, start: State) -> Solution:
    return solve(problem, start, max_iterations=60, tolerance=1e-8)


def as_clip(problem: Problem) -> Problem:
    return replace(problem, shape="given", motion=MotionPrior(1e3, 1e3))


def start_of(case: Case, problem: Problem, truth: State) -> State:
    if case.start == "relaxed":
        angles = RELAXED if case.side == "right" else RELAXED * MIRROR
        return relaxed_start(problem.chain, problem.seen, angles, np.zeros(10))
    count = len(truth)
    return truth.moved(random(count, 7, scale=0.03), random(count, 5, 9, seed=1, scale=0.1))


def problem_for(case: Case, count: int = 8, noise: float = 0.0) -> tuple[Problem, State]:
    chain = chain_of(case.side, OFFSETS)
    betas = np.broadcast_to(random(1, 10, scale=0.7), (count, 10))
    truth = replace(make_state(count, chain, seed=5, spread=case.spread), betas=betas)
    seen = observe(chain.pose(truth).points, sigma=1.0, noise=noise)
    return problem_of(chain, seen, terms=points_alone(case.side)), truth


def cost_of(problem: Problem, state: State) -> np.ndarray:
    return problem.blocks(state).cost


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
@pytest.mark.parametrize("solver", SOLVERS)
def test_known_hands_are_recovered(solver: str, case: Case) -> None:
    problem, truth = problem_for(case)
    start = start_of(case, problem, truth)
    if solver.startswith("as a clip"):  # whose shape is known, and whose frames are near
        start = replace(exactly(problem, start).state, betas=truth.betas)
    found = SOLVERS[solver](problem, start)
    assert cost_of(problem, found).sum() < cost_of(problem, start).sum()
    aims, points = problem.chain.pose(truth).points, problem.chain.pose(found).points
    scale = np.linalg.norm(aims, axis=-1).mean(axis=1) / np.linalg.norm(points, axis=-1).mean(axis=1)
    error = np.linalg.norm(points * scale[:, None, None] - aims, axis=-1).mean(axis=1)
    assert error.max() < case.most


def noisy(count: int = 9, spread: float = 0.4) -> tuple[Problem, State]:
    chain = chain_of()
    points = chain.pose(make_state(count, chain, seed=5, spread=spread)).points
    problem = problem_of(chain, observe(points, noise=2.0))
    return problem, relaxed_start(chain, problem.seen, RELAXED, np.zeros(10))


def test_cost_falls_with_every_iteration() -> None:
    problem, start = noisy()
    costs = np.stack([solve(problem, start, max_iterations=i, tolerance=1e-8).cost for i in range(1, 12)])
    # A step that does not help is not taken: the cost may stay, never rise; and it falls by the end.
    assert (np.diff(costs, axis=0) <= 0).all()
    assert (costs[-1] < costs[0]).all()


def test_cost_is_minimum() -> None:
    problem, start = noisy()
    solution = exactly(problem, start)
    blocks = problem.blocks(solution.state)
    close(solution.cost, blocks.cost)
    assert np.abs(blocks.hand[..., -1]).max() < 1e-2 * np.abs(blocks.hand).max() ** 0.5


def test_each_problem_has_its_own_end() -> None:
    problem, start = noisy()
    whole = solve(problem, start, max_iterations=60, tolerance=1e-4)
    assert len(set(whole.iterations.tolist())) > 1
    for i in range(9):
        index = np.array([i])
        one = solve(problem.select(index), start.select(index), max_iterations=60, tolerance=1e-4)
        assert one.iterations[0] == whole.iterations[i]
        close(one.cost[0], whole.cost[i], rtol=1e-6, atol=1e-9)
        close(one.state.wrist[0], whole.state.wrist[i], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("what", ["pixels", "depth"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_not_finite_problem_is_isolated(what: str, value: float) -> None:
    problem, start = noisy(4)
    expected = exactly(problem, start)
    spoiled = getattr(problem.seen, what).copy()
    spoiled[1, 3] = value
    problem = replace(problem, seen=replace(problem.seen, **{what: spoiled}))
    solution = exactly(problem, start)
    assert solution.status[1] == Status.NO_NUMBERS
    assert solution.converged.tolist() == [True, False, True, True]
    others = [0, 2, 3]
    close(solution.cost[others], expected.cost[others], rtol=1e-6, atol=1e-9)
    together = exactly(replace(problem, shape="one"), start)
    assert (together.status == Status.NO_NUMBERS).all()


def test_the_status_says_why_it_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, start = noisy(3)
    short = solve(problem, start, max_iterations=2, tolerance=0.0)
    assert short.iterations.tolist() == [2, 2, 2]
    assert (short.status == Status.ITERATIONS).all()
    assert not short.converged.any()
    first = exactly(problem, start)
    assert (first.status == Status.CONVERGED).all()
    again = solve(problem, first.state, max_iterations=60, tolerance=1e-5)
    assert again.converged.all()
    assert again.iterations.max() <= 2
    close(again.cost, first.cost, rtol=1e-4, atol=0)
    # No step helps: as at a minimum that is as deep as numbers go.
    monkeypatch.setattr(levenberg, "SOLVER", replace(levenberg.SOLVER, max_damping=1e-2))
    blocks = partial(Problem.blocks, problem)

    def never_better(_problem: Problem, state: State):
        found = blocks(state)
        return replace(found, cost=np.full_like(found.cost, found.cost[0] if state is first.state else 1e9))

    monkeypatch.setattr(Problem, "blocks", never_better)
    stuck = solve(problem, first.state, max_iterations=60, tolerance=0.0)
    assert (stuck.status == Status.STUCK).all()
    assert stuck.converged.all()


def test_a_shared_shape_is_one_shape() -> None:
    problem, truth = problem_for(CASES[0], 4, noise=1.0)
    start = start_of(CASES[0], problem, truth)
    solution = solve(replace(problem, shape="one"), start, max_iterations=200, tolerance=1e-4)
    assert solution.converged.all()
    assert len(set(solution.iterations.tolist())) == 1
    close(solution.state.betas, np.broadcast_to(solution.state.betas[:1], (4, 10)))
    # One shape for all explains less than each hand's own.
    assert solution.cost.sum() >= exactly(problem, start).cost.sum() - 1e-6


def test_steps_stay_in_angle_bounds() -> None:
    """Where they began beyond, they go no farther; the cost falls all the same."""
    problem, start = noisy(6)
    least, most = Limits("right").angle_bounds
    start = replace(start, angles=start.angles.copy())
    start.angles[0, 2, 5] = most[2, 5] + 0.5
    bounded = replace(problem, angle_bounds=(least, most))
    found = exactly(bounded, start)
    assert (found.state.angles <= np.maximum(most, start.angles) + 1e-9).all()
    assert (found.state.angles >= np.minimum(least, start.angles) - 1e-9).all()
    assert found.converged.all()
    wild = random(6, 5, 9, scale=10.0)
    cut = start.angles + bounded.clip_to_bounds(start, wild)
    assert (np.abs(cut - np.clip(start.angles + wild, least, most))[1:] < 1e-12).all()
    assert problem.clip_to_bounds(start, wild) is wild
