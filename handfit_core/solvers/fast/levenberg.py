"""Levenberg-Marquardt over many problems at once, each with its own damping and its own end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from handfit_core.solvers.fast.blocks import Blocks
from handfit_core.solvers.fast.chain import Chain, State

FIRST_DAMPING = 1e-3
LESS, MORE = 0.1, 10.0
"""What the damping is multiplied with after a step that helped, and one that did not"""
MOST_DAMPING = 1e6
LEAST_DAMPING = 1e-7

Linearise = Callable[[State, torch.Tensor], Blocks]
"""(state, index) -> blocks: index (B,) tells which of all problems the state's are"""


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the solver stopped."""

    state: State
    cost: torch.Tensor
    """(B,)"""
    iterations: torch.Tensor
    """(B,) int: steps tried"""
    converged: torch.Tensor
    """(B,) bool: the last step changed the cost by less than the tolerance, or no step could lower it"""


def solve(
    chain: Chain,
    linearise: Linearise,
    start: State,
    *,
    max_iterations: int,
    tolerance: float,
    shared_shape: bool = False,
) -> Solution:
    """Minimise from `start`. With `shared_shape` all problems share betas and stop together."""
    count, device = len(start), start.root.device
    index = torch.arange(count, device=device)
    state, blocks = start, linearise(start, index)
    damping = torch.full((count,), FIRST_DAMPING, dtype=blocks.cost.dtype, device=device)
    active = blocks.cost.isfinite()
    iterations = torch.zeros(count, dtype=torch.long, device=device)
    finished: list[tuple[torch.Tensor, State, torch.Tensor, torch.Tensor, torch.Tensor]] = []
    for _ in range(max_iterations):
        step = blocks.step(damping, shared=start.betas.shape[1] if shared_shape else 0)
        candidate = chain.moved(state, *step)
        tried = linearise(candidate, index)
        before, after = blocks.cost, tried.cost
        if shared_shape:
            before, after = before.sum().expand(count), after.sum().expand(count)
        # NaN, from a matrix that was not definite, is not better.
        better = (after < before) & active
        gain = (before - after) / before.clamp_min(1e-12)
        iterations += active
        state, blocks = candidate.where(better, state), tried.where(better, blocks)
        damping = torch.where(better, damping * LESS, damping * MORE).clamp(LEAST_DAMPING, MOST_DAMPING)
        active = active & ~(better & (gain < tolerance)) & (damping < MOST_DAMPING)
        alive = int(active.sum())
        if alive == 0:
            break
        if not shared_shape and alive <= len(index) // 2:
            done = ~active
            finished.append(
                (index[done], state.select(done), blocks.cost[done], iterations[done], active[done])
            )
            state, blocks, damping = state.select(active), blocks.select(active), damping[active]
            index, iterations, active = index[active], iterations[active], active[active]
    finished.append((index, state, blocks.cost, iterations, active))
    if len(finished) == 1:
        return Solution(state, blocks.cost, iterations, ~active)
    order = torch.argsort(torch.cat([part[0] for part in finished]))
    whole = State(
        *(
            torch.cat([getattr(part[1], name) for part in finished])[order]
            for name in State.__dataclass_fields__
        )
    )
    cost, iterations, active = (torch.cat([part[i] for part in finished])[order] for i in (2, 3, 4))
    return Solution(whole, cost, iterations, ~active)
