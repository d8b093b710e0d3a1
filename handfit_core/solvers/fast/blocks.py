"""Normal equations of a hand, solved by its structure.

A finger's nine increments touch its own four points only, so that the matrix of a hand is an arrow: a
corner of the hand's own variables (root, place, the terms' offsets; with the shape 10 more), five blocks
of 9, and what couples each with the corner. The blocks are eliminated first (Schur complement). In a clip
with one shape, each frame's own are eliminated next and the shape is solved over all frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch


@dataclass(frozen=True, eq=False)
class Blocks:
    """Gauss-Newton matrices of B problems: H x = -g."""

    hand: torch.Tensor
    """(B, n, n)"""
    mixed: torch.Tensor
    """(B, 5, 9, n)"""
    finger: torch.Tensor
    """(B, 5, 9, 9)"""
    hand_gradient: torch.Tensor
    """(B, n)"""
    finger_gradient: torch.Tensor
    """(B, 5, 9)"""
    cost: torch.Tensor
    """(B,)"""

    def where(self, chosen: torch.Tensor, other: Blocks) -> Blocks:
        """These blocks where `chosen` (B,) says so, else the other's."""

        def pick(name: str) -> torch.Tensor:
            mine, theirs = getattr(self, name), getattr(other, name)
            return torch.where(chosen.view(-1, *[1] * (mine.ndim - 1)), mine, theirs)

        return Blocks(*(pick(name) for name in self.__dataclass_fields__))

    def select(self, index: torch.Tensor) -> Blocks:
        """The problems of that index."""
        return Blocks(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def holding(self, of_hand: torch.Tensor, of_fingers: torch.Tensor) -> Blocks:
        """The same problems with some variables held: their increments come out as exactly zero, and the
        others' as if they were no variables. `of_hand` (B, n) and `of_fingers` (B, 5, 9) bool."""
        hand_free, finger_free = (~of_hand).to(self.cost.dtype), (~of_fingers).to(self.cost.dtype)
        hand = self.hand * hand_free[:, :, None] * hand_free[:, None]
        finger = self.finger * finger_free[..., None] * finger_free[..., None, :]
        hand.diagonal(dim1=-2, dim2=-1).add_(1.0 - hand_free)
        finger.diagonal(dim1=-2, dim2=-1).add_(1.0 - finger_free)
        return Blocks(
            hand,
            self.mixed * finger_free[..., None] * hand_free[:, None, None],
            finger,
            self.hand_gradient * hand_free,
            self.finger_gradient * finger_free,
            self.cost,
        )

    def step(self, damping: torch.Tensor, *, shared: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
        """Increments (B, n) and (B, 5, 9) under Levenberg-Marquardt damping (B,), relative to the diagonals.

        The last `shared` of the n variables are the same in all B problems.
        """
        batch, n = self.hand_gradient.shape
        factor, reduced, gradient, halves = self._without_fingers(damping)
        if shared:
            of_hand = _shared(reduced, gradient, n - shared)
        else:
            root = torch.linalg.cholesky_ex(reduced)[0]
            of_hand = -torch.cholesky_solve(gradient.unsqueeze(-1), root).squeeze(-1)
        # Back to the fingers: D y = -(g + B x), where L^-1 [B g] is at hand.
        right = (halves[..., :n] @ of_hand[:, None, :, None]) + halves[..., n:]
        of_fingers = -torch.linalg.solve_triangular(factor.mT, right.view(batch * 5, 9, 1), upper=True)
        return of_hand, of_fingers.reshape(batch, 5, 9)

    def promised(self, of_hand: torch.Tensor, of_fingers: torch.Tensor) -> torch.Tensor:
        """(B,) by how much a step lowers the cost, at the least, if the residuals are linear: -g^T x.

        g, here and in the blocks, is J^T r: half the cost's gradient.
        """
        of_all = (self.finger_gradient * of_fingers).sum(dim=(1, 2))
        return -of_all - (self.hand_gradient * of_hand).sum(dim=1)

    def _without_fingers(
        self, damping: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """The fingers' Cholesky factors (5B, 9, 9), the reduced matrix (B, n, n) and gradient (B, n), and
        L^-1 [B g] (B, 5, 9, n + 1)."""
        batch, n = self.hand_gradient.shape
        finger = _damped(self.finger, damping[:, None]).view(batch * 5, 9, 9)
        factor = torch.linalg.cholesky_ex(finger)[0]
        right = torch.cat([self.mixed, self.finger_gradient.unsqueeze(-1)], dim=-1).view(batch * 5, 9, n + 1)
        halves = torch.linalg.solve_triangular(factor, right, upper=False).reshape(batch, 45, n + 1)
        outer = halves[..., :n].mT @ halves  # (B, n, n + 1)
        reduced = _damped(self.hand, damping) - outer[..., :n]
        return factor, reduced, self.hand_gradient - outer[..., n], halves.view(batch, 5, 9, n + 1)


def _damped(matrix: torch.Tensor, damping: torch.Tensor) -> torch.Tensor:
    damped = matrix.clone(memory_format=torch.contiguous_format)
    damped.diagonal(dim1=-2, dim2=-1).mul_(1.0 + damping[..., None]).add_(1e-6)
    return damped


def _shared(reduced: torch.Tensor, gradient: torch.Tensor, n: int) -> torch.Tensor:
    """Increments of which the first n are each problem's own and the rest common to all."""
    own, mixed, common = reduced[:, :n, :n], reduced[:, :n, n:], reduced[:, n:, n:]
    factor = torch.linalg.cholesky_ex(own)[0]
    right = torch.cat([mixed, gradient[:, :n, None]], dim=-1)
    halves = torch.linalg.solve_triangular(factor, right, upper=False)
    outer = halves[..., :-1].mT @ halves
    total = (common - outer[..., :-1]).sum(dim=0)
    total_gradient = (gradient[:, n:] - outer[..., -1]).sum(dim=0)
    shape = -torch.linalg.solve(total, total_gradient)
    back = halves[..., :-1] @ shape + halves[..., -1]
    of_frame = -torch.linalg.solve_triangular(factor.mT, back.unsqueeze(-1), upper=True).squeeze(-1)
    return torch.cat([of_frame, shape.expand(len(of_frame), -1)], dim=1)
