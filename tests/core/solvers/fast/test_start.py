import numpy as np
import pytest

from handfit_core.skeleton import SIDES, Side
from handfit_core.solvers.fast.angles import angles_of
from handfit_core.solvers.fast.start import relaxed_start, spatial, turns_to_rays
from tests.core.residuals.differences import close, random, unit
from tests.core.solvers.fast.hands import RELAXED, chain_of, make_state, observe

SIGN = np.tile([-1.0, -1.0, 1.0], 3)


def test_turns_lead_from_the_axis_to_the_ray() -> None:
    rays = unit(random(5, 3) + np.array([0.0, 0.0, 2.0]))
    turns = turns_to_rays(rays)
    close(turns[:, :, 2], rays)
    close(turns @ turns.swapaxes(-1, -2), np.broadcast_to(np.eye(3), (5, 3, 3)))
    # The smallest of all turns: its angle is that between axis and ray.
    trace = turns.trace(axis1=1, axis2=2)
    close((trace - 1) / 2, rays[:, 2])


def test_spatial_landmarks_are_the_hand_seen_from_afar() -> None:
    chain = chain_of()
    points = chain.pose(make_state(2, chain)).points
    points = points + np.array([0.0, 0.0, 50.0])
    found = spatial(observe(points))
    expected = (
        (points - points.mean(axis=1, keepdims=True)) * 600.0 / points[..., 2].mean(axis=1)[:, None, None]
    )
    close(found, expected, rtol=0, atol=0.05)


@pytest.mark.parametrize("offsets", [1, 4])
@pytest.mark.parametrize("side", SIDES)
def test_a_relaxed_hand_starts_at_its_place(side: Side, offsets: int) -> None:
    chain = chain_of(side)
    angles = np.tile(RELAXED if side == "right" else RELAXED * SIGN, (6, 1, 1))
    truth = make_state(6, chain, spread=0.0)
    truth = type(truth)(truth.root, truth.local, truth.wrist, np.zeros_like(truth.betas), truth.offsets)
    points = chain.pose(truth).points
    start = relaxed_start(chain, observe(points), angles, truth.betas, offsets=offsets)
    # Weak perspective at half a metre: a few degrees, a few centimetres.
    turn = (start.root.swapaxes(-1, -2) @ truth.root).trace(axis1=1, axis2=2)
    assert float(np.arccos(((turn - 1) / 2).clip(-1, 1)).max()) < np.radians(12)
    assert float(np.linalg.norm(start.wrist - truth.wrist, axis=1).max()) < 0.06
    assert start.offsets.shape == (6, offsets)


def test_start_of_a_single_spot_is_finite() -> None:
    """A detector that put all landmarks on one pixel."""
    chain = chain_of()
    seen = observe(np.tile([0.0, 0.0, 0.5], (1, 21, 1)))
    start = relaxed_start(chain, seen, RELAXED[None], np.zeros((1, 10)))
    for name in ("root", "local", "wrist", "betas", "offsets"):
        assert np.isfinite(getattr(start, name)).all(), name
    assert np.isfinite(angles_of(start.local)).all()
