"""The least-squares problem of a fit: a hand model, the observation of its hands, and the residual terms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.common.skeleton import JOINTS_BY_FINGER
from handfit_core.fit.blocks import Blocks
from handfit_core.fit.levenberg import LeastSquares
from handfit_core.fit.observation import Observation
from handfit_core.fit.terms import Term
from handfit_core.fit.terms.rows import FINGERS, HAND, POINTS, SIZES, Group, PairRows, SkinRows
from handfit_core.hand_model.chain import FIXED_SHAPE, HAND_SIZE, Chain, State

SharedShape = Literal["given", "each", "one"]


@dataclass(frozen=True, eq=False)
class FixedJoints(Batch):
    """Joints of B hands that are no variables of the fit, and the state that they are fixed at."""

    joints: np.ndarray
    """(B, 16) bool in MANO's order, true for fixed joints; joint 0 holds the wrist's rotation and its
    place"""
    state: State
    """The B hands whose joints are kept where fixed; their other joints do not count"""

    @cached_property
    def variables(self) -> np.ndarray:
        """(B, 51) bool: true for fixed variables, in the order of `clips`: root (3), angles finger by finger
        (45), place (3)."""
        wrist = self.joints[:, :1].repeat(3, axis=1)
        fingers = self.joints[:, JOINTS_BY_FINGER.reshape(-1)].repeat(3, axis=1)
        return np.concatenate([wrist, fingers, wrist], axis=1)

    def put(self, state: State) -> State:
        """Return `state` with the fixed joints replaced by those that they are fixed at."""
        wrist, fingers = self.joints[:, :1], self.variables[:, 3:48].reshape(-1, 5, 9)
        return replace(
            state,
            root=np.where(wrist[..., None], self.state.root, state.root),
            angles=np.where(fingers, self.state.angles, state.angles),
            wrist=np.where(wrist, self.state.wrist, state.wrist),
        )


@dataclass(frozen=True, eq=False)
class Problem(LeastSquares):
    """The least-squares problem of fitting B hands to what is observed of them."""

    chain: Chain
    seen: Observation
    terms: tuple[Term, ...]
    shape: SharedShape = "given"
    """The part of the shape in the fit: "given": betas are constants; "each": variables of each hand; "one":
    one set of variables for all hands"""
    fixed: FixedJoints | None = None
    """Joints that are no variables of the fit; None where all are variables"""
    angle_bounds: tuple[np.ndarray, np.ndarray] | None = None
    """The least and the greatest angles, (5, 9) radians each, between which steps keep the fingers: joint
    limits are so steep that a step, which only knows those that are exceeded already, would overshoot them.
    None: unbounded"""

    def clip_to_bounds(self, state: State, of_fingers: np.ndarray) -> np.ndarray:
        """Clip increments (B, 5, 9) of angles, in radians, to the bounds; angles that lie beyond them already
        go no farther."""
        if self.angle_bounds is None:
            return of_fingers
        least, most = self.angle_bounds
        angles = state.angles
        ends = np.clip(angles + of_fingers, np.minimum(least, angles), np.maximum(most, angles))
        return ends - angles

    @property
    def together(self) -> bool:
        """True if all hands have one shape, so that they are one problem."""
        return self.shape == "one"

    def step(
        self, state: State, blocks: Blocks, damping: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
        """Return increments (B, n) of the hands' variables and (B, 5, 9) of their angles, as `State.moved`
        takes them, and the predicted decrease (B,) of the costs."""
        of_hand, of_fingers = blocks.step(damping, shared_shape=self.together)
        step = of_hand, self.clip_to_bounds(state, of_fingers)
        return step, blocks.predicted_decrease(*step)

    def blocks(self, state: State) -> Blocks:
        """Return the cost and the Gauss-Newton matrices of B hands, each by itself."""
        posed = self.chain.pose(state)
        free = self.shape != "given"
        columns: dict[Group, list[np.ndarray]] = {POINTS: [], FINGERS: [], HAND: []}
        cost = np.zeros(len(state))
        pairs: list[PairRows] = []
        skin: list[SkinRows] = []
        for term in self.terms:
            rows = term(posed, self.seen)
            if isinstance(rows, PairRows):
                pairs.append(rows)
                np.add.at(cost, rows.hand, rows.cost)
                continue
            if isinstance(rows, SkinRows):
                skin.append(rows)
                np.add.at(cost, rows.hand, np.square(rows.columns[:, -1]))
                continue
            weighted, of_term = rows.weighted()
            columns[rows.of].append(weighted)
            cost += of_term
        # Columns of variables that only some terms know, such as cameras, are zero in the others.
        extra = max(rows.shape[-1] for rows in columns[POINTS]) - SIZES[POINTS][1] - 1
        points = [_widened(rows, SIZES[POINTS][1] + extra) for rows in columns[POINTS]]
        whole = self.chain.jacobian(posed, np.concatenate(points, axis=2), shape=free)
        batch, _, count, size = whole.shape
        of_hand = whole.reshape(batch, 21 * count, size)[..., 9:]
        hand = of_hand[..., :-1].swapaxes(1, 2) @ of_hand
        of_finger = whole[:, 1:].reshape(batch, 5, 4 * count, size)
        finger = of_finger[..., :9].swapaxes(2, 3) @ of_finger
        if columns[FINGERS]:
            rows = np.concatenate(columns[FINGERS], axis=2)
            squared = rows[..., :-1].swapaxes(2, 3) @ rows
            finger[..., :9] += squared[..., :9]
            finger[..., -1] += squared[..., 9]
        if columns[HAND]:
            rows = np.concatenate([_widened(r, HAND_SIZE + extra) for r in columns[HAND]], axis=2)[:, 0]
            # Columns of a hand's rows whose shape is given, with the residual
            rows = rows if free else rows[..., np.append(FIXED_SHAPE, -1)]
            hand += rows[..., :-1].swapaxes(1, 2) @ rows
        between = None
        if pairs:
            between = _paired(pairs, batch)
            own = np.einsum("bfifj->bfij", between[:, :45, :45].reshape(batch, 5, 9, 5, 9))
            beside = between[:, :45, 45:].reshape(batch, 5, 9, 4)
            finger[..., :9] += own
            finger[..., 9:12] += beside[..., :3]
            finger[..., -1] += beside[..., 3]
            hand[:, :3, :3] += between[:, 45:, 45:48]
            hand[:, :3, -1] += between[:, 45:, 48]
            between = between[:, :45, :45].copy()
            np.einsum("bfifj->bfij", between.reshape(batch, 5, 9, 5, 9))[...] = 0.0
        for rows in skin:
            squared = np.zeros((batch, 5, 15, 16))
            products = rows.columns[:, :-1, None] * rows.columns[:, None]
            np.add.at(squared, (rows.hand, rows.finger), products)
            finger[..., :15] += squared[:, :, :9, :15]
            finger[..., -1] += squared[:, :, :9, -1]
            hand[:, :6, :6] += squared[:, :, 9:, 9:15].sum(axis=1)
            hand[:, :6, -1] += squared[:, :, 9:, -1].sum(axis=1)
        blocks = Blocks(hand, finger, cost, between)
        if self.fixed is None:
            return blocks
        fixed = self.fixed.variables
        n = size - 10
        of_hand = np.zeros((batch, n), dtype=bool)
        of_hand[:, :3], of_hand[:, n - 4 : n - 1] = fixed[:, :3], fixed[:, 48:]
        return blocks.with_fixed(of_hand, fixed[:, 3:48].reshape(-1, 5, 9))


def _widened(rows: np.ndarray, size: int) -> np.ndarray:
    """Insert zeros before the residual, the last of columns (..., n + 1), so that there are derivatives by
    `size` variables."""
    missing = size + 1 - rows.shape[-1]
    if missing == 0:
        return rows
    zeros = np.zeros((*rows.shape[:-1], missing))
    return np.concatenate([rows[..., :-1], zeros, rows[..., -1:]], axis=-1)


def _paired(pairs: list[PairRows], batch: int) -> np.ndarray:
    """Sum the rows that couple two fingers into (B, 48, 49) Gauss-Newton matrices: 45 angles and the root's
    turn, with the gradient as the last column."""
    rows = PairRows.concatenate(pairs)
    hand, columns = rows.hand, rows.columns
    of_fingers = (9 * rows.fingers[..., None] + np.arange(9)).reshape(-1, 18)
    at = np.concatenate([of_fingers, np.broadcast_to(45 + np.arange(4), (len(hand), 4))], axis=1)
    squared = columns[:, :-1, None] * columns[:, None]
    flat = (hand[:, None, None] * 48 + at[:, :-1, None]) * 49 + at[:, None]
    return np.bincount(flat.reshape(-1), squared.reshape(-1), batch * 48 * 49).reshape(batch, 48, 49)
