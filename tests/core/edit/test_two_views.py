"""Re-fitting a range of a hand that two cameras saw keeps what both saw."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.views.joining import joined
from handfit_core.common.errors import OptionError, ProtocolError
from handfit_core.edit import (
    RefineHand,
    from_message,
    landmark_points,
    refit_range,
    second_sight,
    to_message,
)
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import Take
from tests.core.capturing.views.filmed import takes
from tests.core.edit.hands import locked
from tests.core.fit.detections import model_of

TIP = 8


@cache
def take() -> Take:
    return joined(*takes(), CaptureOptions())


def hand_of(rows: np.ndarray | None = None) -> RefineHand:
    (hand,), numbers = take().hands, take().frame_numbers
    rows = np.arange(len(numbers)) if rows is None else rows
    return RefineHand(
        hand.side,
        hand.betas,
        *(each[rows] for each in hand.pose),
        intrinsics=take().intrinsics,
        detections=hand.detections_at(rows),
        pins=np.full((len(rows), 21, 2), np.nan),
        locked=locked(),
        fps=take().fps,
        second=second_sight(take(), hand, rows),
    )


def points_of(motion: HandMotion) -> np.ndarray:
    return landmark_points(model_of(motion.side), motion.betas, *motion.pose)


def test_without_edits_it_is_the_joined_hand_again():
    """But for where the solver stops, and where the range ends."""
    joined_points, hand = points_of(take().hands[0]), hand_of()
    again = np.linalg.norm(points_of(refit_range(hand)) - joined_points, axis=2)
    assert np.median(again) < 1e-4
    assert again.max() < 2e-3
    alone = np.linalg.norm(points_of(refit_range(replace(hand, second=None))) - joined_points, axis=2)
    assert np.median(alone) > 2e-3
    rows = np.arange(20, 50)
    some = np.linalg.norm(points_of(refit_range(hand_of(rows))) - joined_points[rows], axis=2)
    assert some[10:20].max() < 1e-3


def test_a_pin_in_the_first_view():
    """It holds though the second view says otherwise; frames beyond its reach stay."""
    hand, lens = hand_of(np.arange(20, 50)), take().intrinsics
    plain = refit_range(hand)
    hand.pins[10, TIP] = lens.project(points_of(plain)[10, TIP]) + [8.0, 6.0]
    found = points_of(refit_range(hand))
    assert np.linalg.norm(lens.project(found[10, TIP]) - hand.pins[10, TIP]) < 2.0
    away = np.linalg.norm(found - points_of(plain), axis=2)
    assert away[10, TIP] > 3e-3
    assert away[25].max() < 1e-3


def test_messages():
    hand = hand_of(np.array([30]))
    assert hand.second is not None
    again = from_message(to_message(hand)).second
    assert again is not None
    np.testing.assert_array_equal(again.times, hand.second.times)
    assert again.camera.intrinsics == hand.second.intrinsics
    keypoints = again.detections.keypoints
    np.testing.assert_allclose(keypoints, hand.second.detections.keypoints, rtol=1e-6, atol=1e-4)
    with pytest.raises(ProtocolError, match="second"):
        from_message({**to_message(hand), "second": 3})
    with pytest.raises(OptionError, match="needs a time"):
        replace(hand.second, times=hand.second.times[::-1].copy())
    with pytest.raises(OptionError, match="second"):
        replace(hand_of(np.array([1, 2])), second=hand.second)
