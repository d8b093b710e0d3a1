"""Joint limits: how far a finger's angles lie outside their range of motion."""

from __future__ import annotations

import numpy as np

from handfit_core.common.skeleton import JOINTS_BY_FINGER, Side
from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import FINGERS, Rows
from handfit_core.hand_model.anatomy import BEND, LAST_BEND, MIDDLE_BEND, SPREAD, joint_limits
from handfit_core.hand_model.chain import Posed
from handfit_core.hand_model.files import OPEN_HAND

CLOSED_HAND_MARGIN = np.zeros((5, 9))
CLOSED_HAND_MARGIN[1:, [MIDDLE_BEND, LAST_BEND]] = np.radians([10.0, 15.0])
"""(5, 9) radians by which a closed hand bends the fingers' middle and last joints beyond their active
range"""


_PER_RADIAN = (1.0 - TERMS.bent_spread_share) / (np.pi / 2) * np.array([0.0, 1.0, 1.0, 1.0, 1.0])
"""(5,) share of a knuckle's spread that is lost per radian of bend; the thumb's first joint is no knuckle"""


class Limits:
    """The violation of joint limits: nine rows for each finger, zero inside the range, r = (a - upper) /
    sigma above it and (a - lower) / sigma below it.

    A knuckle's range of spread is scaled by 1 - (1 - bent_spread_share) * bend / 90 degrees, bend within
    0..90. All ranges are wider by `CLOSED_HAND_MARGIN`; where hands are to stay near a pose, by
    `passive_range`, or as far as that pose goes.
    """

    def __init__(self, side: Side, model: str = OPEN_HAND) -> None:
        ranges = joint_limits(side, model)
        self.lower, self.upper = (a[JOINTS_BY_FINGER - 1].reshape(5, 9) for a in (ranges.lower, ranges.upper))

    @property
    def angle_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The least and the greatest angles, (5, 9) radians each, that a solver's step may reach where no
        anchor holds the pose: the joints' limits with a margin."""
        return self.lower - TERMS.step_margin, self.upper + CLOSED_HAND_MARGIN + TERMS.step_margin

    def __call__(self, posed: Posed, seen: Observation) -> Rows:
        """Return the rows of B posed hands: nine for each finger, in sigmas."""
        anchor, sigma, below, above = seen.anchor, TERMS.limits_sigma, np.zeros(1), CLOSED_HAND_MARGIN
        if anchor is not None:
            own = np.isnan(anchor.limits_sigma)[:, None, None]
            sigma = np.where(own, TERMS.limits_sigma, anchor.limits_sigma[:, None, None])
            more = np.maximum(np.abs(self._outside(anchor.angles, below, below)), TERMS.passive_range)
            below, above = (
                np.where(own, below, more),
                np.where(own, above, np.maximum(more, CLOSED_HAND_MARGIN)),
            )
        angles = posed.state.angles
        outside = self._outside(angles, below, above)
        slope = (outside != 0.0) / sigma
        rows = Rows.zeros(FINGERS, len(angles), 9)
        np.einsum("...ii->...i", rows.jacobian)[...] = slope
        bend = angles[..., BEND]
        edge = np.where(outside[..., SPREAD] > 0, self.upper[:, SPREAD], self.lower[:, SPREAD])
        shrinks = (bend > 0.0) & (bend < np.pi / 2)
        rows.jacobian[..., SPREAD, BEND] = slope[..., SPREAD] * edge * _PER_RADIAN * shrinks
        rows.residual[...] = outside / sigma
        return rows

    def _outside(self, angles: np.ndarray, below: np.ndarray, above: np.ndarray) -> np.ndarray:
        """Return by how many radians (B, 5, 9) angles lie outside their ranges, which are widened by `below`
        and `above`."""
        left = np.ones_like(angles)
        left[..., SPREAD] -= _PER_RADIAN * np.clip(angles[..., BEND], 0.0, np.pi / 2)
        return angles - np.clip(angles, self.lower * left - below, self.upper * left + above)
