"""Solvers against each other, on the same detections."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.detections import Hand
from benchmarks.interleaved import Contender, Timing, interleaved
from handfit_core.solvers import get_solver

ALONE = "fast, one frame"
ALONE_CALLS = 20
"""One frame alone is over in milliseconds: so many calls a round"""


@dataclass(frozen=True, eq=False)
class SolverTimings:
    """What every solver took, and whether the fast one did its job."""

    timings: list[Timing]
    converged: float
    """Share of the fast solver's fits that converged, over all distinct detections"""
    doubtful: float
    """... that it doubts itself"""

    def named(self, name: str) -> Timing:
        """The timing of that name."""
        return next(t for t in self.timings if t.name == name)


def time_solvers(
    hand: Hand,
    slow: Sequence[str],
    batches: Sequence[int],
    rounds: int,
    on_round: Callable[[int], None] = lambda _: None,
) -> SolverTimings:
    """Time the fast solver alone and in batches, and `slow` solvers by name, in turn.

    In one round all that take one frame take the same, and rounds take frames evenly spread over the
    clip. Batches are of independent frames, each with its own shape. Raises OptionError for a solver that
    does not exist.
    """
    from handfit_core.fit.fast import fit_frames

    frames = np.linspace(0, len(hand.detections) - 1, rounds).round().astype(int)

    def alone(solver: str) -> Callable[[int], object]:
        solve = get_solver(solver)
        return lambda number: solve(
            hand.model, hand.single(int(frames[number])), hand.intrinsics, lambda: None
        )

    def batch(size: int) -> Callable[[int], object]:
        detections = hand.batch(size)
        return lambda _: fit_frames(hand.model, detections, hand.intrinsics)

    contenders = [Contender(name, alone(name)) for name in slow]
    contenders.append(Contender(ALONE, alone("fast"), calls=ALONE_CALLS))
    contenders += [Contender(f"fast, batch of {size}", batch(size), size, _calls(size)) for size in batches]
    timings = interleaved(contenders, rounds, on_round)
    fits = fit_frames(hand.model, hand.detections, hand.intrinsics)
    return SolverTimings(timings, float(fits.converged.mean()), float(fits.doubtful.mean()))


def _calls(size: int) -> int:
    return max(1, ALONE_CALLS // size)
