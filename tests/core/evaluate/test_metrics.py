"""Errors, shares and jitter against loops, closed forms and SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import procrustes

from handfit_core.evaluate import metrics
from handfit_core.evaluate.metrics import PCK_THRESHOLDS_MM, jitter_spectrum
from handfit_core.geometry.rotations import rotvec_to_rotmat
from tests.core.evaluate.made import make_hands

RNG = np.random.default_rng(11)
FPS = 25.0
FRAMES = 100
TIMES = np.arange(FRAMES) / FPS


def noisy_pair() -> tuple[np.ndarray, np.ndarray]:
    truth = 1000.0 * make_hands(1, seed=4)[0]
    points = truth + RNG.normal(scale=5.0, size=truth.shape) + [30.0, -10.0, 80.0]
    truth[[3, 17]] = np.nan
    truth[9, 2] = np.nan  # one unknown coordinate makes the point unlabelled
    return points, truth


def test_similarity_alignment_agrees_with_scipy() -> None:
    truth, points = RNG.normal(size=(2, 21, 3))
    points += 3.0 * truth  # near enough for no reflection to be better
    # SciPy's disparity is the squared error after both were centred and scaled to norm 1.
    centred = truth - truth.mean(axis=0)
    _, _, disparity = procrustes(truth, points)
    found = metrics.similarity_aligned_distances(points, truth)
    assert np.sum(found**2) == pytest.approx(disparity * np.sum(centred**2))


def test_similarity_alignment_undoes_a_similarity_and_no_mirror() -> None:
    truth = make_hands(1)[0]
    rotation = rotvec_to_rotmat(np.array([0.4, -2.0, 1.0]))
    moved = 0.3 * truth @ rotation.T + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(metrics.similarity_aligned_distances(moved, truth), 0.0, atol=1e-12)
    mirrored = truth * [-1.0, 1.0, 1.0]
    assert metrics.similarity_aligned_distances(mirrored, truth).mean() > 0.005


@pytest.mark.parametrize(
    "distances",
    [
        metrics.camera_distances,
        metrics.centroid_aligned_distances,
        metrics.root_aligned_distances,
        metrics.similarity_aligned_distances,
    ],
)
def test_a_batch_equals_a_loop(distances) -> None:
    truth = make_hands(6).reshape(2, 3, 21, 3).copy()
    points = truth + 0.01 * RNG.normal(size=truth.shape)
    truth[0, 1, 5:9] = np.nan
    truth[1, 2, 1:] = np.nan
    found = distances(points, truth)
    assert found.shape == (2, 3, 21)
    for i in range(2):
        for j in range(3):
            np.testing.assert_array_equal(found[i, j], distances(points[i, j], truth[i, j]))


def test_2d_error_is_over_the_longer_side_of_the_box() -> None:
    truth = np.array([[100.0, 100], [300, 150], [200, 180], [np.nan, np.nan]])
    points = truth + [3.0, 4.0]
    points[3] = 0.0
    np.testing.assert_allclose(metrics.distances_2d(points, truth), [5 / 200, 5 / 200, 5 / 200, np.nan])
    np.testing.assert_allclose(metrics.distances_2d(10 * points, 10 * truth)[:3], 5 / 200)
    truth[1:] = truth[0]  # in one place, without a size
    assert np.isnan(metrics.distances_2d(points, truth)).all()


def test_meshes_of_different_topology_are_aligned_by_their_labelled_joints() -> None:
    points, truth_points = noisy_pair()
    truth_points[:] = 2.0 * points + 7.0
    truth_points[4] = np.nan
    vertices = RNG.normal(size=(30, 3))
    found = metrics.aligned_vertices(vertices, points, truth_points)
    np.testing.assert_allclose(found, 2.0 * vertices + 7.0)
    assert np.isnan(metrics.aligned_vertices(vertices, np.full((21, 3), np.nan), points)).all()
    truth_points[3:] = np.nan
    assert np.isnan(metrics.aligned_vertices(vertices, points, truth_points)).all()


def test_f_score_by_brute_force() -> None:
    vertices, truth = RNG.normal(size=(40, 3)), RNG.normal(size=(25, 3))
    for threshold in (0.2, 0.6, 1.5):
        precision = np.mean([min(math.dist(v, t) for t in truth) < threshold for v in vertices])
        recall = np.mean([min(math.dist(v, t) for v in vertices) < threshold for t in truth])
        expected = 2 / (1 / precision + 1 / recall) if precision and recall else 0.0
        assert metrics.f_score(vertices, truth, threshold) == pytest.approx(expected)
    assert math.isnan(metrics.f_score(np.full((30, 3), np.nan), truth, 1.0))


def test_pck_counts_points_and_misses() -> None:
    errors = np.array([[10.0, 20.0], [30.0, np.nan]])
    thresholds = np.array([5.0, 20.0, 29.0, 30.0])
    np.testing.assert_allclose(metrics.pck_curve(errors, thresholds), [0, 2 / 3, 2 / 3, 1])
    np.testing.assert_allclose(metrics.pck_curve(errors, thresholds, misses=3), [0, 2 / 6, 2 / 6, 3 / 6])
    assert np.isnan(metrics.pck_curve(np.full((2, 2), np.nan), thresholds)).all()
    np.testing.assert_array_equal(metrics.pck_curve(np.full((2, 2), np.nan), thresholds, misses=5), 0.0)


def test_auc_has_closed_forms() -> None:
    thresholds = PCK_THRESHOLDS_MM
    assert (thresholds[0], thresholds[-1], len(thresholds)) == (20.0, 50.0, 100)
    assert metrics.auc(np.ones(100), thresholds) == pytest.approx(1.0)
    assert metrics.auc(np.linspace(0, 1, 100), thresholds) == pytest.approx(0.5)
    # Errors spread evenly over 0..100 mm: PCK is t/100, whose mean over 20..50 is 0.35.
    even = (np.arange(100_000) + 0.5) / 1000
    assert metrics.auc(metrics.pck_curve(even, thresholds), thresholds) == pytest.approx(0.35, abs=1e-4)


# Clips


def moving_hand(frames: int = FRAMES) -> np.ndarray:
    """(T, 21, 3) metres: a stiff hand that turns and travels."""
    hand = make_hands(1)[0]
    turns = rotvec_to_rotmat(np.linspace(0.0, 1.5, frames)[:, None] * [0.2, 1.0, -0.4])
    return np.einsum("tij,pj->tpi", turns, hand) + np.linspace(0, 0.2, frames)[:, None, None]


def swaying(hz: float, millimetres: float) -> np.ndarray:
    """(T, 21, 3) an error of that frequency on every point but the wrist."""
    wave = np.zeros((FRAMES, 21, 3))
    wave[:, 1:, 0] = millimetres / 1000.0 * np.sin(2 * np.pi * hz * TIMES)[:, None]
    return wave


def test_jitter_rises_with_noise_and_not_with_a_smooth_error() -> None:
    truth = moving_hand()
    noise = 0.001 * RNG.normal(size=truth.shape)
    alone = jitter_spectrum(truth + noise, truth, FPS)
    drift = np.linspace(-0.03, 0.03, FRAMES)[:, None, None] * RNG.normal(size=(1, 21, 3))
    smooth = 0.02 * RNG.normal(size=(1, 21, 3)) + swaying(0.7, 20.0) + drift
    assert jitter_spectrum(truth + smooth, truth, FPS) < 1e-5
    assert jitter_spectrum(truth + noise + smooth, truth, FPS) == pytest.approx(alone, rel=0.01)
    assert jitter_spectrum(truth + 3 * noise, truth, FPS) == pytest.approx(3 * alone)


def test_jitter_needs_long_runs_and_a_high_rate() -> None:
    truth = moving_hand()
    points = truth + swaying(8.0, 3.0)
    assert math.isnan(jitter_spectrum(points, truth, 10.0))
    assert math.isnan(jitter_spectrum(points[:24], truth[:24], FPS))
    points[::20] = np.nan
    assert math.isnan(jitter_spectrum(points, truth, FPS))
