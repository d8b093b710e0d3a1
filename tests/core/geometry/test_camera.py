"""The pinhole camera: closed forms, round trips, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from handfit_core.errors import OptionError
from handfit_core.geometry.camera import Intrinsics

CAMERA = Intrinsics(fx=500.0, fy=520.0, cx=310.0, cy=255.0)


def test_projection_by_hand() -> None:
    # 1 m right, half a metre down, 2 m ahead: 500/2 right of cx, 520/4 below cy.
    np.testing.assert_allclose(CAMERA.project(np.array([1.0, 0.5, 2.0])), [560.0, 385.0], atol=1e-12)
    np.testing.assert_allclose(CAMERA.project(np.array([0.0, 0.0, 0.3])), [310.0, 255.0], atol=1e-12)


def test_rays_invert_projection() -> None:
    points = np.random.default_rng(0).uniform((-1, -1, 0.2), (1, 1, 3), size=(4, 21, 3))
    rays = CAMERA.rays(CAMERA.project(points))
    assert rays.shape == points.shape
    np.testing.assert_array_equal(rays[..., 2], 1.0)
    np.testing.assert_allclose(rays * points[..., 2:], points, atol=1e-13)


def test_assumed_camera() -> None:
    for width, height in ((1920, 1080), (1080, 1920)):
        camera = Intrinsics.assumed(width, height)
        left, right = camera.rays(np.array([[0.0, height / 2], [width, height / 2]]))
        top, bottom = camera.rays(np.array([[width / 2, 0.0], [width / 2, height]]))
        spans = [math.degrees(math.atan(b[i] - m) - math.atan(a[i] - m)) for a, b, i, m in (
            (left, right, 0, 0.0), (top, bottom, 1, 0.0)
        )]  # fmt: skip
        assert max(spans) == pytest.approx(53.13, abs=0.01)
        assert (spans[0] > spans[1]) == (width > height)


def test_assumed_camera_of_crops() -> None:
    """A hand of 0.17 metres that has so many pixels is 0.4 metres away, or farther."""
    assert Intrinsics.assumed(640, 480, 272.0) == Intrinsics.assumed(640, 480)
    close = Intrinsics.assumed(640, 480, 400.0)
    assert close.fx == close.fy == pytest.approx(400.0 * 0.4 / 0.17)
    assert (close.cx, close.cy) == (320.0, 240.0)


@pytest.mark.parametrize(
    "values",
    [
        (0.0, 500.0, 1.0, 1.0),
        (500.0, -1.0, 1.0, 1.0),
        (math.nan, 500.0, 1.0, 1.0),
        (500.0, math.inf, 1.0, 1.0),
        (500.0, 500.0, math.nan, 1.0),
    ],
)
def test_impossible_cameras_are_refused(values: tuple[float, float, float, float]) -> None:
    with pytest.raises(OptionError, match="positive, finite focal lengths"):
        Intrinsics(*values)
