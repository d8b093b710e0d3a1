"""Where a solver stopped, and why."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Generic, TypeVar

import numpy as np

from handfit_core.common.batch import Batch

S = TypeVar("S", bound=Batch)


class Status(IntEnum):
    """Why a problem ended."""

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
    """Where B problems ended."""

    state: S
    cost: np.ndarray
    """(B,) sum over all terms, squared sigmas"""
    iterations: np.ndarray
    """(B,) int: steps tried"""
    status: np.ndarray
    """(B,) int, values of `Status`"""

    @property
    def converged(self) -> np.ndarray:
        """(B,) bool: at a minimum, to within the tolerance or numerical precision."""
        return self.status <= Status.STUCK
