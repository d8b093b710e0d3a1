"""A fitted hand's error as a share of its own size, and in a word."""

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.take import Take
from handfit_core.take.fit_quality import (
    EXPECTED,
    EXPECTED_OF_STILL,
    FAIR_BELOW,
    GOOD_BELOW,
    IN_PICTURE,
    error_is_known,
    expected_scale,
    mean_expected_error,
    mean_relative_error,
    relative_errors,
)
from tests.conftest import ROOT
from tests.takes import seen_as

TAKE = Take.load(ROOT / "samples" / "rendered_hand" / "truth.take.npz")
TRACK = TAKE.hands[0]
COUNT = len(TAKE.frame_numbers)


def test_a_share_of_the_hands_length_in_the_picture():
    """0.2 metres from the wrist to the middle finger's tip, seen from the front; frames without a detection
    do not count."""
    joints = np.full((COUNT, 21, 3), [0.0, 0.0, 0.5])
    joints[:, 9:13, 1] = -0.05 * np.arange(1, 5)
    seen = np.arange(COUNT) < 3
    track = replace(TRACK, joints_3d=joints, reprojection_error=np.where(seen, 7.0, np.nan))
    track = seen_as(track, detected=seen)
    expected = np.where(seen, 7.0 / (TAKE.intrinsics.fx * 0.2 / 0.5), np.nan)
    np.testing.assert_allclose(relative_errors(track, TAKE.intrinsics), expected)
    assert mean_relative_error(track, TAKE.intrinsics) == pytest.approx(expected[0])
    assert mean_relative_error(seen_as(track, detected=~seen & seen), TAKE.intrinsics) is None


def test_expected_errors():
    nan = np.full((COUNT, 5), np.nan)
    unknown = replace(TRACK, expected_error=nan, doubtful=None)
    corrected = replace(unknown, doubtful=np.zeros(COUNT, dtype=bool))
    nan[2:4] = [[0.01] * 5, [0.02] * 5]
    known = replace(TRACK, expected_error=nan.copy())
    nan[2:4] = np.nan
    tracks = {"of an older take": TRACK, "corrected": corrected, "known": known, "unknown": unknown}
    assert [name for name, track in tracks.items() if not error_is_known(track)] == ["unknown"]
    assert mean_expected_error(known) == pytest.approx(0.015)
    assert [mean_expected_error(track) for track in (TRACK, corrected, unknown)] == [None] * 3


@pytest.mark.parametrize(
    ("error", "frames", "word"),
    [(0.0107, 1, "good"), (0.0202, 1, "fair"), (0.0107, 2, "fair"), (0.0158, 300, "poor")],
)
def test_a_still_is_not_judged_as_a_clip_is(error, frames, word):
    assert expected_scale(frames).quality(error) == word


def test_words():
    for scale in (IN_PICTURE, EXPECTED, EXPECTED_OF_STILL):
        steps = (0.0, scale.good_below, scale.fair_below)
        assert [scale.quality(s) for s in steps] == ["good", "fair", "poor"]
    assert IN_PICTURE.said(GOOD_BELOW) == "2.5 % of the hand"
    assert EXPECTED.said(0.0071) == "7.1 mm"
    assert IN_PICTURE.levels[:2] == (GOOD_BELOW, FAIR_BELOW)
