"""Clips smoothed as a whole: what falls, what is kept, and that nothing lags behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from handfit_core.fit import clips
from handfit_core.fit.clips import smooth_clip
from handfit_core.fit.observation import Observation
from handfit_core.fit.problem import Held, MotionPrior, Problem
from handfit_core.geometry.rotations import euler_to_rotmat, rotvec_to_rotmat
from handfit_core.hand_model.chain import State
from tests.core.fit.differences import close, random
from tests.core.fit.hands import RELAXED, chain_of, observe, problem_of

CHAIN = chain_of()
FPS = 25.0
MOTION = MotionPrior(rotation=9.0 / FPS**2, place=0.75 / FPS**2)
COUNT = 40


def motion_of(times: np.ndarray) -> State:
    """A hand that waves, closes and wanders, at those seconds."""
    count = len(times)
    bend = 0.25 * (1 - np.cos(2 * np.pi * 0.8 * times))
    angles = RELAXED[None] + bend[:, None, None] * np.tile([0.0, 0.0, 1.0], 3)
    turns = np.stack([0.3 * np.sin(2 * times), 0.5 * np.sin(3 * times), 0.6 * np.cos(2.5 * times)], axis=-1)
    wrist = np.stack([0.06 * np.sin(3 * times), 0.04 * np.cos(2 * times), 0.5 + 0.03 * times], axis=-1)
    return State(
        root=rotvec_to_rotmat(turns) @ rotvec_to_rotmat(np.array([1.0, 0.4, -0.2])),
        angles=angles,
        wrist=wrist,
        betas=np.zeros((count, 10)),
        depth_zero=np.full(count, 0.5),
    )


def jittered(state: State, seed: int = 0, turn: float = 0.05, place: float = 0.004) -> State:
    """As single frames come out: each off by itself."""
    rng = np.random.default_rng(seed)
    count = len(state)
    of_hand = np.concatenate(
        [rng.normal(size=(count, 3)) * turn, rng.normal(size=(count, 3)) * place, np.zeros((count, 1))],
        axis=1,
    )
    return state.moved(of_hand, rng.normal(size=(count, 5, 9)) * turn)


@cache
def clip(seed: int = 0) -> tuple[State, Observation, State]:
    """The truth, noisy looks at it, and single frames' noisy poses."""
    truth = motion_of(np.arange(COUNT) / FPS)
    return truth, observe(CHAIN.pose(truth).points, noise=3.0, seed=seed), jittered(truth, seed)


def total_cost(
    seen: Observation, known: np.ndarray, state: State, motion_scale: np.ndarray | None = None
) -> float:
    of_frames = problem_of(CHAIN, seen, "given").blocks(state).cost[known]
    local = euler_to_rotmat(state.angles.reshape(-1, 15, 3))
    rotations = np.concatenate([state.root[:, None], local], axis=1)
    turn, place = acceleration_of(rotations, state.wrist, motion_scale)
    return float(of_frames.sum() + turn / MOTION.rotation**2 + place / MOTION.place**2)


def acceleration_of(
    rotations: np.ndarray, places: np.ndarray, motion_scale: np.ndarray | None
) -> tuple[float, float]:
    """Sums of squares, by SciPy's rotations; the palm's in parts of what `motion_scale` expects."""
    from scipy.spatial.transform import Rotation  # slow to load

    turns = np.swapaxes(rotations[:-1], -1, -2) @ rotations[1:]
    vectors = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_rotvec().reshape(turns.shape[:-1])
    turning = np.diff(vectors, axis=0)
    if motion_scale is not None:
        turning[:, 0] /= motion_scale[1:-1, None]
    return float(np.square(turning).sum()), float(np.square(np.diff(places, 2, axis=0)).sum())


def clip_of(seen: Observation, known: np.ndarray | None = None, motion: MotionPrior = MOTION) -> Problem:
    return replace(problem_of(CHAIN, seen, "given"), motion=motion, observed=known)


