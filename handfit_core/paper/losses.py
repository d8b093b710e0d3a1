"""The paper's losses over keypoint residuals, in torch.

Residuals are in millimetres, per coordinate; each loss is a mean over all of them. The tips variants
add the same loss over the five fingertips alone, times `tip_weight`.
"""

from __future__ import annotations

from collections.abc import Callable

import torch

from handfit_core.paper.settings import PAPER
from handfit_core.skeleton import TIP_KEYPOINTS

Loss = Callable[[torch.Tensor], torch.Tensor]


def mse(residual: torch.Tensor) -> torch.Tensor:
    """Mean square."""
    return residual.square().mean()


def geman_mcclure(residual: torch.Tensor) -> torch.Tensor:
    """Mean of rho^2 r^2 / (r^2 + rho^2) (Geman and McClure 1987)."""
    square = residual.square()
    rho2 = PAPER.geman_mcclure_rho**2
    return (rho2 * square / (square + rho2)).mean()


def huber(residual: torch.Tensor) -> torch.Tensor:
    """Mean of r^2 / 2 near zero, delta (|r| - delta / 2) beyond delta (Huber 1964)."""
    return torch.nn.functional.huber_loss(residual, torch.zeros_like(residual), delta=PAPER.huber_delta)


def with_tips(loss: Loss) -> Loss:
    """The same loss with the fingertips counted again; takes (B, 21, C) residuals."""
    tips = list(TIP_KEYPOINTS)

    def weighted(residual: torch.Tensor) -> torch.Tensor:
        return loss(residual) + PAPER.tip_weight * loss(residual[:, tips])

    return weighted
