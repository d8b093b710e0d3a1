"""What a detection says about its side."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.detect.keypoints import DetectedTrack, HandDetection, hands_from_arrays, hands_to_arrays
from handfit_core.skeleton import SIDES, Side, other_side

POINTS = np.arange(63.0).reshape(21, 3)


def detection(side: Side, right_side: float | None = None, score: float = 0.8) -> HandDetection:
    return HandDetection(side, score, POINTS, POINTS / 1000, right_side=right_side)


@pytest.mark.parametrize("side", SIDES)
def test_nobody_asked_the_network(side: Side) -> None:
    d = detection(side)
    assert d.likely_side == side
    assert d.side_votes() == {side: 0.8, other_side(side): 0.0}


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(("probability", "kept"), [(1.0, True), (0.5, True), (0.49, False), (0.0, False)])
def test_the_likelier_side(side: Side, probability: float, kept: bool) -> None:
    d = detection(side, probability)
    assert d.side == side  # what the detector said stays
    assert d.likely_side == (side if kept else other_side(side))
    votes = d.side_votes()
    assert votes[side] == pytest.approx(0.8 * probability)
    assert sum(votes.values()) == pytest.approx(0.8)
    assert (votes[side] >= votes[other_side(side)]) == kept


def test_extent_and_track() -> None:
    assert detection("left").extent == 60.0
    track = DetectedTrack("left", (None, detection("left"), None))
    np.testing.assert_array_equal(track.detected, [False, True, False])


@pytest.mark.parametrize("counts", [[10**15], [-1, 2], [2**62, 2**62, 2**62, 2**62, 1], []])
def test_wrong_counts(counts: list[int]) -> None:
    arrays = hands_to_arrays([[detection("left")]])
    with pytest.raises(ValueError, match="as its frames count"):
        hands_from_arrays(arrays | {"counts": np.array(counts, dtype=np.int64)})
