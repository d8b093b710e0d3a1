"""The paper's anatomical limits as a penalty in torch."""

from __future__ import annotations

import numpy as np
import torch

from handfit_core.hand_model.anatomy import JointLimits
from handfit_core.layer import rotvec_to_rotmat
from handfit_core.paper.settings import PAPER


class AnatomicalPenalty:
    """a * sum(exp(l - theta) + exp(theta - u)) over the 45 anatomical angles theta, in radians."""

    def __init__(self, axes: np.ndarray, limits: JointLimits) -> None:
        self._axes = torch.tensor(axes)
        self._lower = torch.tensor(limits.lower)
        self._upper = torch.tensor(limits.upper)

    def __call__(self, hand_pose: torch.Tensor) -> torch.Tensor:
        """(B, 45) axis-angle -> scalar."""
        theta = self.angles(hand_pose)
        return PAPER.penalty_weight * (torch.exp(self._lower - theta) + torch.exp(theta - self._upper)).sum()

    def angles(self, hand_pose: torch.Tensor) -> torch.Tensor:
        """(B, 45) axis-angle -> (B, 15, 3) twist, spread, bend; see `hand_model.anatomy`."""
        rotmats = rotvec_to_rotmat(hand_pose.reshape(-1, 15, 3))
        local = self._axes.transpose(-1, -2) @ rotmats @ self._axes
        # arcsine as an arctangent: its gradient stays finite at +-90 degrees.
        sine, cosine = local[..., 0, 2], torch.hypot(local[..., 0, 0], local[..., 0, 1])
        return torch.stack(
            [
                torch.atan2(-local[..., 1, 2], local[..., 2, 2]),
                torch.atan2(sine, cosine),
                torch.atan2(-local[..., 0, 1], local[..., 0, 0]),
            ],
            dim=-1,
        )
