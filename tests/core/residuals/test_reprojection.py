import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.residuals.reprojection import NEAREST, reprojection
from tests.core.residuals.differences import by_each, close, of_own_point, random

POINTS = random(3, 21, 3, scale=0.1) + np.array([0.05, -0.1, 0.6])
PIXELS = random(3, 21, 2, seed=1, scale=100.0) + 320
SIGMA = np.abs(random(3, 21, 2, seed=2)) + 1
FOCAL = np.array([[600.0, 620.0], [900.0, 900.0], [500.0, 480.0]])
CENTRE = np.array([[320.0, 240.0], [300.0, 250.0], [640.0, 360.0]])


def test_residual_is_the_pinhole_camera() -> None:
    rows = reprojection(POINTS, PIXELS, SIGMA, FOCAL, CENTRE)
    for i in range(3):
        camera = Intrinsics(*FOCAL[i].tolist(), *CENTRE[i].tolist())
        expected = (np.array(camera.project(POINTS[i])) - PIXELS[i]) / SIGMA[i]
        close(rows.residual[i], expected, rtol=1e-12, atol=1e-9)


def test_jacobian_by_points() -> None:
    rows = reprojection(POINTS, PIXELS, SIGMA, FOCAL, CENTRE)
    one = slice(0, 1)
    differences = by_each(
        lambda x: reprojection(x, PIXELS[one], SIGMA[one], FOCAL[one], CENTRE[one]).residual[0], POINTS[one]
    )
    close(rows.jacobian[0], of_own_point(differences), rtol=1e-6, atol=1e-5)
    assert rows.by_offset is None


def test_a_point_behind_the_camera_stays_finite() -> None:
    behind = POINTS.copy()
    behind[0, 3, 2] = -0.4
    behind[0, 4, 2] = 0.0
    rows = reprojection(behind, PIXELS, SIGMA, FOCAL, CENTRE)
    assert np.isfinite(rows.residual).all()
    assert np.isfinite(rows.jacobian).all()
    as_if = behind.copy()
    as_if[0, 3:5, 2] = NEAREST
    close(rows.residual, reprojection(as_if, PIXELS, SIGMA, FOCAL, CENTRE).residual)


def test_batch_equals_loop() -> None:
    whole = reprojection(POINTS, PIXELS, SIGMA, FOCAL, CENTRE)
    for i in range(3):
        one = reprojection(*(a[i : i + 1] for a in (POINTS, PIXELS, SIGMA, FOCAL, CENTRE)))
        close(whole.residual[i], one.residual[0])
        close(whole.jacobian[i], one.jacobian[0])
