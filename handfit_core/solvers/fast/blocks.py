"""Normal equations of a hand, solved by its structure.

A finger's nine increments touch its own four points only, so that the matrix of a hand is an arrow: a
corner of the hand's own variables (root, place, the terms' offsets; with the shape 10 more), five blocks
of 9, and what couples each with the corner. The blocks are eliminated first (Schur complement). In a clip
with one shape, each frame's own are eliminated next and the shape is solved over all frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.solvers.fast.chain import Index


@dataclass(frozen=True, eq=False)
class Blocks:
    """Gauss-Newton matrices of B problems: H x = -g."""

    hand: np.ndarray
    """(B, n, n)"""
    mixed: np.ndarray
    """(B, 5, 9, n)"""
    finger: np.ndarray
    """(B, 5, 9, 9)"""
    hand_gradient: np.ndarray
    """(B, n)"""
    finger_gradient: np.ndarray
    """(B, 5, 9)"""
    cost: np.ndarray
    """(B,)"""

    def where(self, chosen: np.ndarray, other: Blocks) -> Blocks:
        """These blocks where `chosen` (B,) says so, else the other's."""

        def pick(name: str) -> np.ndarray:
            mine, theirs = getattr(self, name), getattr(other, name)
            return np.where(chosen.reshape(-1, *[1] * (mine.ndim - 1)), mine, theirs)

        return Blocks(*(pick(name) for name in self.__dataclass_fields__))

    def select(self, index: Index) -> Blocks:
        """The problems of that index."""
        return Blocks(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def holding(self, of_hand: np.ndarray, of_fingers: np.ndarray) -> Blocks:
        """The same problems with some variables held: their increments come out as exactly zero, and the
        others' as if they were no variables. `of_hand` (B, n) and `of_fingers` (B, 5, 9) bool."""
        hand_free, finger_free = 1.0 - of_hand, 1.0 - of_fingers
        hand = self.hand * hand_free[:, :, None] * hand_free[:, None]
        finger = self.finger * finger_free[..., None] * finger_free[..., None, :]
        np.einsum("...ii->...i", hand)[...] += of_hand
        np.einsum("...ii->...i", finger)[...] += of_fingers
        return Blocks(
            hand,
            self.mixed * finger_free[..., None] * hand_free[:, None, None],
            finger,
            self.hand_gradient * hand_free,
            self.finger_gradient * finger_free,
            self.cost,
        )

    def step(self, damping: np.ndarray, *, shared: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Increments (B, n) and (B, 5, 9) under Levenberg-Marquardt damping (B,), relative to the diagonals.

        The last `shared` of the n variables are the same in all B problems. NaN where a matrix is not
        definite.
        """
        batch, n = self.hand_gradient.shape
        fingers = np.concatenate(
            [_damped(self.finger, damping[:, None]), self.mixed, self.finger_gradient[..., None]], axis=-1
        )
        with np.errstate(all="ignore"):
            fingers, halves = _eliminated(fingers.reshape(batch * 5, 9, 10 + n))
            halves = halves.reshape(batch, 45, n + 1)
            outer = np.swapaxes(halves[..., :n], 1, 2) @ halves  # (B, n, n + 1)
            rest = np.concatenate([_damped(self.hand, damping), self.hand_gradient[..., None]], axis=-1)
            of_hand = -_solved(rest - outer, shared)
            # Back to the fingers: D y = -(g + B x).
            of_fingers = -_substituted(fingers, 9, np.repeat(-of_hand, 5, axis=0))
        return of_hand, of_fingers.reshape(batch, 5, 9)

    def promised(self, of_hand: np.ndarray, of_fingers: np.ndarray) -> np.ndarray:
        """(B,) by how much a step lowers the cost, at the least, if the residuals are linear: -g^T x.

        g, here and in the blocks, is J^T r: half the cost's gradient.
        """
        of_all = (self.finger_gradient * of_fingers).sum(axis=(1, 2))
        return -of_all - (self.hand_gradient * of_hand).sum(axis=1)


def _damped(matrix: np.ndarray, damping: np.ndarray) -> np.ndarray:
    damped = matrix.copy()
    diagonal = np.einsum("...ii->...i", damped)
    diagonal *= 1.0 + damping[..., None]
    diagonal += 1e-6
    return damped


def _eliminated(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eliminate the k variables of N positive definite systems (N, k, k + m), whose last m columns are right
    sides. Returns rows of the triangular systems (k, k + m, N), and L^-1 of the right sides (N, k, m), where
    L L^T is the matrix. NaN where it is not definite."""
    rows = np.ascontiguousarray(matrix.transpose(1, 2, 0))
    count = len(rows)
    for j in range(count - 1):
        # The matrix is symmetric: its row j is its column, too.
        factor = rows[j, j + 1 : count] / rows[j, j]
        rows[j + 1 :, j + 1 :] -= factor[:, None] * rows[j, None, j + 1 :]
    pivots = rows[range(count), range(count)]
    halves = rows[:, count:] / np.sqrt(pivots)[:, None]
    return rows, np.ascontiguousarray(halves.transpose(2, 0, 1))


def _substituted(rows: np.ndarray, count: int, known: np.ndarray | None = None) -> np.ndarray:
    """(N, k) solutions from what `_eliminated` leaves, of which the last right side counts. The other right
    sides times `known` (N, m - 1) are taken off it; None: there are no others."""
    found = np.empty((count, rows.shape[-1]))
    right = rows[:, -1]
    if known is not None:
        right = right - np.einsum("kmn,nm->kn", rows[:, count:-1], known)
    for j in reversed(range(count)):
        beyond = (rows[j, j + 1 : count] * found[j + 1 :]).sum(axis=0)
        found[j] = (right[j] - beyond) / rows[j, j]
    return found.T


def _solved(system: np.ndarray, shared: int) -> np.ndarray:
    """(B, n) solutions of systems (B, n, n + 1), of which the last `shared` variables are common to all."""
    batch, n, _ = system.shape
    own = n - shared
    rows, halves = _eliminated(system[:, :own])
    if not shared:
        return _substituted(rows, own)
    outer = np.swapaxes(halves[..., :shared], 1, 2) @ halves
    total = (system[:, own:, own:] - outer).sum(axis=0)
    common = np.linalg.solve(total[:, :-1], total[:, -1])
    mine = _substituted(rows, own, np.broadcast_to(common, (batch, shared)))
    return np.concatenate([mine, np.broadcast_to(common, (batch, shared))], axis=1)
