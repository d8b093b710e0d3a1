import numpy as np

from handfit_core.residuals.depth import depth
from handfit_core.residuals.rows import PointRows
from tests.core.residuals.differences import by_each, close, of_own_point, random, unit

POINTS = random(3, 21, 3, scale=0.1) + np.array([0.05, -0.1, 0.6])
TARGET = random(3, 21, seed=1, scale=30.0)
SIGMA = np.abs(random(3, 21, seed=2)) + 1
RAY = unit(random(3, 3, seed=3, scale=0.2) + np.array([0.0, 0.0, 1.0]))
FOCAL = np.array([400.0, 600.0, 900.0])
OFFSET = np.array([[0.5], [0.6], [0.7]])
ARGUMENTS = (POINTS, TARGET, SIGMA, RAY, FOCAL, OFFSET)


def of_first(points: np.ndarray = POINTS[:1], offset: np.ndarray = OFFSET[:1]) -> PointRows:
    return depth(points, TARGET[:1], SIGMA[:1], RAY[:1], FOCAL[:1], offset)


def test_residual_on_the_optical_axis() -> None:
    """There, the distance along the ray is z."""
    axis = np.array([[0.0, 0.0, 1.0]])
    rows = depth(POINTS[:1], TARGET[:1], SIGMA[:1], axis, FOCAL[:1], OFFSET[:1])
    expected = (800.0 * (POINTS[0, :, 2] - 0.5) - TARGET[0]) / SIGMA[0]
    close(rows.residual[0, :, 0], expected)


def test_jacobian_by_points_and_by_the_offset() -> None:
    rows = depth(*ARGUMENTS)
    by_points = by_each(lambda x: of_first(points=x).residual[0], POINTS[:1])
    close(rows.jacobian[0], of_own_point(by_points), rtol=1e-6, atol=1e-5)
    by_offset = by_each(lambda o: of_first(offset=o).residual[0], OFFSET[:1])
    assert rows.by_offset is not None
    close(rows.by_offset[0], by_offset, rtol=1e-6, atol=1e-5)


def test_a_twice_as_large_hand_at_twice_the_distance_looks_the_same() -> None:
    """The detector's depth has no zero and no metres of its own."""
    moved = depth(2 * POINTS, *ARGUMENTS[1:5], 2 * OFFSET)
    close(moved.residual, depth(*ARGUMENTS).residual)


def test_an_offset_behind_the_camera_stays_finite() -> None:
    near = np.full((1, 1), -0.1)
    rows = of_first(offset=near)
    by_offset = by_each(lambda o: of_first(offset=o).residual[0], near)
    assert rows.by_offset is not None
    assert np.isfinite(rows.residual).all()
    close(rows.by_offset[0], by_offset, rtol=1e-6, atol=1e-4)


def test_a_point_behind_the_camera_is_as_good_as_any() -> None:
    behind = POINTS.copy()
    behind[0, 3, 2] = -0.4
    rows = depth(behind, *ARGUMENTS[1:])
    assert np.isfinite(rows.residual).all()
    assert np.isfinite(rows.jacobian).all()


def test_batch_equals_loop() -> None:
    whole = depth(*ARGUMENTS)
    for i in range(3):
        one = depth(*(a[i : i + 1] for a in ARGUMENTS))
        close(whole.residual[i], one.residual[0])
        close(whole.jacobian[i], one.jacobian[0])
