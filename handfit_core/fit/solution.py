"""Where a solver stopped, and why."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from handfit_core.batch import Batch
from handfit_core.hand_model.chain import State


class Status(IntEnum):
    """Why a problem ended."""

    CONVERGED = 0
    """The next step promised hardly anything, or the last one hardly gained anything"""
    STUCK = 1
    """No step, however short, lowers the cost: this is a minimum as far as numbers can tell"""
    ITERATIONS = 2
    """The iterations ran out while the cost still fell: allow more, or start nearer"""
    NO_NUMBERS = 3
    """The cost at the start is no number: look for NaN or infinity in what is fitted to"""


@dataclass(frozen=True, eq=False)
class Solution(Batch):
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
