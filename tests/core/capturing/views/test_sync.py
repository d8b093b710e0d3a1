"""The offset in time between two views."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from handfit_core.capturing.views.sync import offset_scores
from tests.core.capturing.views.filmed import FPS, OFFSET, pair


def test_offset():
    best, *others = offset_scores([pair()])
    assert abs(best.offset - OFFSET) * FPS < 0.3
    assert all(other.score < 0.7 * best.score for other in others)


@pytest.mark.parametrize("early", [15, 55], ids=["behind", "before"])
@pytest.mark.parametrize("view", ["first", "second"])
def test_stretches_without_hands_cost_nothing(view, early):
    """The hands of an hour are seen in its first and last seconds; the other view fits the longer stretch."""
    whole = pair()
    late = np.arange(len(whole.first)) >= early
    pause = 3600.0
    hand = getattr(whole, view)
    hands = replace(whole, **{view: replace(hand, times=hand.times + pause * late)})
    tracemalloc.start()
    best = offset_scores([hands])[0]
    assert tracemalloc.get_traced_memory()[1] < 20_000_000
    tracemalloc.stop()
    lost = pause if early == 15 else 0.0
    assert abs(best.offset - OFFSET - (lost if view == "first" else -lost)) * FPS < 0.5
