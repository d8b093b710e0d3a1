"""What a detection says about its side."""

import numpy as np
import pytest

from handfit_core.common.arrays import check_arrays
from handfit_core.common.skeleton import SIDES, Side, other_side
from handfit_core.detect.keypoints import SURE_SIDE_SCORE, Detections, Track

POINTS = np.arange(63.0).reshape(21, 3)
TABLE = np.arange(126.0).reshape(21, 6)


def detection(side: Side, right_side: float | None = None, score: float = 0.8) -> Detections:
    return Detections.hand(side, score, POINTS, POINTS / 1000, right_side=right_side)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(
    ("probability", "score", "named"),
    [
        (None, 0.8, 1.0),
        (1.0, 0.8, 1.0),
        (0.5, 0.8, 0.5),
        (0.49, 0.8, 0.49),
        (0.0, 0.8, 0.0),
        (0.0, SURE_SIDE_SCORE, 1.0),
    ],
)
def test_the_likelier_side(side, probability, score, named):
    hands = detection(side, probability, score)
    assert SIDES[hands.side[0]] == side  # what the detector said stays
    assert SIDES[hands.likely_side[0]] == (side if named >= 0.5 else other_side(side))
    votes = dict(zip(SIDES, hands.side_votes[0], strict=True))
    assert votes == pytest.approx({side: score * named, other_side(side): score * (1.0 - named)})


def test_columns_of_frames():
    """Small columns that nobody filled say so, large ones are absent."""
    shown = Detections.hand(
        "right", 0.7, POINTS + 1.0, POINTS, keypoints_2020=POINTS, corrected_side=0, corrected=TABLE
    ).shown_by_person(None)
    hands = Detections.of([[detection("left")], [], [shown, detection("right", 0.3)]])
    check_arrays(hands)
    assert hands.frame.tolist() == [0, 2, 2]
    assert hands.side.tolist() == [0, 1, 1]
    assert hands.shown.tolist() == [False, True, False]
    assert hands.given_side.tolist() == [-1, -1, -1]
    assert hands.corrected_side.tolist() == [-1, 0, -1]
    np.testing.assert_array_equal(hands.right_side, [np.nan, np.nan, 0.3])
    np.testing.assert_array_equal(hands.asked_2020, [False, True, False])
    assert hands.corrected is not None
    np.testing.assert_array_equal(hands.corrected[1], TABLE)
    assert hands.spread is hands.overlapped is None
    assert [rows.tolist() for rows in hands.rows_by_frame] == [[0], [1, 2]]
    np.testing.assert_array_equal(hands.extent, [60.0] * 3)
    assert [hand.score.tolist() for hand in hands] == [[0.8], [0.7], [0.8]]
    none = Detections.of([[], []])
    check_arrays(none)
    assert (len(none), none.rows_by_frame) == (0, [])


def test_extent_and_track():
    assert detection("left").extent == 60.0
    track = Track("left", Detections.of([[], [detection("left")]]), frame_count=3)
    np.testing.assert_array_equal(track.detected, [False, True, False])
