"""The end of a solver's run: where it stopped, and why."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Generic, TypeVar

import numpy as np

from handfit_core.common.batch import Batch

S = TypeVar("S", bound=Batch)


class Status(IntEnum):
    """The reason why a problem's iterations ended."""

    CONVERGED = 0
    """The next step was predicted to gain almost nothing, or the last one gained almost nothing"""
    STUCK = 1
    """No step, however short, lowers the cost: this is a minimum to numerical precision"""
    ITERATIONS = 2
    """The iterations ran out while the cost still fell: allow more, or start nearer"""
    NO_NUMBERS = 3
    """The cost at the start is not finite: look for NaN or infinity in what is fitted to"""


@dataclass(frozen=True, eq=False)
class Solution(Batch, Generic[S]):
    """The states in which B problems ended, with their costs and the reasons."""

    state: S
    cost: np.ndarray
    """(B,) the cost of each problem, summed over all terms, in squared sigmas"""
    iterations: np.ndarray
    """(B,) int: how many steps were tried for each problem"""
    status: np.ndarray
    """(B,) int: why each problem ended, as values of `Status`"""

    @property
    def converged(self) -> np.ndarray:
        """(B,) bool: true for problems that ended at a minimum, to within the tolerance or numerical
        precision."""
        return self.status <= Status.STUCK
