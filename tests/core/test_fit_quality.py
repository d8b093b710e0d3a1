"""A fitted hand's error as a share of its own size, and in a word."""

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.fit_quality import (
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
from handfit_core.take import Take
from tests.conftest import ROOT


@pytest.fixture(scope="module")
def take() -> Take:
    return Take.load(ROOT / "samples" / "rendered_hand" / "truth.take.npz")


def test_the_share_does_not_hang_on_the_pictures_size(take: Take) -> None:
    track = replace(take.hands[0], reprojection_error=np.full(len(take.frame_numbers), 6.0))
    share = mean_relative_error(track, take.intrinsics)
    k = take.intrinsics
    twice = type(k)(2 * k.fx, 2 * k.fy, 2 * k.cx, 2 * k.cy)
    enlarged = replace(track, reprojection_error=track.reprojection_error * 2)
    assert mean_relative_error(enlarged, twice) == pytest.approx(share)
    # Nor on how far away the hand is, as long as the picture's pixels per hand say the same.
    nearer = replace(track, joints_3d=track.joints_3d / 2, transl=track.transl / 2)
    assert mean_relative_error(nearer, take.intrinsics) == pytest.approx(share)


def test_a_flat_hand_seen_from_the_front() -> None:
    take = Take.load(ROOT / "samples" / "rendered_hand" / "truth.take.npz")
    joints = np.zeros((1, 21, 3))
    joints[0, :, 2] = 0.5
    for number, point in enumerate((9, 10, 11, 12), start=1):
        joints[0, point, 1] = -0.05 * number  # 0.2 m from the wrist to the tip
    track = replace(
        take.hands[0], joints_3d=joints, reprojection_error=np.array([7.0]), detected=np.array([True])
    )
    length = take.intrinsics.fx * 0.2 / 0.5
    np.testing.assert_allclose(relative_errors(track, take.intrinsics), [7.0 / length])


def test_frames_without_a_detection_do_not_count(take: Take) -> None:
    track = take.hands[0]
    count = len(take.frame_numbers)
    errors = np.where(np.arange(count) < 3, 6.0, np.nan)
    some = replace(track, reprojection_error=errors, detected=np.arange(count) < 3)
    assert np.isfinite(relative_errors(some, take.intrinsics)).tolist() == some.detected.tolist()
    assert mean_relative_error(some, take.intrinsics) is not None
    none = replace(some, detected=np.zeros(count, dtype=bool))
    assert mean_relative_error(none, take.intrinsics) is None


def test_the_mean_of_what_is_expected(take: Take) -> None:
    track = take.hands[0]
    assert mean_expected_error(track) is None
    expected = np.full((len(take.frame_numbers), 5), np.nan)
    assert mean_expected_error(replace(track, expected_error=expected)) is None
    expected[2:4] = [[0.01] * 5, [0.02] * 5]
    assert mean_expected_error(replace(track, expected_error=expected)) == pytest.approx(0.015)


def test_nobody_knows(take: Take) -> None:
    track = take.hands[0]
    expected = np.full((len(take.frame_numbers), 5), np.nan)
    assert error_is_known(track), "an older take"
    assert not error_is_known(replace(track, expected_error=expected, doubtful=None))
    doubted = np.zeros(len(expected), dtype=bool)
    assert error_is_known(replace(track, expected_error=expected, doubtful=doubted)), "all corrected"
    expected[2] = 0.01
    assert error_is_known(replace(track, expected_error=expected))


@pytest.mark.parametrize(
    ("error", "frames", "word"),
    [
        (0.0107, 1, "good"),
        (0.0158, 1, "fair"),
        (0.0202, 1, "fair"),
        (0.0276, 1, "poor"),
        (0.0107, 2, "fair"),
        (0.0158, 300, "poor"),
    ],
)
def test_a_still_is_not_judged_as_a_clip_is(error: float, frames: int, word: str) -> None:
    assert expected_scale(frames).quality(error) == word


def test_words() -> None:
    for scale in (IN_PICTURE, EXPECTED, EXPECTED_OF_STILL):
        steps = (0.0, scale.good_below, scale.fair_below)
        assert [scale.quality(s) for s in steps] == ["good", "fair", "poor"]
    assert IN_PICTURE.said(GOOD_BELOW) == "2.5 % of the hand"
    assert EXPECTED.said(0.0071) == "7.1 mm"
    assert IN_PICTURE.levels[:2] == (GOOD_BELOW, FAIR_BELOW)
