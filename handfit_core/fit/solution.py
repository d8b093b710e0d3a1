"""Where a solver stopped, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from handfit_core.hand_model.chain import Index, State, joined


class Status(IntEnum):
    """Why a problem ended."""

    CONVERGED = 0
    STUCK = 1
    ITERATIONS = 2
    NO_NUMBERS = 3

    @property
    def words(self) -> str:
        """What that means, and what helps."""
        return _WORDS[self]


_WORDS = {
    Status.CONVERGED: "the next step promised hardly anything, or the last one hardly gained anything",
    Status.STUCK: "no step, however short, lowers the cost: this is a minimum as far as numbers can tell",
    Status.ITERATIONS: "the iterations ran out while the cost still fell; allow more, or start nearer",
    Status.NO_NUMBERS: "the cost at the start is no number: look for NaN or infinity in what is fitted to",
}


@dataclass(frozen=True, eq=False)
class Solution:
    """Where B problems ended."""

    state: State
    cost: np.ndarray
    """(B,) of all terms, in squared sigmas"""
    iterations: np.ndarray
    """(B,) int: steps tried"""
    status: np.ndarray
    """(B,) int, as `Status` numbers them"""

    @property
    def converged(self) -> np.ndarray:
        """(B,) bool: at a minimum, as far as the tolerance or numbers can tell."""
        return self.status <= Status.STUCK

    def select(self, index: Index) -> Solution:
        """The problems of that index."""
        state = self.state.select(index)
        return Solution(state, self.cost[index], self.iterations[index], self.status[index])

    @classmethod
    def of(cls, parts: Sequence[Solution]) -> Solution:
        """Those of all parts, one after the other."""
        names = ("cost", "iterations", "status")
        arrays = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
        return cls(joined([p.state for p in parts]), **arrays)
