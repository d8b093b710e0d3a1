"""Levenberg-Marquardt over a batch of problems, each of which has its own damping and ends by itself.
NumPy."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.fit.settings import SOLVER
from handfit_core.fit.solution import Solution, Status

_RUNNING = -1
S = TypeVar("S", bound=Any)
"""The type of a `Batch` of states, whose method `moved` takes the increments of a step"""


class LeastSquares(Batch):
    """B least-squares problems, be they fits of hands, of a clip's frames, of arms or of a character's
    fingers."""

    @property
    def together(self) -> bool:
        """True if the problems share variables, so that they are one problem, which stops as a whole."""
        return False

    def blocks(self, state: Any) -> Any:
        """Return the normal equations at `state`, with their `cost` (B,): a `Batch`, unless all rows are one
        problem."""
        raise NotImplementedError

    def step(self, state: Any, blocks: Any, damping: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """Return the increments that `state.moved` takes, under damping (B,) relative to the matrix
        diagonals, and by how much they decrease the costs (B,) at least if the residuals are linear."""
        raise NotImplementedError


class CoupledFrames(LeastSquares):
    """The problem of consecutive frames that their accelerations couple, so that it is one problem."""

    @property
    def together(self) -> bool:
        """True, as acceleration couples the frames."""
        return True


@np.errstate(all="ignore")
def solve(
    problem: LeastSquares,
    start: S,
    *,
    max_iterations: int,
    tolerance: float = 0.0,
    min_gain: float | None = None,
    first_damping: float | None = None,
) -> Solution[S]:
    """Minimise the cost of B problems from `start` (B). `first_damping`: None for that of the settings,
    `SOLVER`.

    A problem ends when its next step is predicted to decrease the cost by no more than `tolerance` times the
    cost; that step is not tried. It also ends after a step that decreased it by less than `min_gain` times
    the cost, None for `SOLVER.min_gain_of_tolerance` times the tolerance. A problem whose cost is not finite
    at the start ends at once, with the status `NO_NUMBERS`.
    """
    together = problem.together
    min_gain = SOLVER.min_gain_of_tolerance * tolerance if min_gain is None else min_gain
    blocks, state, index = problem.blocks(start), start, np.arange(len(start))
    damping = np.full(len(start), SOLVER.first_damping if first_damping is None else first_damping)
    iterations = np.zeros(len(start), dtype=np.int64)
    status = np.where(np.isfinite(blocks.cost), _RUNNING, Status.NO_NUMBERS)
    if together and (status == Status.NO_NUMBERS).any():
        return Solution(start, blocks.cost, iterations, np.full(len(start), Status.NO_NUMBERS))
    finished: list[tuple[np.ndarray, Solution]] = []

    def pack(left: np.ndarray) -> None:
        """Store the problems that have finished, and continue with those that `left` (B,) bool marks."""
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
        step, predicted_decrease = problem.step(state, blocks, damping)
        before = blocks.cost
        if together:
            before, predicted_decrease = (
                np.full_like(before, before.sum()),
                np.full_like(before, predicted_decrease.sum()),
            )
        status[(status == _RUNNING) & (predicted_decrease <= tolerance * before)] = Status.CONVERGED
        active = status == _RUNNING
        alive = np.count_nonzero(active)
        if alive == 0:
            break
        if alive <= SOLVER.pack_below_share * len(index):
            step = tuple(increments[active] for increments in step)
            before, predicted_decrease = before[active], predicted_decrease[active]
            pack(active)
            active = np.ones(alive, dtype=bool)
        candidate = state.moved(*step)
        tried = problem.blocks(candidate)
        after = np.full_like(before, tried.cost.sum()) if together else tried.cost
        iterations += active
        # NaN is not better.
        better = (after < before) & active
        if not better.all() and better.any():
            candidate = candidate.where(better, state)
            tried.overwrite(~better, blocks.select(~better))
        if better.any():
            state, blocks = candidate, tried
        # Continuous in the gain ratio, so that nearly equal problems stay so.
        gain_ratio = np.clip((before - after) / predicted_decrease, 0.0, 1.0)
        less = np.maximum(1.0 - (2.0 * gain_ratio - 1.0) ** 3, SOLVER.damping_decrease)
        damping = np.clip(
            damping * np.where(better, less, SOLVER.damping_increase), SOLVER.min_damping, SOLVER.max_damping
        )
        status[active & (damping >= SOLVER.max_damping)] = Status.STUCK
        status[better & (before - after < min_gain * before)] = Status.CONVERGED
    status[status == _RUNNING] = Status.ITERATIONS
    finished.append((index, Solution(state, blocks.cost, iterations, status)))
    order = np.argsort(np.concatenate([rows for rows, _ in finished]))
    return Solution.concatenate([solution for _, solution in finished]).select(order)
