"""Joint limits: how far a finger's angles lie outside their range of motion."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.terms.rows import FINGERS, Rows
from handfit_core.hand_model.anatomy import BEND, LAST_BEND, MIDDLE_BEND, SPREAD, joint_limits
from handfit_core.hand_model.chain import Posed
from handfit_core.hand_model.files import OPEN_HAND
from handfit_core.skeleton import JOINTS_BY_FINGER, Side

CLOSED_HAND_MARGIN = np.zeros((5, 9))
CLOSED_HAND_MARGIN[1:, [MIDDLE_BEND, LAST_BEND]] = np.radians([10.0, 15.0])
"""(5, 9) radians by which a closed hand bends the fingers' middle and last joints beyond their active
range"""
BENT_SPREAD_SHARE = 0.3
"""Share of a knuckle's spread that is left when it is bent by 90 degrees: collateral ligaments tighten"""
SIGMA = float(np.radians(1.0))
"""radians beyond the range that cost as much as one sigma"""
PASSIVE_RANGE = float(np.radians(10.0))
"""radians beyond the active range of motion to which a joint of a pose that is corrected may be drawn: a
finger that is pressed goes further than it does by itself. Without this, a drag would move the palm where a
person would only bend the finger"""

STEP_MARGIN = float(np.radians(3.0))
"""radians beyond the range to which a solver's step may lead: no observation brings a joint back from farther
out"""

_PER_RADIAN = (1.0 - BENT_SPREAD_SHARE) / (np.pi / 2) * np.array([0.0, 1.0, 1.0, 1.0, 1.0])
"""(5,) share of a knuckle's spread that is lost per radian of bend; the thumb's first joint is no knuckle"""


class Limits:
    """Nine rows for each finger, zero inside the range: r = (a - upper) / sigma above, (a - lower) / sigma
    below.

    A knuckle's range of spread is scaled by 1 - (1 - BENT_SPREAD_SHARE) * bend / 90 degrees, bend within
    0..90. All ranges are wider by `CLOSED_HAND_MARGIN`; where hands are to stay near a pose, by
    `PASSIVE_RANGE`, or as far as that pose goes.
    """

    def __init__(self, side: Side, model: str = OPEN_HAND) -> None:
        ranges = joint_limits(side, model)
        self.lower, self.upper = (a[JOINTS_BY_FINGER - 1].reshape(5, 9) for a in (ranges.lower, ranges.upper))

    @property
    def angle_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(5, 9) and (5, 9) radians between which a solver's steps stay, where no pose is kept."""
        return self.lower - STEP_MARGIN, self.upper + CLOSED_HAND_MARGIN + STEP_MARGIN

    def __call__(self, posed: Posed, seen: Observation) -> Rows:
        """The rows of B posed hands."""
        kept, sigma, below, above = seen.kept, SIGMA, np.zeros(1), CLOSED_HAND_MARGIN
        if kept is not None:
            own = np.isnan(kept.limits_sigma)[:, None, None]
            sigma = np.where(own, SIGMA, kept.limits_sigma[:, None, None])
            more = np.maximum(np.abs(self._outside(kept.angles, below, below)), PASSIVE_RANGE)
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
        """(B, 5, 9) radians beyond the ranges, which are widened by `below` and `above`."""
        left = np.ones_like(angles)
        left[..., SPREAD] -= _PER_RADIAN * np.clip(angles[..., BEND], 0.0, np.pi / 2)
        return angles - np.clip(angles, self.lower * left - below, self.upper * left + above)
