"""Where a track is broken, which gaps are interpolated, and what stands in them."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.common.skeleton import PALM_KEYPOINTS
from handfit_core.fit.gaps import detect_cuts, interpolate_gaps, missing_between, segments
from handfit_core.geometry.rotations import euler_to_rotmat, rotmat_to_rotvec
from handfit_core.hand_model.chain import State
from tests.core.fit.differences import close
from tests.core.fit.hands import chain_of, make_state


@pytest.mark.parametrize(
    ("found", "fps", "cuts", "ends"),
    [
        (range(7), 25.0, None, [(0, 6)]),
        ([0, 1, 3], 1.0, None, [(0, 1), (3, 3)]),  # half a second is no frame
        ([0, 15], 29.97, None, [(0, 15)]),
        ([0, 16], 29.97, None, [(0, 0), (16, 16)]),
        ([0, 1, 2, 5, 6], 25.0, [False, True, False, False], [(0, 1), (2, 6)]),
    ],
)
def test_segments(found, fps, cuts, ends) -> None:
    """They end at cuts and at gaps of more than half a second."""
    parts = segments(np.array(found), fps, None if cuts is None else np.array(cuts))
    assert [part.tolist() for part in parts] == [list(range(a, b + 1)) for a, b in ends]


@pytest.mark.parametrize(("holes", "after"), [((3,), [2]), ((2, 5), [2, 3]), ((), [])])
def test_missing_between(holes, after) -> None:
    found = missing_between(np.array([0, 1, 2, 5, 6]), holes)
    assert np.flatnonzero(found).tolist() == after


def test_detect_cuts() -> None:
    hand = np.random.default_rng(0).uniform(0, 100, (21, 2))
    opened = np.where(np.isin(np.arange(21), PALM_KEYPOINTS)[:, None], hand, 2.5 * hand)
    for other, cut in ((hand + 30, False), (hand + 270, True), (2 * hand, True), (opened, False)):
        assert detect_cuts(np.stack([hand, other])).tolist() == [cut]


def angles_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(rotmat_to_rotvec(a.swapaxes(-1, -2) @ b), axis=-1)


def rotations_of(state: State) -> np.ndarray:
    """(T, 16, 3, 3)"""
    return np.concatenate([state.root[:, None], euler_to_rotmat(state.angles.reshape(-1, 15, 3))], axis=1)


def test_filled_frames_lie_between() -> None:
    ends = make_state(3, chain_of(), seed=4, spread=0.5)
    known = np.array([True, False, False, False, True, False, True])
    state = interpolate_gaps(ends, known)
    for name in State.__dataclass_fields__:
        # What was known stays as it was.
        close(getattr(state, name)[known], getattr(ends, name), atol=1e-9, rtol=0)
    found, given = rotations_of(state), rotations_of(ends)
    for frame, left, share in [(1, 0, 0.25), (2, 0, 0.5), (3, 0, 0.75), (5, 1, 0.5)]:
        first, last = given[left], given[left + 1]
        whole = angles_between(first, last)
        close(angles_between(first, found[frame]), share * whole, atol=1e-6)
        close(angles_between(found[frame], last), (1 - share) * whole, atol=1e-6)
        close(state.wrist[frame], (1 - share) * ends.wrist[left] + share * ends.wrist[left + 1])
