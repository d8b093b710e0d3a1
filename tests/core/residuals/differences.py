"""Central differences, the independent formula for every analytic Jacobian."""

from __future__ import annotations

from collections.abc import Callable

import torch

STEP = 1e-6


def by_each(function: Callable[[torch.Tensor], torch.Tensor], at: torch.Tensor) -> torch.Tensor:
    """Derivatives of function(at), any shape, by every element of `at`: (*function's shape, at.numel())."""
    columns = []
    for i in range(at.numel()):
        shift = torch.zeros(at.numel(), dtype=at.dtype)
        shift[i] = STEP
        shift = shift.view(at.shape)
        columns.append((function(at + shift) - function(at - shift)) / (2 * STEP))
    return torch.stack(columns, dim=-1)


def of_increments(function: Callable[[torch.Tensor], torch.Tensor], count: int) -> torch.Tensor:
    """Derivatives at zero of function((2 count, count)) -> (2 count, ...), by each increment: (..., count).

    All shifts are one batch, which is faster than `by_each`.
    """
    shifts = torch.eye(count, dtype=torch.float64) * STEP
    after = function(torch.cat([shifts, -shifts]))
    return ((after[:count] - after[count:]) / (2 * STEP)).movedim(0, -1)


def random(*shape: int, seed: int = 0, scale: float = 1.0) -> torch.Tensor:
    """Normal numbers in float64."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64) * scale


def of_own_point(differences: torch.Tensor) -> torch.Tensor:
    """(21, c, 63) differences of one hand's rows by all its points -> (21, c, 3) by the row's own point.

    Fails where a row depends on another point: a term on points must not.
    """
    points, rows, _ = differences.shape
    whole = differences.view(points, rows, points, 3)
    own = torch.stack([whole[k, :, k] for k in range(points)])
    others = whole.clone()
    for k in range(points):
        others[k, :, k] = 0
    assert others.abs().max() == 0
    return own


def of_own_finger(differences: torch.Tensor) -> torch.Tensor:
    """(5, c, 45) differences of one hand's rows by all its angles -> (5, c, 9) by the row's own finger."""
    fingers, rows, _ = differences.shape
    whole = differences.view(fingers, rows, fingers, 9)
    own = torch.stack([whole[f, :, f] for f in range(fingers)])
    others = whole.clone()
    for f in range(fingers):
        others[f, :, f] = 0
    assert others.abs().max() == 0
    return own
