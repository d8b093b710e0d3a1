"""The paper's losses over keypoint residuals, in torch.

Residuals are in millimetres, per coordinate; each loss is a mean over all of them. The tips variants
add the same loss over the five fingertips alone, times `TIP_WEIGHT`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import torch

from handfit_core.skeleton import TIP_KEYPOINTS

Loss = Callable[[torch.Tensor], torch.Tensor]

TIP_WEIGHT: Final = 4.0
"""As in the published code."""

GEMAN_MCCLURE_RHO: Final = 100.0
"""mm; the paper's own results with it and with MSE differ by 0.01 mm, so it must be wide"""

HUBER_DELTA: Final = 5.0
"""mm; where Huber's loss turns from square to linear"""


def mse(residual: torch.Tensor) -> torch.Tensor:
    """Mean square."""
    return residual.square().mean()


def geman_mcclure(residual: torch.Tensor) -> torch.Tensor:
    """Mean of rho^2 r^2 / (r^2 + rho^2) (Geman and McClure 1987)."""
    square = residual.square()
    rho2 = GEMAN_MCCLURE_RHO**2
    return (rho2 * square / (square + rho2)).mean()


def huber(residual: torch.Tensor) -> torch.Tensor:
    """Mean of r^2 / 2 near zero, delta (|r| - delta / 2) beyond delta (Huber 1964)."""
    return torch.nn.functional.huber_loss(residual, torch.zeros_like(residual), delta=HUBER_DELTA)


def with_tips(loss: Loss) -> Loss:
    """The same loss with the fingertips counted again; takes (B, 21, C) residuals."""
    tips = list(TIP_KEYPOINTS)

    def weighted(residual: torch.Tensor) -> torch.Tensor:
        return loss(residual) + TIP_WEIGHT * loss(residual[:, tips])

    return weighted
