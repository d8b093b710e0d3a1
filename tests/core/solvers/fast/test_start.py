import numpy as np
import pytest
import torch

from handfit_core.skeleton import SIDES, Side
from handfit_core.solvers.fast.angles import angles_of
from handfit_core.solvers.fast.start import relaxed_start, spatial, turns_to_rays
from tests.core.residuals.differences import random
from tests.core.solvers.fast.hands import RELAXED, chain_of, make_state, observe

SIGN = np.tile([-1.0, -1.0, 1.0], 3)


def test_turns_lead_from_the_axis_to_the_ray() -> None:
    rays = torch.nn.functional.normalize(random(5, 3) + torch.tensor([0.0, 0.0, 2.0]), dim=1)
    turns = turns_to_rays(rays)
    torch.testing.assert_close(turns[:, :, 2], rays)
    torch.testing.assert_close(turns @ turns.mT, torch.eye(3, dtype=torch.float64).expand(5, 3, 3))
    # The smallest of all turns: its angle is that between axis and ray.
    trace = turns.diagonal(dim1=1, dim2=2).sum(dim=1)
    torch.testing.assert_close((trace - 1) / 2, rays[:, 2])


def test_spatial_landmarks_are_the_hand_seen_from_afar() -> None:
    chain = chain_of()
    points = chain.pose(make_state(2, chain)).points
    points = points + torch.tensor([0.0, 0.0, 50.0], dtype=torch.float64)
    found = spatial(observe(points))
    expected = (points - points.mean(dim=1, keepdim=True)) * 600.0 / points[..., 2].mean(dim=1)[:, None, None]
    torch.testing.assert_close(found, expected, rtol=0, atol=0.05)


@pytest.mark.parametrize("offsets", [1, 4])
@pytest.mark.parametrize("side", SIDES)
def test_a_relaxed_hand_starts_at_its_place(side: Side, offsets: int) -> None:
    chain = chain_of(side)
    angles = torch.tensor(RELAXED if side == "right" else RELAXED * SIGN).expand(6, 5, 9).contiguous()
    truth = make_state(6, chain, spread=0.0)
    truth = type(truth)(truth.root, truth.local, truth.wrist, torch.zeros_like(truth.betas), truth.offsets)
    points = chain.pose(truth).points
    start = relaxed_start(chain, observe(points), angles, truth.betas, offsets=offsets)
    # Weak perspective at half a metre: a few degrees, a few centimetres.
    turn = (start.root.mT @ truth.root).diagonal(dim1=1, dim2=2).sum(dim=1)
    assert float(torch.acos(((turn - 1) / 2).clamp(-1, 1)).max()) < np.radians(12)
    assert float((start.wrist - truth.wrist).norm(dim=1).max()) < 0.06
    assert start.offsets.shape == (6, offsets)


def test_start_of_a_single_spot_is_finite() -> None:
    """A detector that put all landmarks on one pixel."""
    chain = chain_of()
    seen = observe(torch.tensor([0.0, 0.0, 0.5], dtype=torch.float64).expand(1, 21, 3))
    start = relaxed_start(chain, seen, torch.tensor(RELAXED)[None], torch.zeros(1, 10, dtype=torch.float64))
    for name in ("root", "local", "wrist", "betas", "offsets"):
        assert getattr(start, name).isfinite().all(), name
    assert angles_of(start.local).isfinite().all()
