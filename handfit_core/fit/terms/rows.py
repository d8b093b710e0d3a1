"""What terms give to the solver: residuals with their derivatives, and how large residuals count."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.hand_model.chain import HAND_SIZE, Posed

Group = Literal["points", "fingers", "hand"]

POINTS: Group = "points"
"""21 of them: derivatives by the point's place (3), metres, camera frame, and by where depth is zero (1)"""
FINGERS: Group = "fingers"
"""5 of them, as in `skeleton.FINGERS`: derivatives by the finger's nine angles, radians"""
HAND: Group = "hand"
"""One: derivatives by its own 17 variables, as `hand_model.chain` orders them"""

SIZES: dict[Group, tuple[int, int]] = {POINTS: (21, 4), FINGERS: (5, 9), HAND: (1, HAND_SIZE)}
"""How many there are, and of how many derivatives"""


@dataclass(frozen=True, eq=False)
class Rows:
    """c residuals of each point, finger or hand, for B hands, in sigmas."""

    of: Group
    columns: np.ndarray
    """(B, count, c, derivatives + 1), the residual last"""
    certain: np.ndarray | None = None
    """(B, count) bool: residuals that count with their square, however large. Others do so up to one sigma,
    and linearly beyond (Huber's kernel with delta 1, on the norm of a point's rows); None: all are certain"""

    @classmethod
    def zeros(cls, of: Group, batch: int, count: int) -> Rows:
        """`count` rows of nothing for each point, finger or hand."""
        groups, derivatives = SIZES[of]
        return cls(of, np.zeros((batch, groups, count, derivatives + 1)))

    @property
    def residual(self) -> np.ndarray:
        """(B, count, c), a view."""
        return self.columns[..., -1]

    @property
    def jacobian(self) -> np.ndarray:
        """(B, count, c, derivatives), a view."""
        return self.columns[..., :-1]

    def weighted(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns to be squared, and the cost (B,): with an iteratively re-weighted kernel rho of a squared
        residual s, rows are multiplied with the root of rho'(s)."""
        squared = np.square(self.residual).sum(axis=2)
        if self.certain is None:
            return self.columns, squared.sum(axis=1)
        root = np.sqrt(squared)
        beyond = np.maximum(root, 1.0)
        beyond[self.certain] = 1.0
        cost = np.where(beyond > 1.0, 2.0 * root - 1.0, squared).sum(axis=1)
        return self.columns * np.sqrt(1.0 / beyond)[..., None, None], cost


class Term(Protocol):
    """One thing that hands are judged by."""

    def __call__(self, posed: Posed, seen: Observation) -> Rows:
        """The rows of B posed hands, of which `seen` tells."""
        ...
