"""Rest and motion in depth: what rests holds still, what moves keeps its size and its time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from handfit_core.detect.keypoints import Track
from handfit_core.fit.fast import fit_track
from handfit_core.fit.stationary import wrist_distance_factors
from handfit_core.hand_model.chain import State
from tests.core.fit.detections import CAMERA, landmarks_of, model_of, poses, seen, track_of
from tests.core.fit.differences import random
from tests.core.fit.hands import chain_of, make_state, repeated

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
        wrist = one.keypoints[:, :1]
        detections.append(replace(one, keypoints=wrist + size[t] * (one.keypoints - wrist)))
    return track_of("right", detections, FPS)


def found(track: Track, smoothing: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The wrist's distance (T,) in metres, and the fingers' mean rotations (T,)."""
    model = model_of("right")
    fit = fit_track(smoothing, model, track, CAMERA, lambda: None)
    wrist = fit.transl + model.shaped(fit.betas).joints[0]
    return np.linalg.norm(wrist, axis=1), fit.hand_pose.mean(axis=1)


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
    alone, over_time = (np.mean([step(found(track, s)[0]) for track in tracks]) for s in (0.0, 1.0))
    assert alone > 0.003  # metres
    assert over_time < 0.001


def test_resting_wrist_with_moving_fingers() -> None:
    """Though the hand seems 8 % smaller when it is closed; the fingers keep their motion."""
    tracks = [detected(seed, RESTING, CLOSING, 0.05) for seed in DRAWS]
    results = np.array([[found(track, s) for s in (0.0, 1.0)] for track in tracks])
    swings = np.abs(np.apply_along_axis(swing, -1, results, 0.6)).mean(axis=0)  # (2 smoothings, 2)
    assert swings[0, 0] > 0.010  # metres
    assert swings[1, 0] < 0.3 * swings[0, 0]
    assert np.mean([step(distance) for distance in results[:, 1, 0]]) < 0.0015
    assert swings[1, 1] > 0.95 * swings[0, 1]


@pytest.mark.parametrize(("hertz", "size"), [(0.5, 0.05), (1.0, 0.03), (2.0, 0.05)])
def test_motion_in_depth(hertz: float, size: float) -> None:
    depth = size * np.sin(2 * np.pi * hertz * TIME)
    distances = [found(detected(seed, depth, OPEN))[0] for seed in DRAWS]
    gains = [swing(distance, hertz) / size * AWAY / distance.mean() for distance in distances]
    assert 0.9 < np.abs(gains).mean() < 1.1
    assert np.abs(np.angle(gains)).mean() < np.radians(4.0)


def reach() -> State:
    """A hand that closes and reaches forward, as single frames see it."""
    away = AWAY + 0.08 * np.sin(2 * np.pi * 0.4 * TIME)
    state = repeated(make_state(1, chain_of()), COUNT)
    noise = np.exp(0.003 * random(COUNT) + wobble(0))
    bend = np.tile([0.0, 0.0, 0.3], 15).reshape(5, 9) * CLOSING[:, None, None]
    wrist = np.array([0.05, -0.02, 1.0]) * (away * noise)[:, None]
    return replace(state, wrist=wrist, angles=state.angles + bend)


def distances(state: State, smoothing: float = 1.0, known: Any = True, certain: Any = False) -> np.ndarray:
    known, certain = (np.full(COUNT, at) for at in (known, certain))
    return state.wrist[:, 2] * wrist_distance_factors(state, known, certain, FPS, smoothing)


def test_what_does_not_count() -> None:
    """Frames without a detection, and such as are far off all others."""
    state, known = reach(), (np.arange(COUNT) < 40) | (np.arange(COUNT) > 47)
    wild = replace(state, wrist=np.where(known[:, None], state.wrist, 3.0 * state.wrist))
    unseen = (distances(each, known=known)[known] for each in (wild, state))
    np.testing.assert_allclose(*unseen, rtol=0.01)
    state.wrist[[30, 70]] *= 1.5
    np.testing.assert_allclose(distances(state), distances(reach()), rtol=0.02)


def test_held_wrist() -> None:
    state, certain = reach(), (np.arange(COUNT) >= 20) & (np.arange(COUNT) < 30)
    state.wrist[certain] = state.wrist[25]
    found_at = distances(state, certain=certain)
    np.testing.assert_allclose(found_at[certain], state.wrist[25, 2], rtol=1e-4)
    assert np.abs(np.diff(found_at)).max() < 0.02  # metres; nothing jumps where it begins


@pytest.mark.parametrize("fps", [25.0, 1e5])
@pytest.mark.parametrize("distance", [0.001, np.nan])
def test_not_finite_distances(distance: float, fps: float) -> None:
    """Too near to be seen, or none at all, in all frames or in one, however many a second."""
    for rows in (slice(None), slice(3, 4)):
        state = repeated(make_state(1, chain_of()), 12)
        state.wrist[rows, 2] = distance
        factors = wrist_distance_factors(state, np.full(12, True), np.full(12, False), fps, 1.0)
        assert np.isfinite(factors).all()
        assert rows == slice(3, 4) or (factors == 1.0).all()
