"""Clips smoothed as a whole: what falls, what is kept, and that nothing lags behind."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handfit_core.fit import banded, clips
from handfit_core.fit.clips import ClipProblem, MotionPrior, smooth_clip
from handfit_core.fit.observation import Observation
from handfit_core.fit.problem import FixedJoints
from handfit_core.geometry.rotations import euler_to_rotmat, rotvec_to_rotmat
from handfit_core.hand_model.chain import State
from tests.core.fit.differences import close, random
from tests.core.fit.hands import RELAXED, chain_of, observe, problem_of

CHAIN = chain_of()
FPS = 25.0
MOTION = MotionPrior(rotation=9.0 / FPS**2, place=0.75 / FPS**2)
LOOSE = MotionPrior(1e3, 1e3)
"""As good as no smoothing"""
COUNT = 40


def motion_of(times: np.ndarray) -> State:
    """A hand that waves, closes and wanders, at those seconds."""
    count = len(times)
    bend = 0.25 * (1 - np.cos(2 * np.pi * 0.8 * times))
    angles = RELAXED[None] + bend[:, None, None] * np.tile([0.0, 0.0, 1.0], 3)
    turns = np.stack([0.3 * np.sin(2 * times), 0.5 * np.sin(3 * times), 0.6 * np.cos(2.5 * times)], axis=-1)
    wrist = np.stack([0.06 * np.sin(3 * times), 0.04 * np.cos(2 * times), 0.5 + 0.03 * times], axis=-1)
    root = rotvec_to_rotmat(turns) @ rotvec_to_rotmat(np.array([1.0, 0.4, -0.2]))
    return State(root, angles, wrist, np.zeros((count, 10)), np.full(count, 0.5))


def jittered(state: State, seed: int = 0, turn: float = 0.05, place: float = 0.004) -> State:
    """As single frames come out: each off by itself."""
    rng, count = np.random.default_rng(seed), len(state)
    of_hand = np.hstack([rng.normal(size=(count, 6)) * ([turn] * 3 + [place] * 3), np.zeros((count, 1))])
    return state.moved(of_hand, rng.normal(size=(count, 5, 9)) * turn)


@cache
def clip(seed: int = 0) -> tuple[State, Observation, State]:
    """The truth, noisy looks at it, and single frames' noisy poses."""
    truth = motion_of(np.arange(COUNT) / FPS)
    return truth, observe(CHAIN.points(truth), noise=3.0, seed=seed), jittered(truth, seed)


def clip_of(seen: Observation, motion: MotionPrior = MOTION, **fields: Any) -> ClipProblem:
    return ClipProblem(problem_of(CHAIN, seen, "given"), motion, **fields)


def run(seen: Observation, start: State, motion: MotionPrior = MOTION, **fields: Any) -> State:
    return smooth_clip(clip_of(seen, motion, **fields), start)


def total_cost(problem: ClipProblem, state: State) -> float:
    """With the accelerations by SciPy's rotations; the palm's in parts of what `motion_scale` expects."""
    known = np.full(len(state), True) if problem.observed is None else problem.observed
    local = euler_to_rotmat(state.angles.reshape(-1, 15, 3))
    rotations = np.concatenate([state.root[:, None], local], axis=1)
    turns = np.swapaxes(rotations[:-1], -1, -2) @ rotations[1:]
    vectors = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_rotvec().reshape(turns.shape[:-1])
    turning, moving = (
        np.diff(vectors, axis=0) / MOTION.rotation,
        np.diff(state.wrist, 2, axis=0) / MOTION.place,
    )
    if problem.motion_scale is not None:
        turning[:, 0] /= problem.motion_scale[1:-1, None]
    of_frames = replace(problem.frames, fixed=None).blocks(state).cost[known]
    return float(of_frames.sum() + np.square(turning).sum() + np.square(moving).sum())


def accelerations(values: np.ndarray) -> float:
    """Their mean size."""
    return np.linalg.norm(np.diff(values, 2, axis=0), axis=-1).mean()


@pytest.mark.parametrize("scale", [None, np.array([1.0, 0.3, 0.05, 0.05, 0.05, 0.1, 0.4, 1.0, 1.0])])
def test_it_is_a_minimum(monkeypatch: pytest.MonkeyPatch, scale: np.ndarray | None) -> None:
    """No small change of any kind lowers the total cost; also where the palm holds still."""
    monkeypatch.setattr(clips, "SOLVER", replace(clips.SOLVER, clip_iterations=20, clip_min_gain=1e-9))
    _, seen, start = (each.select(slice(9)) for each in clip())
    problem = clip_of(seen, observed=np.arange(9) != 3, motion_scale=scale)
    found = smooth_clip(problem, start)
    least = total_cost(problem, found)
    assert least < 0.2 * total_cost(problem, start)
    for seed in range(6):
        for size in (1e-2, 1e-3):
            assert total_cost(problem, jittered(found, seed, size, size / 10)) > least
    # One joint of one frame, each way: the slope is zero.
    for frame, joint in [(0, 3), (3, 20), (5, 44)]:
        change = np.zeros((9, 45))
        change[frame, joint] = 1e-4
        ways = (found.moved(np.zeros((9, 7)), (s * change).reshape(9, 5, 9)) for s in (1, -1))
        costs = [total_cost(problem, way) for way in ways]
        assert abs(costs[0] - costs[1]) < 0.2 * (sum(costs) - 2 * least)


