"""Rest and motion in depth: what rests holds still, what moves keeps its size and its time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.detect.keypoints import HandDetection, Track
from handfit_core.fit.fast import fit_track
from handfit_core.fit.settings import MOTION
from handfit_core.fit.stationary import palm_motion_scale, wrist_distance_factors
from handfit_core.hand_model.chain import State
from tests.core.fit.detections import CAMERA, landmarks_of, model_of, poses, seen, track_of
from tests.core.fit.hands import chain_of, make_state, observe, repeated

FPS = 25.0
COUNT = 100
TIME = np.arange(COUNT) / FPS
DRAWS = range(3)
AWAY = 0.6
"""metres"""


def wobble(seed: int) -> np.ndarray:
    """(T,) by what the size of a resting hand seems to grow, as detections do: slowly, and 0.4 % of it."""
    rng = np.random.default_rng([seed, 1])
    values = np.zeros(COUNT)
    for t in range(1, COUNT):
        values[t] = 0.9 * values[t - 1] + np.sqrt(1.0 - 0.9**2) * rng.normal()
    return 0.004 * values


def detected(seed: int, depth: np.ndarray, closing: np.ndarray, error: float = 0.0) -> Track:
    """A hand `depth` (T,) metres farther along the line of sight and `closing` (T,) times as bent, which
    seems smaller by a part of `error` as it closes. Landmarks jitter by 0.6 pixels."""
    betas, orient, pose, transl = (np.repeat(rows, COUNT, axis=0) for rows in poses(1, seed=4))
    transl = transl * AWAY / transl[:, 2:] * (1.0 + depth[:, None] / AWAY)
    points = landmarks_of("right", betas, orient, closing[:, None] * pose, transl)
    size = 1.0 + wobble(seed) - error * (closing - closing.min())
    detections = []
    for t in range(COUNT):
        one = seen(points[t], "right", noise=0.6, seed=1000 * seed + t)
        keypoints = one.keypoints[0] + size[t] * (one.keypoints - one.keypoints[0])
        detections.append(HandDetection(one.side, one.score, keypoints, one.world))
    return track_of("right", detections, FPS)


def found(track: Track, smoothing: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The wrist's distance (T,) in metres, and the poses (T, 45)."""
    model = model_of("right")
    fit = fit_track(smoothing, model, track, CAMERA, lambda: None)
    wrist = fit.transl + model.shaped(fit.betas).joints[0]
    return np.linalg.norm(wrist, axis=1), fit.hand_pose


def swing(values: np.ndarray, hertz: float) -> complex:
    """Amplitude and phase of what swings at that frequency."""
    columns = [np.sin(2 * np.pi * hertz * TIME), np.cos(2 * np.pi * hertz * TIME), np.ones(COUNT), TIME]
    sine, cosine, *_ = np.linalg.lstsq(np.stack(columns, axis=1), values, rcond=None)[0]
    return complex(sine, cosine)


def step(distance: np.ndarray) -> float:
    """95th percentile of the steps from frame to frame, metres."""
    return float(np.percentile(np.abs(np.diff(distance)), 95))


RESTING, OPEN = np.zeros(COUNT), np.ones(COUNT)
CLOSING = 1.0 + 0.8 * np.clip(np.sin(2 * np.pi * 0.6 * TIME) * 3.0, -1.0, 1.0)
"""Fingers that close quickly, rest, and open again"""


def test_a_resting_hand_holds_still() -> None:
    tracks = [detected(seed, RESTING, OPEN) for seed in DRAWS]
    steps = np.array([[step(found(track, s)[0]) for s in (0.0, 1.0)] for track in tracks])
    alone, over_time = steps.mean(axis=0)
    assert alone > 0.003  # metres
    assert over_time < 0.001


def test_resting_wrist_with_moving_fingers() -> None:
    """Though the hand seems 8 % smaller when it is closed; the fingers keep their motion."""
    tracks = [detected(seed, RESTING, CLOSING, 0.05) for seed in DRAWS]
    results = [(found(track, 0.0), found(track)) for track in tracks]
    swings = np.mean([[abs(swing(each[0], 0.6)) for each in pair] for pair in results], axis=0)
    assert swings[0] > 0.010  # metres
    assert swings[1] < 0.3 * swings[0]
    assert np.mean([step(over_time[0]) for _, over_time in results]) < 0.0015
    bends = np.mean([[abs(swing(each[1].mean(axis=1), 0.6)) for each in pair] for pair in results], axis=0)
    assert bends[1] > 0.95 * bends[0]


@pytest.mark.parametrize(("hertz", "size"), [(0.5, 0.05), (1.0, 0.03), (1.0, 0.05), (2.0, 0.05)])
def test_motion_in_depth(hertz: float, size: float) -> None:
    depth = size * np.sin(2 * np.pi * hertz * TIME)
    gains = []
    for seed in DRAWS:
        distance, _ = found(detected(seed, depth, OPEN))
        gains.append(swing(distance, hertz) / size * AWAY / distance.mean())
    assert 0.9 < np.abs(gains).mean() < 1.1
    assert np.abs(np.angle(gains)).mean() < np.radians(4.0)


