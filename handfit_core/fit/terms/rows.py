"""The results that terms return: residuals with their derivatives, and the kernel that weights them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.fit.observation import Observation
from handfit_core.hand_model.chain import HAND_SIZE, Posed
from handfit_core.hand_model.surface import FINGER_OF_BONE, LEVEL_OF_BONE, cross

Group = Literal["points", "fingers", "hand"]

POINTS: Group = "points"
"""21 groups of rows: derivatives by the point's place (3), metres, camera frame, and by where depth is zero
(1)"""
FINGERS: Group = "fingers"
"""5 groups of rows, as in `skeleton.FINGERS`: derivatives by the finger's nine angles, radians"""
HAND: Group = "hand"
"""The kind of rows that belong to a hand as one group: derivatives by the hand's own 17 variables, as
`hand_model.chain` orders them"""

SIZES: dict[Group, tuple[int, int]] = {POINTS: (21, 4), FINGERS: (5, 9), HAND: (1, HAND_SIZE)}
"""For each kind of rows, how many groups of it a hand has, and how many derivatives their rows have"""


@dataclass(frozen=True, eq=False)
class Rows:
    """Residuals of B hands, c for each point, finger or hand, in sigmas."""

    of: Group
    columns: np.ndarray
    """(B, count, c, derivatives + 1) for each residual its derivatives, and the residual itself last"""
    certain: np.ndarray | None = None
    """(B, count) bool: true for residuals that count with their square, however large. The others have
    Huber's kernel with delta 1 on the norm of a point's rows: square up to one sigma, linear beyond. None:
    all are certain"""

    @classmethod
    def zeros(cls, of: Group, batch: int, count: int) -> Rows:
        """Return `count` rows of zeros for each point, finger or hand of `batch` hands."""
        groups, derivatives = SIZES[of]
        return cls(of, np.zeros((batch, groups, count, derivatives + 1)))

    @property
    def residual(self) -> np.ndarray:
        """(B, count, c) the residuals in sigmas, as a view into the columns."""
        return self.columns[..., -1]

    @property
    def jacobian(self) -> np.ndarray:
        """(B, count, c, derivatives) the residuals' derivatives, as a view into the columns."""
        return self.columns[..., :-1]

    def weighted(self) -> tuple[np.ndarray, np.ndarray]:
        """(B, count, c, derivatives + 1) columns whose squares are the normal equations, and (B,) costs.

        Iteratively re-weighted least squares: with the kernel rho of a squared residual s, rows are
        multiplied with the root of rho'(s).
        """
        squared = np.square(self.residual).sum(axis=2)
        if self.certain is None:
            return self.columns, squared.sum(axis=1)
        root = np.sqrt(squared)
        beyond = np.maximum(root, 1.0)
        beyond[self.certain] = 1.0
        cost = np.where(beyond > 1.0, 2.0 * root - 1.0, squared).sum(axis=1)
        return self.columns * np.sqrt(1.0 / beyond)[..., None, None], cost


@dataclass(frozen=True, eq=False)
class PairRows(Batch):
    """K residuals between two parts of a hand, in sigmas. There are few, of some hands only."""

    hand: np.ndarray
    """(K,) the row of the batch in which each residual's hand stands"""
    fingers: np.ndarray
    """(K, 2) the two fingers of each residual, by their numbers in `skeleton.FINGERS`; a part of the palm
    counts as a finger that does not move"""
    columns: np.ndarray
    """(K, 22) derivatives by both fingers' nine angles and by the root's turn (3), and the residual; all of
    them multiplied with the root of the kernel's slope"""
    cost: np.ndarray
    """(K,) the cost of each residual, in squared sigmas"""


@dataclass(frozen=True, eq=False)
class SkinRows:
    """K residuals of places on fingers or on the palm, in sigmas, of hands whose shape is given."""

    hand: np.ndarray
    """(K,) the row of the batch in which each residual's hand stands"""
    finger: np.ndarray
    """(K,) the finger of each residual, by its number in `skeleton.FINGERS`; the palm's residuals may name
    any"""
    columns: np.ndarray
    """(K, 16) derivatives by the finger's nine angles, by the root's turn (3) and place (3), and the
    residual"""


def between(
    posed: Posed, hand: np.ndarray, bones: np.ndarray, places: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """(K, 21) derivatives of direction . (p - q), in the order of `PairRows.columns`.

    p and q are `places` (K, 2, 3) in metres, camera frame, fixed to `bones` (K, 2) of `Surface` of the hands
    `hand` (K,); `direction` (K, 3) is constant.
    """
    found = np.empty((len(hand), 21))
    if not len(hand):
        return found
    for which, sign in ((0, 1.0), (1, -1.0)):
        finger, level = FINGER_OF_BONE[bones[:, which]], LEVEL_OF_BONE[bones[:, which]]
        arms = places[:, which, None] - posed.origins[hand, finger, :3]
        turned = cross(arms, sign * direction[:, None])[:, :, None] @ posed.axes[hand, finger, :3]
        # A joint moves what lies beyond it; the palm's parts are beyond none.
        beyond = (np.arange(3) <= level[:, None]) & (level[:, None] < 3)
        found[:, 9 * which : 9 * which + 9] = (turned[:, :, 0] * beyond[..., None]).reshape(-1, 9)
    by_root = cross(places[:, 0] - places[:, 1], direction)
    found[:, 18:] = (by_root[:, None] @ posed.state.root[hand])[:, 0]
    return found


class Term(Protocol):
    """A function that computes one kind of residual of a fit."""

    def __call__(self, posed: Posed, seen: Observation) -> Rows | PairRows | SkinRows:
        """Return the rows of B posed hands against their observation."""
        ...
