"""The offset in time between a captured wrist and a character's hand."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.common.errors import OptionError
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.retarget.time_offset import WristMotion, _correlations, find_offset

FPS = 30.0


def wandering(rng: np.random.Generator, count: int, frames: float) -> np.ndarray:
    """(count, 3) smooth noise of unit size that changes within so many frames."""
    times = np.arange(count)
    knots = np.arange(-1, count / frames + 2) * frames
    values = rng.normal(size=(len(knots), 3))
    weights = np.exp(-0.5 * ((times[:, None] - knots) / (0.6 * frames)) ** 2)
    found = weights @ values
    return found / found.std()


def filmed(rng: np.random.Generator, turns: np.ndarray, places: np.ndarray, noise: float = 1.0):
    """What a camera that stands anywhere captures of it: it shakes, the distance is bad, and some frames are
    wrong."""
    count, camera = len(turns), rotvec_to_rotmat(rng.normal(size=3))
    shaking = np.radians(3.0) * noise * wandering(rng, count, 2.0)
    shaking[rng.random(count) < 0.01 * noise] += 1.0
    away = 0.02 * noise * wandering(rng, count, 6.0) * [0.2, 0.2, 1.0]
    return camera @ turns @ rotvec_to_rotmat(shaking), places @ camera.T + away


@pytest.mark.parametrize("first", [1, 150, 480])
@pytest.mark.parametrize("noise", [0.0, 1.0, 2.0])
def test_a_slice_is_found_where_it_was_cut_out(first, noise):
    """Also where only a part of it lies in the body's motion, and whatever the numbers are."""
    rng = np.random.default_rng(first)
    turns, places = rotvec_to_rotmat(0.5 * wandering(rng, 700, 12.0)), 0.1 * wandering(rng, 700, 14.0)
    some = slice(first, first + 180)
    captured = WristMotion(7, *filmed(rng, turns[some], places[some], noise))
    own = WristMotion(-20, turns[:600], places[:600])
    found = find_offset([(captured, own)], FPS)
    assert abs(found.frames - (first - 20 - 7)) <= 1
    assert found.sure > 0.3
    doubt = "for sure" if found.sure >= 0.5 else "perhaps"
    assert f"{found.frames} frames, {doubt}" in found.said


def test_two_hands_help_each_other():
    """One of them rests; noise of the captured one would fit anywhere."""
    rng = np.random.default_rng(3)
    pairs = []
    for size in (0.02, 0.5):
        turns, places = rotvec_to_rotmat(size * wandering(rng, 400, 12.0)), size * wandering(rng, 400, 14.0)
        ours = filmed(rng, turns[90:210], places[90:210])
        pairs.append((WristMotion(1, *ours), WristMotion(1, turns, places)))
    assert abs(find_offset(pairs, FPS).frames - 90) <= 1


def test_motions_that_have_nothing_in_common_are_not_sure():
    for seed in range(8):
        rng = np.random.default_rng(seed)
        one, other = (
            WristMotion(
                1, rotvec_to_rotmat(0.5 * wandering(rng, count, 12.0)), 0.1 * wandering(rng, count, 14.0)
            )
            for count in (180, 600)
        )
        assert find_offset([(one, other)], FPS).sure < 0.45


def test_what_does_not_move_or_is_nowhere_is_refused():
    rng = np.random.default_rng(1)
    turns, places = rotvec_to_rotmat(wandering(rng, 100, 12.0)), wandering(rng, 100, 14.0)
    moving = WristMotion(1, turns, places)
    still = WristMotion(1, np.broadcast_to(np.eye(3), (100, 3, 3)), np.zeros((100, 3)))
    lost = WristMotion(1, turns, np.where(np.arange(100)[:, None] == 7, np.nan, places))
    short = WristMotion(1, turns[:20], places[:20])
    for pair, why in (
        ((moving, still), "the character's hand does not move"),
        ((still, moving), "the captured wrist does not move"),
        ((moving, lost), "the character's hand is nowhere in some frames"),
        ((short, moving), "the captured wrist moves for 20 frames only"),
    ):
        with pytest.raises(OptionError, match=why):
            find_offset([pair], FPS)


@pytest.mark.parametrize("centred", [False, True])
def test_correlations_are_those_of_the_rows_that_both_have(centred):
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(7, 2)) + 1.0, rng.normal(size=(11, 2)) + 1.0
    if centred:
        a, b = a[:, :1], b[:, :1]
    found = _correlations(a, b, 3, centred=centred)
    for lag in range(-6, 11):
        rows = [t for t in range(7) if 0 <= t + lag < 11]
        x, y = a[rows], b[np.array(rows, dtype=int) + lag]
        if centred and len(rows):
            x, y = x - x.mean(), y - y.mean()
        wanted = (x * y).sum() / np.sqrt((x**2).sum() * (y**2).sum()) if len(rows) >= 3 else 0.0
        assert found[lag + 6] == pytest.approx(wanted, abs=1e-9)
