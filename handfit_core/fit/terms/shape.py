"""Deviation of a hand's shape from the expected one, and of its length from a measured one."""

from __future__ import annotations

import numpy as np

from handfit_core.common.skeleton import NUM_BETAS
from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import HAND, Rows
from handfit_core.hand_model.chain import BETAS, Posed


class Shape:
    """The deviation of a hand's shape: ten rows, betas - expected, each of sigma 1; and one of the length,
    where it was measured.

    Where it was not, the ten count `shape_weight` times, except in the direction that changes the length.
    `length_rates` (10,): metres by which the length grows with each beta, in which it is almost linear; None:
    not known. `weight`: factor of the whole cost, for clips with one shape, which would otherwise count once
    a frame.
    """

    def __init__(
        self,
        expected: np.ndarray,
        length_rates: np.ndarray | None = None,
        weight: float = 1.0,
        *,
        measured: bool = True,
    ) -> None:
        self.expected = expected
        if length_rates is not None and measured:
            rows = np.concatenate([np.eye(NUM_BETAS), length_rates[None] / TERMS.length_sigma])
        else:
            rows = np.eye(NUM_BETAS) * np.sqrt(TERMS.shape_weight)
            if length_rates is not None and length_rates.any():
                size = length_rates / np.linalg.norm(length_rates)
                rows = np.concatenate([rows, np.sqrt(1.0 - TERMS.shape_weight) * size[None]])
        self._slope = rows * np.sqrt(weight)

    def __call__(self, posed: Posed, seen: Observation) -> Rows:  # noqa: ARG002 (a term)
        """Return the rows of B posed hands: ten, and one more where the hand's length was measured."""
        betas = posed.state.betas
        rows = Rows.zeros(HAND, len(betas), len(self._slope))
        rows.jacobian[:, 0, :, BETAS] = self._slope
        rows.residual[:, 0] = (betas - self.expected) @ self._slope.T
        return rows
