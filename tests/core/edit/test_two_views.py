"""Corrections of a hand that two cameras saw: a re-fit keeps what both saw; points are pinned in either."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from handfit_core.capturing.joining import joined
from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import OptionError, ProtocolError
from handfit_core.edit import (
    RefineHand,
    answer,
    from_message,
    landmark_points,
    refit_each,
    refit_range,
    result_from_message,
    second_sight,
    to_message,
)
from handfit_core.fit.solvers import never
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import Take
from tests.core.edit.hands import locked
from tests.core.fit.detections import model_of
from tests.core.fit.test_views import takes

ROW, TIP = 30, 8
INDEX = [5, 6, 7, 8]


@cache
def take() -> Take:
    return joined(*takes(), CaptureOptions())


def hand_of(rows: np.ndarray | None = None) -> RefineHand:
    (hand,), numbers = take().hands, take().frame_numbers
    rows = np.arange(len(numbers)) if rows is None else rows
    nothing = np.full((len(rows), 21, 2), np.nan)
    return RefineHand(
        hand.side,
        hand.betas,
        *(each[rows] for each in hand.pose),
        intrinsics=take().intrinsics,
        detections=hand.detections(rows),
        pins=nothing,
        locked=locked(),
        fps=take().fps,
        second=second_sight(take(), hand, rows, nothing),
    )


def points_of(motion: HandMotion) -> np.ndarray:
    return landmark_points(model_of(motion.side), motion.betas, *motion.pose)


def seen_of(motion: HandMotion, view: int) -> np.ndarray:
    """(T, 21, 2) pixels"""
    cameras = take().cameras
    assert cameras is not None
    return cameras.camera(view).project(points_of(motion))


def pinned(hand: RefineHand, point: int, place: np.ndarray, row: int = 0, view: int = 1) -> RefineHand:
    assert hand.second is not None
    pins = (hand.second.pins if view else hand.pins).copy()
    pins[row, point] = place
    return replace(hand, second=replace(hand.second, pins=pins)) if view else replace(hand, pins=pins)


def dragged(by: tuple[float, float], point: int = TIP) -> RefineHand:
    """One frame, with a point dragged by so many pixels of the second view."""
    hand = hand_of(np.array([ROW]))
    return pinned(hand, point, seen_of(hand, 1)[0, point] + by)


def moved(hand: RefineHand, found: HandMotion, view: int) -> np.ndarray:
    """(21,) pixels of that view"""
    return np.linalg.norm(seen_of(found, view) - seen_of(hand, view), axis=-1)[0]


def missed(hand: RefineHand, found: HandMotion, row: int = 0) -> float:
    """pixels of the second view to its farthest pin"""
    assert hand.second is not None
    return float(np.nanmax(np.linalg.norm(seen_of(found, 1)[row] - hand.second.pins[row], axis=-1)))


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


@pytest.mark.parametrize("by", [(9.0, 6.0), (-6.0, -8.0)])
def test_a_point_that_is_dragged_in_the_second_view(by):
    hand = dragged(by)
    found = refit_each(hand)
    assert missed(hand, found) < 1.0
    others = [k for k in range(21) if k not in INDEX]
    assert moved(hand, found, 0)[others].max() < 0.5
    assert moved(hand, found, 0)[INDEX].max() > 0.5, "the first view shows it too"
    draft = result_from_message(answer({"hand": to_message(hand), "mode": "draft"}, never))
    assert missed(hand, draft) < 2.0
    np.testing.assert_allclose(seen_of(refit_each(dragged((0.0, 0.0))), 0), seen_of(hand, 0), atol=0.2)


@pytest.mark.parametrize("point", [0, 9, TIP])
def test_the_palm_follows_in_depth(point):
    """The second camera looks from the side: what is dragged across its picture goes away from the first."""
    hand = dragged((-45.0, 5.0), point)
    found = refit_each(hand)
    assert missed(hand, found) < (1.0 if point == 0 else 3.0)
    way = points_of(found)[0, point] - points_of(hand)[0, point]
    assert abs(way[2]) > 0.01


def test_pins_in_both_views_say_where_in_space():
    hand = hand_of(np.array([ROW]))
    points, cameras = points_of(hand)[0], take().cameras
    assert cameras is not None
    aim = points[TIP] + 0.15 * (points[5] - points[TIP]) + [0.004, 0.0, 0.003]
    for view in (0, 1):
        hand = pinned(hand, TIP, cameras.camera(view).project(aim), view=view)
    found = points_of(refit_each(hand))[0, TIP]
    assert np.linalg.norm(found - aim) < 1e-3 < 5e-3 < np.linalg.norm(points[TIP] - aim)


def test_a_range_has_the_pins_of_the_second_view():
    hand = hand_of(np.arange(20, 50))
    plain = refit_range(hand)
    edited = pinned(hand, TIP, seen_of(plain, 1)[10, TIP] + [8.0, 6.0], row=10)
    found = refit_range(edited)
    assert missed(edited, found, 10) < 2.0
    away = np.linalg.norm(points_of(found) - points_of(plain), axis=2)
    assert away[10, TIP] > 3e-3
    assert away[25].max() < 1e-3


def test_messages():
    hand = dragged((3.0, 4.0))
    assert hand.second is not None
    again = from_message(to_message(hand)).second
    assert again is not None
    np.testing.assert_array_equal(again.pins, hand.second.pins)
    np.testing.assert_array_equal(again.times, hand.second.times)
    assert again.camera.intrinsics == hand.second.intrinsics
    keypoints = again.detections.keypoints
    np.testing.assert_allclose(keypoints, hand.second.detections.keypoints, rtol=1e-6, atol=1e-4)
    with pytest.raises(ProtocolError, match="second"):
        from_message({**to_message(hand), "second": 3})
    half = hand.second.pins.copy()
    half[0, TIP, 0] = np.nan
    with pytest.raises(OptionError, match="second: pins"):
        replace(hand.second, pins=half)
    with pytest.raises(OptionError, match="needs a time"):
        replace(hand.second, times=hand.second.times[::-1].copy())
    with pytest.raises(OptionError, match="second"):
        replace(hand_of(np.array([1, 2])), second=hand.second)
