from dataclasses import replace

import numpy as np
import pytest

from handfit_core.fit.start import relaxed_start, spatial
from handfit_core.hand_model.chain import State
from handfit_core.skeleton import SIDES, Side
from tests.core.fit.differences import close
from tests.core.fit.hands import MIRROR, RELAXED, chain_of, make_state, observe


def test_spatial_landmarks() -> None:
    chain = chain_of()
    points = chain.pose(make_state(2, chain)).points
    points = points + np.array([0.0, 0.0, 50.0])
    found = spatial(observe(points))
    expected = (
        (points - points.mean(axis=1, keepdims=True)) * 600.0 / points[..., 2].mean(axis=1)[:, None, None]
    )
    close(found, expected, rtol=0, atol=0.05)


@pytest.mark.parametrize("side", SIDES)
def test_relaxed_start(side: Side) -> None:
    chain = chain_of(side)
    angles = RELAXED if side == "right" else RELAXED * MIRROR
    truth = replace(make_state(6, chain, spread=0.0), betas=np.zeros((6, 10)))
    points = chain.pose(truth).points
    start = relaxed_start(chain, observe(points), angles, np.zeros(10))
    # Weak perspective at half a metre: a few degrees, a few centimetres.
    turn = (start.root.swapaxes(-1, -2) @ truth.root).trace(axis1=1, axis2=2)
    assert float(np.arccos(((turn - 1) / 2).clip(-1, 1)).max()) < np.radians(12)
    assert float(np.linalg.norm(start.wrist - truth.wrist, axis=1).max()) < 0.06
    assert np.abs(start.depth_zero - points[..., 2].mean(axis=1)).max() < 0.06


def test_start_of_a_single_spot_is_finite() -> None:
    """A detector that put all landmarks on one pixel."""
    chain = chain_of()
    seen = observe(np.tile([0.0, 0.0, 0.5], (1, 21, 1)))
    start = relaxed_start(chain, seen, RELAXED, np.zeros(10))
    for name in State.__dataclass_fields__:
        assert np.isfinite(getattr(start, name)).all(), name
