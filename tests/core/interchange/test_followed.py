"""Hands of single frames as hands over all of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from handfit_core.detect.keypoints import MOST_IN_FRAME
from handfit_core.doors.values import Unfit
from handfit_core.interchange.mano import NO_SHAPE, POSE, FoundHand, followed
from handfit_core.interchange.recording import Asked
from handfit_core.take import TAKE_LIMITS


class Counted(int):
    """A frame's number that counts how often it is compared."""

    compared = 0

    def __lt__(self, other: Any) -> bool:
        Counted.compared += 1
        return int(self) < int(other)

    def __gt__(self, other: Any) -> bool:
        Counted.compared += 1
        return int(self) > int(other)


def hand(frame: int, x: float = 0.0, person: int | None = None) -> FoundHand:
    pose = np.zeros((1, 3)), np.zeros((1, POSE)), np.array([[x, 0.0, 0.5]])
    return FoundHand("right", NO_SHAPE, *pose, frame, person)


@pytest.mark.parametrize("count", [50, 400])
def test_a_frame_costs_the_same_in_long_clips(count: int) -> None:
    Counted.compared = 0
    hands = [hand(Counted(frame)) for frame in range(count)]
    (one,) = followed(hands, np.arange(count), Asked(), [])
    assert one.present.all()
    assert Counted.compared <= 10 * count


def test_each_goes_to_the_nearest_that_is_free() -> None:
    """In whatever order hands come; one that is new begins a new track."""
    places = [(0.3, 0.0), (0.01, 0.31), (0.32, 0.02, 0.9)]
    found = [hand(frame, x) for frame, row in enumerate(places) for x in row]
    first, second, third = followed(found, np.arange(3), Asked(), [])
    for track, xs in ((first, [0.3, 0.31, 0.32]), (second, [0.0, 0.01, 0.02]), (third, [0.9])):
        np.testing.assert_allclose(track.transl[track.present, 0], xs)


def test_hands_and_persons_are_bounded() -> None:
    crowd = [hand(1, x) for x in range(TAKE_LIMITS.max_hands)]
    assert len(followed(crowd, np.array([1]), Asked(), [])) == TAKE_LIMITS.max_hands
    with pytest.raises(Unfit, match="more than 200 hands"):
        followed([*crowd, hand(1)], np.array([1]), Asked(), [])
    with pytest.raises(ValueError, match="4001 hands in frame 1, and at most 4000"):
        followed([hand(1)] * (MOST_IN_FRAME + 1), np.array([1]), Asked(), [])
    strangers = [hand(frame, person=frame) for frame in range(TAKE_LIMITS.max_hands + 1)]
    with pytest.raises(Unfit, match="more than 200 hands"):
        followed(strangers, np.arange(len(strangers)), Asked(), [])