def test_error_against_the_truth_falls() -> None:
    """On average over several draws of the noise. The error counts but for where the wrist is: that of its
    depth is common to a clip's frames, so that smoothing makes it steady and not small."""
    found = []
    for seed in range(8):
        truth, seen, start = clip(seed)
        for motion in (LOOSE, MOTION):
            state = run(seen, start, motion)
            shapes = [CHAIN.points(each) - each.wrist[:, None] for each in (state, truth)]
            off = shapes[0] - shapes[1]
            error = np.linalg.norm(off, axis=-1).mean()
            found.append([error, accelerations(off), accelerations(state.wrist - truth.wrist)])
    each, smooth = np.reshape(found, (8, 2, 3)).mean(axis=0)
    assert (smooth < np.array([0.9, 0.1, 0.1]) * each).all()


def test_no_lag() -> None:
    """The found velocity matches the true one best without any shift, to a twentieth of a frame.

    The hand is still at both ends, so that nothing comes into a shifted sum or leaves it.
    """
    times = np.arange(COUNT) / FPS
    bump = np.exp(-0.5 * ((times - 0.6) / 0.12) ** 2) - 0.7 * np.exp(-0.5 * ((times - 0.95) / 0.08) ** 2)
    still, share = motion_of(np.zeros(COUNT)), bump[:, None]
    root = still.root @ rotvec_to_rotmat(share * [0.3, 0.4, -0.2])
    truth = replace(still, root=root, wrist=still.wrist + share * [0.06, -0.04, 0.02])
    seen = observe(CHAIN.points(truth))
    rough = [accelerations(CHAIN.points(truth))]
    for motion in (MOTION, MotionPrior(MOTION.rotation / 4, MOTION.place / 4)):
        points = CHAIN.points(run(seen, truth, motion))
        rough.append(accelerations(points))
        found, true = (np.diff(p, axis=0) for p in (points, CHAIN.points(truth)))
        before, at, after = ((np.roll(found, shift, axis=0) * true).sum() for shift in (-1, 0, 1))
        assert at > max(before, after)
        assert abs(0.5 * (before - after) / (before - 2 * at + after)) < 0.05
    assert rough[0] > rough[1] > rough[2]


def test_undetected_frames() -> None:
    """Whatever stands in `seen` there is not looked at."""
    truth, seen, start = clip()
    known = (np.arange(COUNT) < 15) | (np.arange(COUNT) > 19)
    found = run(seen, start, observed=known)
    wild = np.where(known[:, None, None], seen.pixels, 1e3 * random(*seen.pixels.shape))
    close(run(replace(seen, pixels=wild), start, observed=known).angles, found.angles, atol=1e-9, rtol=0)
    gap, throughout = (
        np.linalg.norm(CHAIN.points(state) - CHAIN.points(truth), axis=-1)[~known].mean()
        for state in (found, run(seen, start))
    )
    assert gap < throughout + 0.008  # a fifth of a second without a look costs little


@pytest.mark.parametrize("count", [29, 40])
def test_windows_agree_with_the_whole(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Also where the last window is short."""
    truth = clip()[0].select(slice(count))
    # Sharp looks: what happens eight frames on has hardly any influence, as with real overlaps.
    seen = observe(CHAIN.points(truth), noise=1.0, sigma=1.0)
    monkeypatch.setattr(clips, "SOLVER", replace(clips.SOLVER, clip_iterations=30, clip_min_gain=1e-9))
    whole = run(seen, truth)
    monkeypatch.setattr(banded, "SOLVER", replace(banded.SOLVER, window_frames=12))
    found = run(seen, truth, replace(MOTION, overlap=16))
    difference = np.linalg.norm(CHAIN.points(found) - CHAIN.points(whole), axis=-1)
    assert 0.0 < difference.max() < 2e-3  # metres
    assert difference.mean() < 2e-4


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_frames(count: int) -> None:
    _, seen, start = (each.select(slice(count)) for each in clip())
    close(run(seen, start).angles, start.angles)


@pytest.mark.parametrize("window", [600, 12])
def test_held_variables(monkeypatch: pytest.MonkeyPatch, window: int) -> None:
    """And the shape, which is given."""
    monkeypatch.setattr(banded, "SOLVER", replace(banded.SOLVER, window_frames=window))
    _, seen, start = clip()
    start = replace(start, betas=random(COUNT, 10))
    joints = np.zeros((COUNT, 16), dtype=bool)
    joints[:, [1, 2, 15]] = True
    joints[10:20, 0] = True
    problem = clip_of(seen, replace(MOTION, overlap=16))
    fixed = FixedJoints(joints, start)
    problem = replace(problem, frames=replace(problem.frames, fixed=fixed))
    found = smooth_clip(problem, start)
    close(found.betas, start.betas)
    close(fixed.put(found).angles, found.angles, atol=1e-9, rtol=0)
    close(found.root[10:20], start.root[10:20], atol=1e-9, rtol=0)
    assert np.array_equal(found.wrist[10:20], start.wrist[10:20])
    # Thumb 13, 14, 15 and index 1, 2, 3 come first.
    changed = np.abs(found.angles - start.angles).reshape(COUNT, 5, 3, 3).max(axis=(0, 3))
    assert (changed[:2] > 1e-3).tolist() == [[True, True, False], [False, False, True]]
    assert (found.wrist[:10] != start.wrist[:10]).all()
    assert total_cost(problem, found) < 0.7 * total_cost(problem, start)