def reach(seed: int) -> tuple[State, np.ndarray]:
    """A hand that closes and reaches forward, as single frames see it, and its true distance."""
    rng = np.random.default_rng(seed)
    away = AWAY + 0.08 * np.sin(2 * np.pi * 0.4 * TIME)
    state = repeated(make_state(1, chain_of()), COUNT)
    noise = np.exp(0.003 * rng.normal(size=COUNT) + wobble(seed))
    bend = np.tile([0.0, 0.0, 0.3], 15).reshape(5, 9) * CLOSING[:, None, None]
    wrist = np.array([0.05, -0.02, 1.0]) * (away * noise)[:, None]
    return replace(state, wrist=wrist, angles=state.angles + bend), away


def distances(
    state: State, known: np.ndarray | None = None, certain: np.ndarray | None = None, smoothing: float = 1.0
) -> np.ndarray:
    known = np.ones(COUNT, dtype=bool) if known is None else known
    certain = np.zeros(COUNT, dtype=bool) if certain is None else certain
    return state.wrist[:, 2] * wrist_distance_factors(state, known, certain, FPS, smoothing)


def test_time_has_no_direction() -> None:
    state, _ = reach(0)
    back = distances(state.select(np.arange(COUNT - 1, -1, -1)))[::-1]
    np.testing.assert_allclose(back, distances(state), rtol=1e-6)


def test_what_was_not_seen_does_not_count() -> None:
    state, _ = reach(0)
    known = np.ones(COUNT, dtype=bool)
    known[40:48] = False
    wild = replace(state, wrist=np.where(known[:, None], state.wrist, 3.0 * state.wrist))
    np.testing.assert_allclose(distances(wild, known)[known], distances(state, known)[known], rtol=0.01)


def test_outlier_frames() -> None:
    state, _ = reach(0)
    wild = state.wrist.copy()
    wild[[30, 70]] *= 1.5
    np.testing.assert_allclose(distances(replace(state, wrist=wild)), distances(state), rtol=0.02)


def test_held_wrist() -> None:
    state, _ = reach(0)
    certain = np.zeros(COUNT, dtype=bool)
    certain[20:30] = True
    held = replace(state, wrist=np.where(certain[:, None], state.wrist[25], state.wrist))
    found_at = distances(held, certain=certain)
    np.testing.assert_allclose(found_at[certain], held.wrist[25, 2], rtol=1e-4)
    assert np.abs(np.diff(found_at)).max() < 0.02  # metres; nothing detect_cuts where it begins


def test_more_smoothing_holds_firmer() -> None:
    state = repeated(make_state(1, chain_of()), COUNT)
    state = replace(state, wrist=state.wrist * np.exp(3.0 * wobble(2))[:, None])
    steps = [step(distances(state, smoothing=s)) for s in (0.1, 1.0, 10.0)]
    assert steps[0] > 1.5 * steps[1] > 3.0 * steps[2]


def test_palms_that_hold_still() -> None:
    """Shown as a hand rests, moves, and rests elsewhere."""
    state = repeated(make_state(1, chain_of()), COUNT)
    way = 0.15 * np.clip((TIME - 1.5) / 0.8, 0.0, 1.0)
    state = replace(state, wrist=state.wrist + way[:, None] * [1.0, 0.0, 0.0])
    observed = observe(chain_of().points(state), noise=0.2)
    known = np.ones(COUNT, dtype=bool)
    known[5:8] = False
    moves = palm_motion_scale(observed, known, FPS)
    rests = known & ((TIME < 1.0) | (TIME > 2.8))
    np.testing.assert_array_equal(moves[rests], MOTION.min_scale)
    np.testing.assert_array_equal(moves[(TIME > 1.6) & (TIME < 2.2)], 1.0)
    np.testing.assert_array_equal(moves[~known], 1.0)


@pytest.mark.parametrize("fps", [25.0, 1e5])
def test_not_finite_distances(fps: float) -> None:
    """Too near to be seen, or none at all, in all frames or in one, however many a second."""
    state = repeated(make_state(1, chain_of()), 12)
    everywhere, nowhere = np.ones(12, dtype=bool), np.zeros(12, dtype=bool)
    for near in (slice(None), slice(3, 4)):
        for distance in (0.001, np.nan):
            wrist = state.wrist.copy()
            wrist[near, 2] = distance
            factors = wrist_distance_factors(replace(state, wrist=wrist), everywhere, nowhere, fps, 1.0)
            assert np.isfinite(factors).all()
            if near == slice(None):
                np.testing.assert_array_equal(factors, 1.0)
