"""Levenberg-Marquardt over a batch of problems, each with its own damping and its own end."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.problem import Problem
from handfit_core.fit.settings import SOLVER
from handfit_core.fit.solution import Solution, Status
from handfit_core.hand_model.chain import State

_RUNNING = -1


@np.errstate(all="ignore")
def solve(problem: Problem, start: State, *, max_iterations: int, tolerance: float) -> Solution:
    """Minimise the cost of B problems from `start` (B). Where all hands have one shape, all stop together.

    A problem ends when its next step is predicted to decrease the cost by less than `tolerance` times the
    cost; that step is not tried. It also ends after a step that gained almost nothing. A problem whose cost
    is not finite at the start ends at once, with the status `NO_NUMBERS`.
    """
    together = problem.shape == "one"
    blocks, state, index = problem.blocks(start), start, np.arange(len(start))
    damping = np.full(len(start), SOLVER.first_damping)
    iterations = np.zeros(len(start), dtype=np.int64)
    status = np.where(np.isfinite(blocks.cost), _RUNNING, Status.NO_NUMBERS)
    if together and (status == Status.NO_NUMBERS).any():
        return Solution(start, blocks.cost, iterations, np.full(len(start), Status.NO_NUMBERS))
    finished: list[tuple[np.ndarray, Solution]] = []

    def pack(left: np.ndarray) -> None:
        """Store the finished problems, and continue with those that are `left` (B,) bool."""
        nonlocal problem, blocks, state, index, damping, iterations, status
        done = ~left
        solution = Solution(state.select(done), blocks.cost[done], iterations[done], status[done])
        finished.append((index[done], solution))
        problem, blocks, state, index = (
            problem.select(left), blocks.select(left), state.select(left), index[left],
        )  # fmt: skip
        damping, iterations, status = damping[left], iterations[left], status[left]

    if (status != _RUNNING).any():
        pack(status == _RUNNING)
    for _ in range(max_iterations):
        of_hand, of_fingers = blocks.step(damping, shared_shape=together)
        step = of_hand, problem.clip_to_bounds(state, of_fingers)
        before, predicted_decrease = blocks.cost, blocks.predicted_decrease(*step)
        if together:
            before, predicted_decrease = (
                np.full_like(before, before.sum()),
                np.full_like(before, predicted_decrease.sum()),
            )
        status[(status == _RUNNING) & (predicted_decrease < tolerance * before)] = Status.CONVERGED
        active = status == _RUNNING
        alive = np.count_nonzero(active)
        if alive == 0:
            break
        if alive <= SOLVER.pack_below_share * len(index):
            step, before, predicted_decrease = (
                (step[0][active], step[1][active]),
                before[active],
                predicted_decrease[active],
            )
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
        # Continuous in the gain ratio, so that nearly equal problems stay so.
        gain_ratio = np.clip((before - after) / predicted_decrease, 0.0, 1.0)
        less = np.maximum(1.0 - (2.0 * gain_ratio - 1.0) ** 3, SOLVER.damping_decrease)
        damping = np.clip(
            damping * np.where(better, less, SOLVER.damping_increase), SOLVER.min_damping, SOLVER.max_damping
        )
        status[active & (damping >= SOLVER.max_damping)] = Status.STUCK
        status[better & (before - after < SOLVER.min_gain_of_tolerance * tolerance * before)] = (
            Status.CONVERGED
        )
    status[status == _RUNNING] = Status.ITERATIONS
    finished.append((index, Solution(state, blocks.cost, iterations, status)))
    order = np.argsort(np.concatenate([rows for rows, _ in finished]))
    return Solution.concatenate([solution for _, solution in finished]).select(order)