def run(
    seen: Observation, start: State, known: np.ndarray | None = None, motion: MotionPrior = MOTION
) -> State:
    return smooth_clip(clip_of(seen, known, motion), start)


def points_of(state: State) -> np.ndarray:
    return CHAIN.pose(state).points


def shape_of(state: State) -> np.ndarray:
    return points_of(state) - state.wrist[:, None]


def test_total_cost_falls() -> None:
    _, seen, start = clip()
    known = np.ones(COUNT, dtype=bool)
    known[[7, 8, 20]] = False
    found = run(seen, start, known)
    assert total_cost(seen, known, found) < 0.2 * total_cost(seen, known, start)


@pytest.mark.parametrize("motion_scale", [None, np.array([1.0, 0.3, 0.05, 0.05, 0.05, 0.1, 0.4, 1.0, 1.0])])
def test_it_is_a_minimum(monkeypatch: pytest.MonkeyPatch, motion_scale: np.ndarray | None) -> None:
    """No small change of any kind lowers the total cost; also where the palm holds still."""
    monkeypatch.setattr(clips, "SOLVER", replace(clips.SOLVER, clip_iterations=20, clip_tolerance=1e-9))
    _, seen, start = clip()
    part = np.arange(9)
    known = np.array([True, True, True, False, True, True, True, True, True])
    found = smooth_clip(
        replace(clip_of(seen.select(part), known), motion_scale=motion_scale), start.select(part)
    )
    least = total_cost(seen.select(part), known, found, motion_scale)
    for seed in range(6):
        for size in (1e-2, 1e-3):
            other = jittered(found, seed, turn=size, place=size / 10)
            assert total_cost(seen.select(part), known, other, motion_scale) > least
    # One joint of one frame, each way: the slope is zero.
    for frame, joint in [(0, 3), (3, 20), (5, 44)]:
        change = np.zeros((9, 5, 9))
        change.reshape(9, 45)[frame, joint] = 1e-4
        still = np.zeros((9, 7))
        moved = [found.moved(still, s * change) for s in (1.0, -1.0)]
        costs = [total_cost(seen.select(part), known, m, motion_scale) for m in moved]
        curve = sum(costs) - 2 * least
        assert abs(costs[0] - costs[1]) < 0.2 * curve


def test_constant_velocity_is_kept() -> None:
    """Even turning, straight movement and exact looks: where there is nothing to smooth, nothing changes."""
    count = 12
    still = motion_of(np.zeros(count))
    turn = rotvec_to_rotmat(np.arange(count)[:, None] * np.array([0.02, 0.03, -0.01]))
    truth = replace(
        still,
        root=still.root @ turn,
        wrist=still.wrist + (np.arange(count)[:, None] * np.array([0.004, -0.002, 0.003])),
    )
    # Relaxed hands within their limits, but for the prior and coupling exactly explained: start there.
    seen = observe(CHAIN.pose(truth).points, sigma=0.05)
    found = run(seen, truth)
    assert np.abs(points_of(found) - points_of(truth)).max() < 2e-4  # metres


def test_error_against_the_truth_falls() -> None:
    """On average over several draws of the noise. The error counts but for where the wrist is: that of its
    depth is common to a clip's frames, so that smoothing makes it steady and not small."""
    errors, jitters = [], []
    for seed in range(8):
        truth, seen, start = clip(seed)
        # The other motion is as good as no smoothing.
        found = [run(seen, start, motion=m) for m in (MOTION, MotionPrior(1e3, 1e3))]
        off = [shape_of(f) - shape_of(truth) for f in found]
        errors.append([np.linalg.norm(o, axis=-1).mean() for o in off])
        moved = [*off, *(f.wrist - truth.wrist for f in found)]
        jitters.append([np.linalg.norm(np.diff(m, 2, axis=0), axis=-1).mean() for m in moved])
    smooth, each = np.mean(errors, axis=0)
    assert smooth < 0.9 * each
    shape, shape_of_each, wrist, wrist_of_each = np.mean(jitters, axis=0)
    assert shape < 0.1 * shape_of_each
    assert wrist < 0.1 * wrist_of_each


