"""Distance of a hand's shape from what is expected."""

from __future__ import annotations

import torch


def shape_prior(
    betas: torch.Tensor, sigma: torch.Tensor, mean: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """betas (B, 10), sigma (10,), mean (10,), which is zero where it is None -> residuals (B, 10) and their
    derivatives (10,), a diagonal."""
    away = betas if mean is None else betas - mean
    return away / sigma, sigma.reciprocal()
