"""Levenberg-Marquardt over many problems at once, each with its own damping and its own end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from handfit_core.solvers.fast.blocks import Blocks
from handfit_core.solvers.fast.chain import Chain, State, joined

FIRST_DAMPING = 1e-3
LESS, MORE = 0.1, 10.0
"""What the damping is multiplied with after a step that helped, and one that did not"""
MOST_DAMPING = 1e6
LEAST_DAMPING = 1e-7
WORTH_PACKING = 0.85
"""Problems that have ended are dropped from the batch when no more than this part of it goes on"""

Linearise = Callable[[State, np.ndarray], Blocks]
"""(state, index) -> blocks: index (B,) tells which of all problems the state's are"""


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the solver stopped."""

    state: State
    cost: np.ndarray
    """(B,)"""
    iterations: np.ndarray
    """(B,) int: steps tried"""
    converged: np.ndarray
    """(B,) bool: the next step promised less than the tolerance, or no step could lower the cost. Not where
    the cost is not finite"""


@np.errstate(all="ignore")
def solve(
    chain: Chain,
    linearise: Linearise,
    start: State,
    *,
    max_iterations: int,
    tolerance: float,
    shared_shape: bool = False,
) -> Solution:
    """Minimise from `start`. With `shared_shape` all problems share betas and stop together.

    A problem ends when its next step promises to lower the cost by less than `tolerance` times the cost: that
    step is neither tried nor taken. One without numbers ends at once, silently.
    """
    count = len(start)
    shared = start.betas.shape[1] if shared_shape else 0
    index = np.arange(count)
    state, blocks = start, linearise(start, index)
    damping = np.full(count, FIRST_DAMPING)
    # A problem without numbers cannot be solved: it ends at once.
    active = np.isfinite(blocks.cost)
    iterations = np.zeros(count, dtype=np.int64)
    finished: list[_Finished] = []
    for _ in range(max_iterations):
        step = blocks.step(damping, shared=shared)
        before, promised = blocks.cost, blocks.promised(*step)
        if shared:
            before, promised = np.full(count, before.sum()), np.full(count, promised.sum())
        active = active & ~(promised < tolerance * before)
        alive = np.count_nonzero(active)
        if alive == 0:
            break
        if not shared and alive <= WORTH_PACKING * len(index):
            done = ~active
            finished.append(
                _Finished(index[done], state.select(done), blocks.cost[done], iterations[done], active[done])
            )
            state, blocks, step = state.select(active), blocks.select(active), tuple(s[active] for s in step)
            index, iterations, damping = index[active], iterations[active], damping[active]
            before, active = before[active], active[active]
        candidate = chain.moved(state, *step)
        tried = linearise(candidate, index)
        after = np.full(count, tried.cost.sum()) if shared else tried.cost
        iterations += active
        # NaN, from a matrix that was not definite, is not better.
        better = (after < before) & active
        if better.all():
            state, blocks = candidate, tried
        else:
            state, blocks = candidate.where(better, state), tried.where(better, blocks)
        damping = np.clip(damping * np.where(better, LESS, MORE), LEAST_DAMPING, MOST_DAMPING)
        active = active & (damping < MOST_DAMPING)
    finished.append(_Finished(index, state, blocks.cost, iterations, active))
    return _gathered(finished)


@dataclass(frozen=True, eq=False)
class _Finished:
    """Some of the problems, where they ended."""

    index: np.ndarray
    state: State
    cost: np.ndarray
    iterations: np.ndarray
    active: np.ndarray


def _gathered(parts: list[_Finished]) -> Solution:
    """All problems in their own order."""
    order = np.argsort(np.concatenate([p.index for p in parts]))
    cost = np.concatenate([p.cost for p in parts])[order]
    active = np.concatenate([p.active for p in parts])[order]
    return Solution(
        state=joined([p.state for p in parts]).select(order),
        cost=cost,
        iterations=np.concatenate([p.iterations for p in parts])[order],
        converged=~active & np.isfinite(cost),
    )
