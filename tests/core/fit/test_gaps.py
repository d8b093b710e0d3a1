"""Which gaps are interpolate_gaps, and what stands in them."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.fit.gaps import detect_cuts, interpolate_gaps, missing_between, segments
from handfit_core.fit.settings import MOTION
from handfit_core.geometry.rotations import euler_to_rotmat, rotmat_to_rotvec
from handfit_core.hand_model.chain import State
from handfit_core.skeleton import PALM_KEYPOINTS
from tests.core.fit.differences import close
from tests.core.fit.hands import chain_of, make_state

CHAIN = chain_of()
NOT_PALM = np.setdiff1d(np.arange(21), PALM_KEYPOINTS)


@pytest.mark.parametrize("fps", [5.0, 25.0, 29.97, 60.0])
def test_gaps_up_to_the_limit_are_bridged(fps: float) -> None:
    most = int(MOTION.max_gap_seconds * fps)
    (stretch,) = segments(np.array([3, 4, 4 + most + 1, 4 + most + 2]), fps)
    np.testing.assert_array_equal(stretch, np.arange(3, 4 + most + 3))
    first, second = segments(np.array([3, 4, 4 + most + 2, 4 + most + 3]), fps)
    np.testing.assert_array_equal(first, [3, 4])
    np.testing.assert_array_equal(second, [6 + most, 7 + most])


def test_low_fps_has_no_gaps() -> None:
    assert [list(s) for s in segments(np.array([0, 1, 3]), 1.0)] == [[0, 1], [3]]


def test_every_frame_found_is_one_stretch() -> None:
    (stretch,) = segments(np.arange(7), 25.0)
    np.testing.assert_array_equal(stretch, np.arange(7))
    (single,) = segments(np.array([5]), 25.0)
    np.testing.assert_array_equal(single, [5])


def angles_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(rotmat_to_rotvec(a.swapaxes(-1, -2) @ b), axis=-1)


def local_of(state: State) -> np.ndarray:
    return euler_to_rotmat(state.angles.reshape(-1, 5, 3, 3))


def test_filled_frames_lie_between() -> None:
    ends = make_state(3, CHAIN, seed=4, spread=0.5)
    known = np.array([True, False, False, False, True, False, True])
    state = interpolate_gaps(ends, known)
    assert len(state) == 7
    rows = np.flatnonzero(known)
    for name in State.__dataclass_fields__:
        # What was known stays as it was.
        close(getattr(state, name)[rows], getattr(ends, name), atol=1e-9, rtol=0)
    for frame, left, right, share in [(1, 0, 1, 0.25), (2, 0, 1, 0.5), (3, 0, 1, 0.75), (5, 1, 2, 0.5)]:
        for mine, theirs in [(state.root, ends.root), (local_of(state), local_of(ends))]:
            whole = angles_between(theirs[left], theirs[right])
            assert np.ptp(whole) > 0.0 or whole.ndim == 0
            np.testing.assert_allclose(angles_between(theirs[left], mine[frame]), share * whole, atol=1e-6)
            np.testing.assert_allclose(
                angles_between(mine[frame], theirs[right]), (1 - share) * whole, atol=1e-6
            )
        close(state.wrist[frame], (1 - share) * ends.wrist[left] + share * ends.wrist[right])


def test_nothing_missing_changes_nothing() -> None:
    state = make_state(4, CHAIN)
    assert interpolate_gaps(state, np.ones(4, dtype=bool)) is state


def test_detect_cuts() -> None:
    hand = np.random.default_rng(0).uniform(0, 100, (21, 2))
    seen = np.stack([hand, hand + 30.0, hand + 300.0, 2.0 * hand + 300.0, 2.0 * hand + 310.0])
    np.testing.assert_array_equal(detect_cuts(seen), [False, True, True, False])


def test_opening_fist_is_no_cut() -> None:
    hand = np.random.default_rng(0).uniform(0, 100, (21, 2))
    opened = hand.copy()
    opened[NOT_PALM] *= 2.5
    np.testing.assert_array_equal(detect_cuts(np.stack([hand, opened])), [False])


def test_segments_end_at_cuts() -> None:
    found = np.array([0, 1, 2, 5, 6])
    cuts = np.array([False, True, False, False])
    assert [s.tolist() for s in segments(found, 25.0, cuts)] == [[0, 1], [2, 3, 4, 5, 6]]
    np.testing.assert_array_equal(missing_between(found, (3,)), [False, False, True, False])
    np.testing.assert_array_equal(missing_between(found, (2, 5)), [False, False, True, True])
    np.testing.assert_array_equal(missing_between(found, ()), [False] * 4)
