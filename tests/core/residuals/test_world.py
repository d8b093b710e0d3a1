import numpy as np
import pytest

from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.geometry.similarity import align
from handfit_core.residuals.world import similarity, world
from tests.core.residuals.differences import by_each, close, of_own_point, random

LANDMARKS = random(3, 21, 3, scale=0.05)
TURN = np.array(rotvec_to_rotmat(np.array([[0.3, 2.0, -0.4], [0.0, 0.0, 0.0], [-1.0, 0.2, 3.0]])))
PLACE = np.array([[0.1, 0.2, 0.7], [0.0, 0.0, 0.5], [-0.2, 0.1, 0.9]])
EXACT = 1.3 * LANDMARKS @ TURN.swapaxes(-1, -2) + PLACE[:, None]
POINTS = EXACT + random(3, 21, 3, seed=4, scale=0.004)
SIGMA = np.full((3, 21), 0.01)


def test_similarity_finds_what_was_done() -> None:
    rotation, scale = similarity(LANDMARKS, EXACT)
    close(rotation, TURN, rtol=0, atol=1e-12)
    close(scale, np.full_like(scale, 1.3))


def test_similarity_is_the_one_of_align() -> None:
    rotation, scale = similarity(LANDMARKS, POINTS)
    for i in range(3):
        expected = align(LANDMARKS[i], POINTS[i], with_scale=True)
        np.testing.assert_allclose(rotation[i], expected.rotation, atol=1e-12)
        assert float(scale[i]) == pytest.approx(expected.scale)


def test_similarity_never_mirrors() -> None:
    mirrored = LANDMARKS * np.array([-1.0, 1.0, 1.0])
    rotation, _ = similarity(LANDMARKS, mirrored)
    close(np.linalg.det(rotation), np.ones(3))


def test_similarity_of_collinear_and_of_equal_points_is_a_rotation() -> None:
    line = np.linspace(-1, 1, 21)[:, None] * np.array([0.1, 0.2, 0.3])
    source = np.stack([line, np.zeros_like(line)])
    rotation, scale = similarity(source, np.stack([2 * line[..., ::-1], np.zeros_like(line)]))
    assert np.isfinite(scale).all()
    close(rotation @ rotation.swapaxes(-1, -2), np.eye(3)[None].repeat(2, axis=0))
    close(np.linalg.det(rotation), np.ones(2))
    # What a line's alignment determines is still right.
    close(scale[0] * line @ rotation[0].swapaxes(-1, -2), 2 * line[..., ::-1])


def test_similarity_of_nan_harms_no_other() -> None:
    spoiled = POINTS.copy()
    spoiled[1, 4] = np.nan
    rotation, scale = similarity(LANDMARKS, spoiled)
    whole_rotation, whole_scale = similarity(LANDMARKS, POINTS)
    for i in (0, 2):
        close(rotation[i], whole_rotation[i])
        close(scale[i], whole_scale[i])


def test_residual_is_zero_for_the_same_hand_elsewhere() -> None:
    rows = world(EXACT, LANDMARKS, SIGMA, EXACT.mean(axis=1))
    assert np.abs(rows.residual).max() < 1e-10


def test_jacobian_at_constant_rotation_and_size() -> None:
    """With the alignment held, r = (x - offset - const) / sigma."""
    rows = world(POINTS, LANDMARKS, SIGMA, PLACE)
    rotation, scale = similarity(LANDMARKS, POINTS)
    centred = LANDMARKS - LANDMARKS.mean(axis=1, keepdims=True)

    def held(points: np.ndarray, offset: np.ndarray) -> np.ndarray:
        laid = scale[:1, None, None] * centred[:1] @ rotation[:1].swapaxes(-1, -2)
        return ((points - offset[:, None] - laid) / SIGMA[:1, :, None])[0]

    close(rows.residual[0], held(POINTS[:1], PLACE[:1]))
    by_points = of_own_point(by_each(lambda x: held(x, PLACE[:1]), POINTS[:1]))
    close(rows.jacobian[0], by_points, rtol=1e-6, atol=1e-5)
    assert rows.by_offset is not None
    by_offset = by_each(lambda o: held(POINTS[:1], o), PLACE[:1])
    close(rows.by_offset[0], by_offset, rtol=1e-6, atol=1e-5)


def test_gradient_of_the_cost_is_exact() -> None:
    """Though rotation and size follow the points."""
    rows = world(POINTS, LANDMARKS, SIGMA, PLACE)
    gradient = (rows.residual[0, :, None] @ rows.jacobian[0]).reshape(-1)
    differences = by_each(
        lambda x: np.square(world(x, LANDMARKS[:1], SIGMA[:1], PLACE[:1]).residual).sum() / 2, POINTS[:1]
    )
    close(gradient, differences, rtol=1e-6, atol=1e-4)


def test_batch_equals_loop() -> None:
    whole = world(POINTS, LANDMARKS, SIGMA, PLACE)
    for i in range(3):
        one = world(*(a[i : i + 1] for a in (POINTS, LANDMARKS, SIGMA, PLACE)))
        close(whole.residual[i], one.residual[0])
