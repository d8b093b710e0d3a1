import numpy as np
import pytest

from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.geometry.similarity import align

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("scale", [0.01, 1.0, 250.0])
def test_recovers_a_similarity(scale):
    points = RNG.normal(size=(21, 3))
    rotation = rotvec_to_rotmat(RNG.normal(size=3))
    target = scale * points @ rotation.T + [1.0, -2.0, 3.0]
    found = align(points, target, with_scale=True)
    assert found.scale == pytest.approx(scale)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-10)
    np.testing.assert_allclose(found.apply(points), target, atol=1e-9 * max(scale, 1))
    np.testing.assert_allclose(found.inverse().apply(target), points, atol=1e-9)
    homogeneous = np.column_stack([points, np.ones(21)]) @ found.matrix.T
    np.testing.assert_allclose(homogeneous[:, :3], found.apply(points))


def test_rigid_keeps_the_size():
    points = RNG.normal(size=(6, 3))
    found = align(points, 3.0 * points, with_scale=False)
    assert found.scale == 1.0
    np.testing.assert_allclose(found.rotation, np.eye(3), atol=1e-12)


def test_never_mirrors():
    points = RNG.normal(size=(21, 3))
    found = align(points, points * [-1.0, 1.0, 1.0], with_scale=True)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_flat_and_degenerate_sets():
    flat = np.column_stack([RNG.normal(size=(6, 2)), np.zeros(6)])
    rotation = rotvec_to_rotmat(np.array([0.3, -1.0, 0.4]))
    np.testing.assert_allclose(align(flat, flat @ rotation.T, with_scale=True).rotation, rotation, atol=1e-10)
    point = np.ones((6, 3))
    found = align(point, point + 1, with_scale=True)
    np.testing.assert_allclose(found.apply(point), point + 1)
