"""Two cameras that film the same hands: found from hands that were projected into both."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.capturing.views.cameras import CameraPriors, adjust
from handfit_core.capturing.views.verdict import rotation_between
from tests.core.capturing.views.filmed import FPS, OFFSET, SHIFT, TURN, pair
from tests.core.fit.differences import close


@pytest.mark.parametrize("sides", [("right",), ("left",), ("left", "right")])
def test_cameras_are_recovered(sides):
    """From poses that are wrong by six degrees a joint, a tenth too far away, and two frames off."""
    pairs = [pair(side, seed) for seed, side in enumerate(sides)]
    found = adjust(pairs, OFFSET + 2.0 / FPS, CameraPriors((600.0, 600.0), (0.02, 0.02)))
    assert found is not None
    assert rotation_between(found.rotation, TURN) < 1.5
    assert abs(found.offset - OFFSET) * FPS < 0.1
    way, true = found.translation, SHIFT
    assert way @ true > 0.999 * np.linalg.norm(way) * np.linalg.norm(true)
    assert np.linalg.norm(way - true) < 0.1 * np.linalg.norm(true)
    assert found.residual < 0.5
    few = adjust([pairs[0].at(np.arange(20, 26))], OFFSET, CameraPriors((600.0, 600.0), (0.3, 0.3)))
    assert few is not None
    assert all(more > 2.0 * less for more, less in zip(few.left_open, found.left_open, strict=True))
    told = CameraPriors((600.0, 600.0), (0.0, 0.0), TURN, SHIFT, 0.0)
    held = adjust(pairs, OFFSET, told)
    assert held is not None
    close(held.rotation, TURN)
    close(held.translation, SHIFT)
    assert held.offset == OFFSET
