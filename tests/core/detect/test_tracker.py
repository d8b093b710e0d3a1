"""What is followed is expected where it goes, and searched for ever more seldom."""

import numpy as np
import pytest

from handfit_core.detect.tracker import TRACKER, Tracked

SQUARE = 100.0 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@pytest.mark.parametrize("speed", [0.0, 0.9 * TRACKER.min_speed, 3.0 * TRACKER.min_speed])
def test_fast_ones_are_expected_where_they_go_and_slow_ones_where_they_were(speed):
    hand = Tracked(SQUARE, 0.5)
    moved = SQUARE + [100.0 * speed, 0.0]
    hand.found(moved)
    ahead = 100.0 * max(0.0, speed - TRACKER.min_speed)
    np.testing.assert_allclose(hand.expected(), moved + [ahead, 0.0], atol=1e-9)


def test_a_lost_one_stands_still_and_is_searched_for_in_growing_intervals():
    hand = Tracked(SQUARE, 0.5)
    hand.found(SQUARE + 50.0)
    searched = []
    for frame in range(24):
        if hand.search_is_due():
            searched.append(frame)
            hand.missed(most_wait=6)
    assert searched == [0, 2, 6, 13, 20]
    assert hand.misses == 5
    np.testing.assert_array_equal(hand.expected(), SQUARE + 50.0)