def test_more_smoothing_is_smoother() -> None:
    _, seen, start = clip()
    rough = [
        np.linalg.norm(np.diff(points_of(run(seen, start, motion=m)), 2, axis=0), axis=-1).mean()
        for m in (MotionPrior(1e3, 1e3), MOTION, MotionPrior(MOTION.rotation / 5, MOTION.place / 5))
    ]
    assert rough[0] > rough[1] > rough[2]


def test_no_lag() -> None:
    """The found velocity matches the true one best without any shift, to a twentieth of a frame.

    The hand is still at both ends, so that nothing comes into a shifted sum or leaves it.
    """
    times = np.arange(COUNT) / FPS
    still = motion_of(np.zeros(COUNT))
    bump = np.exp(-0.5 * ((times - 0.6) / 0.12) ** 2) - 0.7 * np.exp(-0.5 * ((times - 0.95) / 0.08) ** 2)
    truth = replace(
        still,
        root=still.root @ (rotvec_to_rotmat(bump[:, None] * np.array([0.3, 0.4, -0.2]))),
        wrist=still.wrist + (bump[:, None] * np.array([0.06, -0.04, 0.02])),
    )
    seen = observe(CHAIN.pose(truth).points)
    true = np.diff(points_of(truth), axis=0).reshape(COUNT - 1, -1)
    for motion in (MOTION, MotionPrior(MOTION.rotation / 4, MOTION.place / 4)):
        found = np.diff(points_of(run(seen, truth, motion=motion)), axis=0).reshape(COUNT - 1, -1)
        shifts = np.arange(-4, 5)
        match = np.array([(np.roll(found, s, axis=0) * true).sum() for s in shifts])
        best = int(match.argmax())
        assert shifts[best] == 0
        before, at, after = match[best - 1 : best + 2]
        assert abs(0.5 * (before - after) / (before - 2 * at + after)) < 0.05
        # A running mean over the last five frames, on the other hand, lags by two.
        mean = np.stack([np.roll(true, s, axis=0) for s in range(5)]).mean(axis=0)
        late = [(np.roll(mean, -s, axis=0) * true).sum() for s in shifts]
        assert shifts[int(np.argmax(late))] == 2


def test_time_has_no_direction() -> None:
    """The reversed clip gives the reversed result."""
    _, seen, start = clip()
    known = np.ones(COUNT, dtype=bool)
    known[[4, 11, 12, 13]] = False
    back = np.arange(COUNT - 1, -1, -1)
    ahead = run(seen, start, known)
    behind = run(seen.select(back), start.select(back), known[::-1].copy())
    np.testing.assert_allclose(points_of(behind)[::-1], points_of(ahead), atol=1e-7)


def test_undetected_frames() -> None:
    """Whatever stands in `seen` there is not looked at."""
    truth, seen, start = clip()
    known = np.ones(COUNT, dtype=bool)
    known[15:20] = False
    found = run(seen, start, known)
    elsewhere = 1e3 * random(*seen.pixels.shape)
    wild = replace(seen, pixels=np.where(known[:, None, None], seen.pixels, elsewhere))
    close(run(wild, start, known).angles, found.angles, atol=1e-9, rtol=0)
    error = np.linalg.norm(points_of(found) - points_of(truth), axis=-1).mean(axis=1)
    seen_throughout = np.linalg.norm(points_of(run(seen, start)) - points_of(truth), axis=-1).mean(axis=1)
    # A fifth of a second without a look costs little.
    assert error[~known].mean() < seen_throughout[~known].mean() + 0.008


