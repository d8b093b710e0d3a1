"""Distance of a hand's shape from the mean."""

from __future__ import annotations

import torch


def shape_prior(betas: torch.Tensor, sigma: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """betas (B, 10), sigma (10,) -> residuals (B, 10) and their derivatives (10,), a diagonal."""
    return betas / sigma, sigma.reciprocal()
