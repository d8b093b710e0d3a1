"""Levenberg-Marquardt over many problems at once, each with its own damping and its own end."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.problem import Problem
from handfit_core.fit.solution import Solution, Status
from handfit_core.hand_model.chain import State

FIRST_DAMPING = 1e-3
LESS, MORE = 0.1, 10.0
"""What the damping is multiplied with after a step that kept its promise, and after one that did not help. In
between it changes as the gain does (Nielsen, "Damping parameter in Marquardt's method", 1999)"""
HARDLY = 0.1
"""of the tolerance: a step that gained less than this was the last. In a bent valley steps promise more than
they keep, again and again."""
MOST_DAMPING = 1e6
LEAST_DAMPING = 1e-7
WORTH_PACKING = 0.85
"""Problems that have ended are dropped from the batch when no more than this part of it goes on"""

_GOES_ON = -1


@np.errstate(all="ignore")
def solve(problem: Problem, start: State, *, max_iterations: int, tolerance: float) -> Solution:
    """Minimise from `start`. Where all have one shape, all stop together.

    A problem ends when its next step promises to lower the cost by less than `tolerance` times the cost: that
    step is neither tried nor taken. It also ends after a step that hardly gained anything. One without
    numbers ends at once, silently.
    """
    together = problem.shape == "one"
    blocks, state, index = problem.blocks(start), start, np.arange(len(start))
    damping = np.full(len(start), FIRST_DAMPING)
    iterations = np.zeros(len(start), dtype=np.int64)
    status = np.where(np.isfinite(blocks.cost), _GOES_ON, Status.NO_NUMBERS)
    if together and (status == Status.NO_NUMBERS).any():
        return Solution(start, blocks.cost, iterations, np.full(len(start), Status.NO_NUMBERS))
    finished: list[tuple[np.ndarray, Solution]] = []

    def pack(left: np.ndarray) -> None:
        """Go on with the problems that are left (B,) bool; the others are done."""
        nonlocal problem, blocks, state, index, damping, iterations, status
        done = ~left
        solution = Solution(state.select(done), blocks.cost[done], iterations[done], status[done])
        finished.append((index[done], solution))
        problem, blocks, state, index = (
            problem.select(left), blocks.select(left), state.select(left), index[left],
        )  # fmt: skip
        damping, iterations, status = damping[left], iterations[left], status[left]

    if (status != _GOES_ON).any():
        pack(status == _GOES_ON)
    for _ in range(max_iterations):
        of_hand, of_fingers = blocks.step(damping, shared_shape=together)
        step = of_hand, problem.within_reach(state, of_fingers)
        before, promised = blocks.cost, blocks.promised(*step)
        if together:
            before, promised = np.full_like(before, before.sum()), np.full_like(before, promised.sum())
        status[(status == _GOES_ON) & (promised < tolerance * before)] = Status.CONVERGED
        active = status == _GOES_ON
        alive = np.count_nonzero(active)
        if alive == 0:
            break
        if alive <= WORTH_PACKING * len(index):
            step, before, promised = (step[0][active], step[1][active]), before[active], promised[active]
            pack(active)
            active = np.ones(alive, dtype=bool)
        candidate = state.moved(*step)
        tried = problem.blocks(candidate)
        after = np.full_like(before, tried.cost.sum()) if together else tried.cost
        iterations += active
        # NaN is not better.
        better = (after < before) & active
        if not better.all():
            candidate = candidate.where(better, state)
            tried.put(~better, blocks)
        state, blocks = candidate, tried
        # Continuous in how much of its promise a step has kept, so that nearly equal problems stay so.
        kept = np.clip((before - after) / promised, 0.0, 1.0)
        less = np.maximum(1.0 - (2.0 * kept - 1.0) ** 3, LESS)
        damping = np.clip(damping * np.where(better, less, MORE), LEAST_DAMPING, MOST_DAMPING)
        status[active & (damping >= MOST_DAMPING)] = Status.STUCK
        status[better & (before - after < HARDLY * tolerance * before)] = Status.CONVERGED
    status[status == _GOES_ON] = Status.ITERATIONS
    finished.append((index, Solution(state, blocks.cost, iterations, status)))
    order = np.argsort(np.concatenate([rows for rows, _ in finished]))
    return Solution.joined([part for _, part in finished]).select(order)