@pytest.mark.parametrize("count", [29, 30, 40])
def test_windows_agree_with_the_whole(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Also where the last window is short."""
    truth, _, _ = clip()
    part = np.arange(count)
    # Sharp looks: what happens eight frames on has hardly any influence, as with real overlaps.
    seen, start = observe(CHAIN.pose(truth).points, noise=1.0, sigma=1.0).select(part), truth.select(part)
    monkeypatch.setattr(clips, "SOLVER", replace(clips.SOLVER, clip_iterations=30, clip_tolerance=1e-9))
    whole = run(seen, start)
    monkeypatch.setattr(clips, "SOLVER", replace(clips.SOLVER, window_frames=12))
    calls = []
    window = clips._window
    monkeypatch.setattr(clips, "_window", lambda *a: calls.append(len(a[1])) or window(*a))
    found = run(seen, start, motion=replace(MOTION, overlap=16))
    assert len(calls) == -(-(count - 16) // 12)
    difference = np.linalg.norm(points_of(found) - points_of(whole), axis=-1)
    assert difference.max() < 2e-3  # metres
    assert difference.mean() < 2e-4


@pytest.mark.parametrize(("window", "windows"), [(600, 1), (12, 2)])
def test_before_each_is_called(monkeypatch: pytest.MonkeyPatch, window: int, windows: int) -> None:
    monkeypatch.setattr(clips, "SOLVER", replace(clips.SOLVER, window_frames=window, clip_tolerance=0.0))
    _, seen, start = clip()
    solve, done, asked = clips._solve, [], []
    monkeypatch.setattr(clips, "_solve", lambda *a: done.append(1) or solve(*a))
    motion = replace(MOTION, overlap=16)

    def smoothing(before_each: Callable[[], None]) -> None:
        smooth_clip(clip_of(seen, motion=motion), start, before_each)

    smoothing(lambda: asked.append(len(done)))
    whole = windows * clips.SOLVER.clip_iterations
    assert len(done) == whole
    assert len(asked) == whole + windows
    assert set(asked) == set(range(whole))

    def stop_at_the_second_iteration() -> None:
        if len(done) == whole + 1:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        smoothing(stop_at_the_second_iteration)
    assert len(done) == whole + 1


def test_one_or_two_frames() -> None:
    _, seen, start = clip()
    for count in (1, 2):
        part = np.arange(count)
        found = run(seen.select(part), start.select(part))
        close(found.angles, start.angles[:count])


def test_shape_is_not_touched() -> None:
    _, seen, start = clip()
    betas = np.tile(np.linspace(-1, 1, 10), (COUNT, 1))
    found = run(seen, replace(start, betas=betas))
    close(found.betas, betas)


@pytest.mark.parametrize("window", [600, 12])
def test_held_variables(monkeypatch: pytest.MonkeyPatch, window: int) -> None:
    monkeypatch.setattr(clips, "SOLVER", replace(clips.SOLVER, window_frames=window))
    _, seen, start = clip()
    joints = np.zeros((COUNT, 16), dtype=bool)
    joints[:, [1, 2, 15]] = True
    joints[10:20, 0] = True
    held = Held(joints, start)
    found = smooth_clip(replace(clip_of(seen, motion=replace(MOTION, overlap=16)), held=held), start)
    close(held.put(found).angles, found.angles, atol=1e-9, rtol=0)
    close(found.root[10:20], start.root[10:20], atol=1e-9, rtol=0)
    assert np.array_equal(found.wrist[10:20], start.wrist[10:20])
    # Thumb 13, 14, 15 and index 1, 2, 3 come first.
    moved = np.abs(found.angles - start.angles).reshape(COUNT, 5, 3, 3).max(axis=(0, 3))
    assert (moved[:2] > 1e-3).tolist() == [[True, True, False], [False, False, True]]
    assert (found.wrist[:10] != start.wrist[:10]).all()
    known = np.ones(COUNT, dtype=bool)
    assert total_cost(seen, known, found) < 0.7 * total_cost(seen, known, start)
