"""The pinhole camera: closed forms, round trips, refusals."""

import math

import numpy as np
import pytest

from handfit_core.common.errors import OptionError
from handfit_core.geometry.camera import Intrinsics

CAMERA = Intrinsics(fx=500.0, fy=520.0, cx=310.0, cy=255.0)


def test_projection_by_hand():
    # 1 m right, half a metre down, 2 m ahead: 500/2 right of cx, 520/4 below cy.
    np.testing.assert_allclose(CAMERA.project(np.array([1.0, 0.5, 2.0])), [560.0, 385.0], atol=1e-12)
    np.testing.assert_allclose(CAMERA.project(np.array([0.0, 0.0, 0.3])), [310.0, 255.0], atol=1e-12)


def test_rays_invert_projection():
    points = np.random.default_rng(0).uniform((-1, -1, 0.2), (1, 1, 3), size=(4, 21, 3))
    rays = CAMERA.rays(CAMERA.project(points))
    assert rays.shape == points.shape
    np.testing.assert_array_equal(rays[..., 2], 1.0)
    np.testing.assert_allclose(rays * points[..., 2:], points, atol=1e-13)


def test_assumed_camera():
    """The longer side spans 53.13 degrees; a hand of 0.17 metres that is larger in the picture is 0.4 metres
    away."""
    for width, height in ((1920, 1080), (1080, 1920)):
        camera = Intrinsics.assumed(width, height)
        span = 2 * math.degrees(math.atan(max(width, height) / 2 / camera.fx))
        assert span == pytest.approx(53.13, abs=0.01)
        assert (camera.fy, camera.cx, camera.cy) == (camera.fx, width / 2, height / 2)
    assert Intrinsics.assumed(640, 480, 272.0) == Intrinsics.assumed(640, 480)
    close = Intrinsics.assumed(640, 480, 400.0)
    assert close.fx == close.fy == pytest.approx(400.0 * 0.4 / 0.17)
    assert (close.cx, close.cy) == (320.0, 240.0)


@pytest.mark.parametrize(
    "values",
    [(0, 500, 1, 1), (500, -1, 1, 1), (math.nan, 500, 1, 1), (500, math.inf, 1, 1), (500, 500, math.nan, 1)],
)
def test_impossible_cameras_are_refused(values):
    with pytest.raises(OptionError, match="positive, finite focal lengths"):
        Intrinsics(*values)
