import numpy as np
import pytest

from handfit_core.geometry.camera import Intrinsics
from handfit_core.paper.placement import place, turn_to_ray

CAMERA = Intrinsics(900.0, 950.0, 300.0, 260.0)
RNG = np.random.default_rng(8)


@pytest.mark.parametrize("transl", [(0.0, 0.0, 0.5), (0.2, -0.15, 0.4), (-0.05, 0.1, 3.0), (0, 0, 0.15)])
def test_recovers_the_translation(transl: tuple[float, float, float]) -> None:
    points = RNG.uniform(-0.08, 0.08, (21, 3))
    pixels = CAMERA.project(points + np.array(transl))
    np.testing.assert_allclose(place(points, pixels, CAMERA), transl, atol=1e-6)


def test_stays_before_the_camera() -> None:
    points = RNG.uniform(-0.08, 0.08, (21, 3))
    mirrored = 2 * np.array([CAMERA.cx, CAMERA.cy]) - CAMERA.project(points + [0.0, 0.0, 0.4])
    assert np.all((points + place(points, mirrored, CAMERA))[:, 2] > 0)


def test_turn_to_ray() -> None:
    np.testing.assert_allclose(turn_to_ray(CAMERA, np.array([300.0, 260.0])), np.eye(3), atol=1e-12)
    for pixel in ([0.0, 0.0], [640.0, 480.0], [300.0, 900.0]):
        turn = turn_to_ray(CAMERA, np.array(pixel))
        ray = CAMERA.rays(np.array(pixel))
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(turn @ [0.0, 0.0, 1.0], ray / np.linalg.norm(ray), atol=1e-12)
        axis = np.cross([0.0, 0.0, 1.0], ray)  # no roll: the axis lies in the picture plane
        np.testing.assert_allclose(turn @ axis, axis, atol=1e-9)
