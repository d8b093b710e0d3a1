import math

import numpy as np
import pytest

from handfit_core.evaluate.clip_metrics import acceleration_error, bone_length_variation, jitter_spectrum
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.skeleton import KEYPOINT_PARENTS
from tests.core.evaluate.factory import make_hands

FPS = 25.0
FRAMES = 100
TIMES = np.arange(FRAMES) / FPS
RNG = np.random.default_rng(2)


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


def test_a_stiff_hand_has_constant_bones() -> None:
    assert bone_length_variation(moving_hand()) == pytest.approx(0.0, abs=1e-9)


def test_bone_variation_by_a_loop() -> None:
    points = moving_hand(20) + 0.004 * RNG.normal(size=(20, 21, 3))
    points[[3, 11]] = np.nan
    ratios = []
    for point in range(1, 21):
        lengths = [math.dist(f[point], f[KEYPOINT_PARENTS[point]]) for f in points if not np.isnan(f).any()]
        assert len(lengths) == 18
        ratios.append(np.std(lengths) / np.mean(lengths))
    assert bone_length_variation(points) == pytest.approx(100.0 * float(np.mean(ratios)))


@pytest.mark.parametrize("valid", [0, 1])
def test_bone_variation_needs_two_frames(valid: int) -> None:
    points = moving_hand(5)
    points[valid:] = np.nan
    assert math.isnan(bone_length_variation(points))


@pytest.mark.parametrize("even", [True, False])
def test_acceleration_of_a_parabola(even: bool) -> None:
    times = TIMES if even else np.cumsum(RNG.uniform(0.02, 0.06, size=FRAMES))
    truth = moving_hand()
    error = np.zeros_like(truth)
    # x = a t^2 / 2 has acceleration a, also over unequal steps; lengths of (3, 4, 0) are 5.
    error[:, 1:] = (np.array([3.0, 4.0, 0.0]) * (times**2 / 2)[:, None])[:, None, :]
    assert acceleration_error(truth + error, truth, times) == pytest.approx(5.0)


def test_acceleration_by_a_loop_leaves_gaps_out() -> None:
    truth = moving_hand(12)
    points = truth + 0.002 * RNG.normal(size=truth.shape)
    points[4] = np.nan
    truth[9, 7] = np.nan
    values = []
    for t in range(1, 11):
        for p in range(1, 21):
            if 4 in (t - 1, t, t + 1) or (p == 7 and 9 in (t - 1, t, t + 1)):
                continue
            of = [[(x[s][p] - x[s][0]) for s in (t - 1, t, t + 1)] for x in (points, truth)]
            predicted, true = ((a - 2 * b + c) * FPS**2 for a, b, c in of)
            values.append(np.linalg.norm(predicted - true))
    assert acceleration_error(points, truth, TIMES[:12]) == pytest.approx(float(np.mean(values)))


def test_acceleration_ignores_an_offset_and_a_drift_of_the_whole_hand() -> None:
    truth = moving_hand()
    shaken = truth + 0.05 * RNG.normal(size=(FRAMES, 1, 3))
    assert acceleration_error(shaken, truth, TIMES) == pytest.approx(0.0, abs=1e-9)


def test_acceleration_needs_three_frames_and_a_wrist() -> None:
    truth = moving_hand(6)
    gaps = truth.copy()
    gaps[[2, 5]] = np.nan
    assert math.isnan(acceleration_error(gaps, truth, TIMES[:6]))
    assert math.isnan(acceleration_error(truth[:2], truth[:2], TIMES[:2]))
    tips_only = truth.copy()
    tips_only[:, 0] = np.nan
    assert math.isnan(acceleration_error(truth, tips_only, TIMES[:6]))


def test_jitter_of_white_noise_has_its_share_of_the_spectrum() -> None:
    truth = moving_hand()
    noise = 0.002 * RNG.normal(size=truth.shape)
    noise[:, 0] = 0.0
    expected = 0.002 * math.sqrt(3 * 7.5 / 12.5)
    assert jitter_spectrum(truth + noise, truth, FPS) == pytest.approx(expected, rel=0.05)


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
