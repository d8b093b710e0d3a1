"""The offset in time between two views."""

from handfit_core.capturing.views.sync import offset_scores
from tests.core.capturing.views.filmed import FPS, OFFSET, pair


def test_offset():
    best, *others = offset_scores([pair()])
    assert abs(best.offset - OFFSET) * FPS < 0.3
    assert all(other.score < 0.7 * best.score for other in others)
