"""Normal equations of a hand, solved by their arrow structure.

A finger's nine angles move its own four points only, so that the matrix of a hand is an arrow: a corner of
the hand's own variables (root, shape, place, depth's zero), five blocks of 9, and what couples each with the
corner. The blocks are eliminated first (Schur complement), or, in hands whose fingers touch, all five as one.
In a clip with one shape, each frame's own variables are eliminated next, and the shape is solved over all
frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.fit.settings import SOLVER
from handfit_core.hand_model.chain import BETAS, HAND_SIZE


@dataclass(frozen=True, eq=False)
class Blocks(Batch):
    """Gauss-Newton systems of B problems, H x = -g, with g = J^T r as their last column; n variables of the
    hand itself, 17 or, with a given shape, 7, and those of cameras, which are common to all."""

    hand: np.ndarray
    """(B, n, n + 1) the matrix of the hand's own variables, with their gradient as the last column"""
    finger: np.ndarray
    """(B, 5, 9, 9 + n + 1) for each finger the matrix of its nine angles, what couples them with the hand's
    variables, and their gradient"""
    cost: np.ndarray
    """(B,) the cost of each problem, in squared sigmas"""
    between: np.ndarray | None = None
    """(B, 45, 45) what couples the angles of different fingers, with zeros in each finger's own block; None
    where no hand of the batch has any"""

    def with_fixed(self, of_hand: np.ndarray, of_fingers: np.ndarray) -> Blocks:
        """Return the problems with some variables fixed: the increments of these come out as exactly zero.

        `of_hand` (B, n) and `of_fingers` (B, 5, 9) are bool: true for the fixed variables.
        """
        batch, n, _ = self.hand.shape
        free = 1.0 - np.concatenate([of_hand, np.zeros((batch, 1))], axis=1)
        finger_free = 1.0 - of_fingers
        beside = np.concatenate([finger_free, np.broadcast_to(free[:, None], (batch, 5, n + 1))], axis=2)
        hand = self.hand * free[:, :n, None] * free[:, None]
        finger = self.finger * finger_free[..., None] * beside[:, :, None]
        np.einsum("bii->bi", hand[..., :n])[...] += of_hand
        np.einsum("bfii->bfi", finger[..., :9])[...] += of_fingers
        between = self.between
        if between is not None:
            every = finger_free.reshape(batch, 45)
            between = between * every[:, :, None] * every[:, None]
        return Blocks(hand, finger, self.cost, between)

    def step(self, damping: np.ndarray, *, shared_shape: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Solve for increments (B, n) of the hand's variables and (B, 5, 9) of the fingers' angles under
        Levenberg-Marquardt damping (B,), relative to the matrix diagonals.

        With `shared_shape` all B problems get one common increment of the betas.
        """
        reduced, solved = self._without_fingers(damping)
        if shared_shape:
            of_hand = -_with_one_shape(reduced)
        else:
            of_hand = -np.linalg.solve(reduced[..., :-1], reduced[..., -1:])[..., 0]
        # Back to the fingers: D y = -(g + M x).
        of_fingers = -(solved[..., :-1] @ of_hand[:, None, :, None])[..., 0] - solved[..., -1]
        return of_hand, of_fingers

    def common_information(self) -> np.ndarray:
        """(c, c) information matrix of the variables that all B problems have in common, the betas and the
        cameras, with everything else free."""
        reduced, _ = self._without_fingers(np.zeros(len(self.cost)))
        return _of_common(reduced)[0][:, :-1]

    def _without_fingers(self, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Eliminate the fingers: return the hands' systems (B, n, n + 1) without them, and the fingers'
        answers (B, 5, 9, n + 1) to each column of these systems."""
        batch, n, _ = self.hand.shape
        # Faster than solving for the few right sides, and accurate enough for a step.
        own = _damped(self.finger[..., :9], damping[:, None])
        solved = np.linalg.inv(own) @ self.finger[..., 9:]
        if self.between is not None:
            coupled = np.flatnonzero(self.between.any(axis=(1, 2)))
            whole = self.between[coupled].reshape(-1, 5, 9, 5, 9)
            np.einsum("bfifj->bfij", whole)[...] = own[coupled]
            right = self.finger[coupled, ..., 9:].reshape(-1, 45, n + 1)
            solved[coupled] = np.linalg.solve(whole.reshape(-1, 45, 45), right).reshape(-1, 5, 9, n + 1)
        mixed = self.finger.reshape(batch, 45, 10 + n)[..., 9:-1]
        reduced = self.hand - mixed.swapaxes(1, 2) @ solved.reshape(batch, 45, n + 1)
        diagonal = np.einsum("bii->bi", reduced[..., :n])
        diagonal += damping[:, None] * np.einsum("bii->bi", self.hand[..., :n]) + SOLVER.diagonal_floor
        return reduced, solved

    def predicted_decrease(self, of_hand: np.ndarray, of_fingers: np.ndarray) -> np.ndarray:
        """(B,) by how much a step x decreases the cost at least, if the residuals are linear: -g^T x."""
        of_all = (self.finger[..., -1] * of_fingers).sum(axis=(1, 2))
        return -of_all - (self.hand[..., -1] * of_hand).sum(axis=1)


def _damped(matrix: np.ndarray, damping: np.ndarray) -> np.ndarray:
    damped = matrix.copy()
    diagonal = np.einsum("...ii->...i", damped)
    diagonal *= 1.0 + damping[..., None]
    diagonal += SOLVER.diagonal_floor
    return damped


def _of_common(system: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Eliminate what is each hand's own from B systems (B, n, n + 1). Returns the system (c, c + 1) of the
    betas and the cameras' variables, the answers (B, o, c + 1) of a hand's o own variables to each of its
    columns, and the indices of common and of own variables."""
    n = system.shape[1]
    common = np.r_[BETAS, HAND_SIZE:n]
    own = np.setdiff1d(np.arange(n), common)
    rest = np.append(common, n)
    right = system[:, own][:, :, rest]
    solved = np.linalg.solve(system[:, own][:, :, own], right)
    total = (system[:, common][:, :, rest] - right[..., :-1].swapaxes(1, 2) @ solved).sum(axis=0)
    return total, solved, common, own


def _with_one_shape(system: np.ndarray) -> np.ndarray:
    """Solve B systems (B, n, n + 1) whose betas are common to all; returns the increments (B, n), in which
    each hand's own variables follow from the common ones."""
    total, solved, common, own = _of_common(system)
    found = np.empty(system.shape[:2])
    found[:, common] = shape = np.linalg.solve(total[:, :-1], total[:, -1])
    found[:, own] = solved[..., -1] - solved[..., :-1] @ shape
    return found
