"""Hands as small pictures."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.hand_model import load_model
from handfit_core.hand_model.drawing import _lit, colored, drawn_pose


def test_a_picture_is_a_hand_on_nothing() -> None:
    model = load_model(None, "right")
    drawn = drawn_pose(model, np.zeros(45), 64)
    assert drawn.shape == (64, 64, 2)
    assert drawn.dtype == np.uint8
    assert (drawn[0, 0] == 0).all()
    assert (drawn[30:40, 30:34, 1] == 255).all()  # the palm
    assert drawn[..., 1].max(axis=1).nonzero()[0][[0, -1]].tolist() == pytest.approx([2, 61], abs=1)
    picture = colored(drawn)
    assert picture.shape == (64, 64, 4)
    np.testing.assert_array_equal(picture[..., 3], drawn[..., 1])


def test_views() -> None:
    """The flat hand is wide from before, thumb on the right, and narrow from the side."""
    model = load_model(None, "right")
    front, side = (drawn_pose(model, np.zeros(45), 64, turned, 0.0)[..., 1] > 127 for turned in (0.0, 90.0))
    wide, narrow = (np.ptp(np.flatnonzero(seen.any(axis=0))) for seen in (front, side))
    assert wide > 2 * narrow
    middle = np.flatnonzero(front[2]).mean()  # the tip of the middle finger
    columns = np.flatnonzero(front.any(axis=0))
    assert columns[-1] - middle > middle - columns[0]


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_occlusion(order: tuple[int, int]) -> None:
    corners = np.array([[1.0, 1.0, 0.0], [15.0, 1.0, 0.0], [1.0, 15.0, 0.0]])
    points = np.concatenate([corners, corners + [0.0, 0.0, 5.0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])[list(order)]
    depth, light = _lit(points, faces, 16)
    assert depth[4, 4] == 5.0
    assert depth[14, 14] == -np.inf
    assert light[4, 4] > 0.5
    assert light[14, 14] == 0.0
    # From behind, neither is seen.
    assert np.all(_lit(points, faces[:, ::-1], 16)[0] == -np.inf)
