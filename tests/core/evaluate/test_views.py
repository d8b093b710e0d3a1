from __future__ import annotations

import numpy as np
import pytest

from handfit_core.evaluate.matching import view_of
from handfit_core.geometry.rotations import rotvec_to_rotmat
from tests.core.evaluate.hands import joints


def turned(points: np.ndarray, degrees: float) -> np.ndarray:
    """About the vertical through the palm."""
    middle = points[[0, 5, 17]].mean(axis=0)
    turn = rotvec_to_rotmat(np.array([0.0, np.radians(degrees), 0.0]))
    return (points - middle) @ turn.T + middle


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("degrees", "view"), [(0, "palm"), (40, "palm"), (90, "edge"), (-90, "edge"), (180, "back")]
)
def test_view_follows_the_palm_for_both_hands(side, degrees: float, view: str) -> None:
    assert view_of(turned(joints(side, at=(0.0, 0.05, 0.5)), degrees), side) == view


def test_view_is_unknown_without_a_side_or_a_knuckle() -> None:
    points = joints()
    assert view_of(points, None) == "unknown"
    points[17] = np.nan
    assert view_of(points, "right") == "unknown"
