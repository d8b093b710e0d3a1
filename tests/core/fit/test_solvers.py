"""Solvers against one table of problems: a known hand, where to start, and what must come out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from handfit_core.common.skeleton import Side
from handfit_core.fit import levenberg
from handfit_core.fit.clips import ClipProblem, MotionPrior, smooth_clip
from handfit_core.fit.levenberg import solve
from handfit_core.fit.problem import Problem
from handfit_core.fit.solution import Solution, Status
from handfit_core.fit.start import relaxed_start
from handfit_core.fit.terms import Limits
from handfit_core.hand_model.chain import State
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


def exactly(problem: Problem, start: State) -> Solution:
    return solve(problem, start, max_iterations=60, tolerance=1e-8)


def relaxed(problem: Problem) -> State:
    side = problem.chain.model.side
    return relaxed_start(
        problem.chain, problem.seen, RELAXED if side == "right" else RELAXED * MIRROR, np.zeros(10)
    )


def test_start_of_a_single_spot() -> None:
    """A detector has put all landmarks on one pixel."""
    start = relaxed(problem_of(chain_of(), observe(np.tile([0.0, 0.0, 0.5], (1, 21, 1)))))
    assert all(np.isfinite(rows).all() for _, rows in start._rows())


def problem_for(side: Side, spread: float, count: int = 8, noise: float = 0.0) -> tuple[Problem, State]:
    """Hands of a forward pass, whose angles differ by `spread` from a relaxed hand's, and the truth."""
    chain = chain_of(side, OFFSETS)
    betas = np.broadcast_to(random(1, 10, scale=0.7), (count, 10))
    truth = replace(make_state(count, chain, seed=5, spread=spread), betas=betas)
    seen = observe(chain.points(truth), sigma=1.0, noise=noise)
    return problem_of(chain, seen, terms=points_alone(side)), truth


def as_clip(problem: Problem, start: State, truth: State) -> State:
    """One that may move as it likes, whose shape is known, and whose frames are near."""
    start = replace(exactly(problem, start).state, betas=truth.betas)
    return smooth_clip(ClipProblem(replace(problem, shape="given"), MotionPrior(1e3, 1e3)), start)


@pytest.mark.parametrize(
    "solved",
    [
        lambda problem, start, _: exactly(problem, start).state,
        lambda problem, start, _: exactly(replace(problem, shape="one"), start).state,
        as_clip,
    ],
    ids=["each by itself", "one shape", "a clip"],
)
@pytest.mark.parametrize(
    ("side", "spread", "near", "most"),
    [
        ("right", 0.25, False, 0.004),
        ("left", 0.2, True, 0.002),
    ],
)
def test_known_hands_are_recovered(
    side: Side, spread: float, near: bool, most: float, solved: Callable[..., State]
) -> None:
    """To so many metres, but for their distance, from a relaxed hand or from nearby."""
    problem, truth = problem_for(side, spread)
    shaken = truth.moved(random(8, 7, scale=0.03), random(8, 5, 9, seed=1, scale=0.1))
    start = shaken if near else relaxed(problem)
    found = solved(problem, start, truth)
    assert problem.blocks(found).cost.sum() < problem.blocks(start).cost.sum()
    aims, points = problem.chain.points(truth), problem.chain.points(found)
    scale = np.linalg.norm(aims, axis=-1).mean(axis=1) / np.linalg.norm(points, axis=-1).mean(axis=1)
    error = np.linalg.norm(points * scale[:, None, None] - aims, axis=-1).mean(axis=1)
    assert error.max() < most


def noisy(count: int = 9) -> tuple[Problem, State]:
    chain = chain_of()
    seen = observe(chain.points(make_state(count, chain, seed=5, spread=0.4)), noise=2.0)
    problem = problem_of(chain, seen)
    return problem, relaxed(problem)


def test_cost_falls_to_a_minimum() -> None:
    """A step that does not help is not taken: the cost may stay, but never rise."""
    problem, start = noisy()
    costs = np.stack([solve(problem, start, max_iterations=i, tolerance=1e-8).cost for i in range(1, 12)])
    assert (np.diff(costs, axis=0) <= 0).all()
    assert (costs[-1] < costs[0]).all()
    solution = exactly(problem, start)
    blocks = problem.blocks(solution.state)
    close(solution.cost, blocks.cost)
    assert np.abs(blocks.hand[..., -1]).max() < 1e-2 * np.abs(blocks.hand).max() ** 0.5


def test_each_problem_has_its_own_end() -> None:
    problem, start = noisy()
    whole = solve(problem, start, max_iterations=60, tolerance=1e-4)
    assert len(set(whole.iterations.tolist())) > 1
    for i in range(9):
        at = slice(i, i + 1)
        one = solve(problem.select(at), start.select(at), max_iterations=60, tolerance=1e-4)
        assert one.iterations == whole.iterations[at]
        close(one.cost, whole.cost[at], rtol=1e-6, atol=1e-9)
        close(one.state.wrist, whole.state.wrist[at], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("what", "value"), [("pixels", np.nan), ("depth", np.inf)])
def test_not_finite_problem_is_isolated(what: str, value: float) -> None:
    problem, start = noisy(4)
    expected = exactly(problem, start)
    spoiled = getattr(problem.seen, what).copy()
    spoiled[1, 3] = value
    problem = replace(problem, seen=replace(problem.seen, **{what: spoiled}))
    solution = exactly(problem, start)
    assert solution.status[1] == Status.NO_NUMBERS
    assert solution.converged.tolist() == [True, False, True, True]
    close(solution.cost[solution.converged], expected.cost[solution.converged], rtol=1e-6, atol=1e-9)
    together = exactly(replace(problem, shape="one"), start)
    assert (together.status == Status.NO_NUMBERS).all()


def test_the_status_says_why_it_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, start = noisy(3)
    short = solve(problem, start, max_iterations=2, tolerance=0.0)
    assert short.iterations.tolist() == [2, 2, 2]
    assert short.status.tolist() == [Status.ITERATIONS] * 3
    assert not short.converged.any()
    first = exactly(problem, start)
    assert first.status.tolist() == [Status.CONVERGED] * 3
    again = solve(problem, first.state, max_iterations=60, tolerance=1e-5)
    assert again.converged.all()
    assert again.iterations.max() <= 2
    # No step helps: as at a minimum that is as deep as numbers go.
    blocks = partial(Problem.blocks, problem)

    def never_better(_: Problem, state: State):
        found = blocks(state)
        return found if state is first.state else replace(found, cost=found.cost + 1e9)

    monkeypatch.setattr(levenberg, "SOLVER", replace(levenberg.SOLVER, max_damping=1e-2))
    monkeypatch.setattr(Problem, "blocks", never_better)
    stuck = solve(problem, first.state, max_iterations=60, tolerance=0.0)
    assert stuck.status.tolist() == [Status.STUCK] * 3
    assert stuck.converged.all()


def test_a_shared_shape_is_one_shape() -> None:
    problem, _ = problem_for("right", 0.15, 4, noise=1.0)
    solution = solve(replace(problem, shape="one"), relaxed(problem), max_iterations=200, tolerance=1e-4)
    assert solution.converged.all()
    assert len(set(solution.iterations.tolist())) == 1
    close(solution.state.betas, np.tile(solution.state.betas[:1], (4, 1)))
    # It explains less than each hand's own.
    assert solution.cost.sum() >= exactly(problem, relaxed(problem)).cost.sum() - 1e-6


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
    close(cut[1:], np.clip(start.angles + wild, least, most)[1:])
