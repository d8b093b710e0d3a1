"""Hands of single frames as hands over all of them."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.detect.keypoints import MOST_IN_FRAME
from handfit_core.interchange.mano import POSE, FoundHands, followed
from handfit_core.interchange.recording import Asked
from handfit_core.skeleton import NUM_BETAS
from handfit_core.take import TAKE_LIMITS
from handfit_core.values import Unfit


def hands(*places: tuple[int, float], persons: list[int] | None = None) -> FoundHands:
    """Right hands in these frames, at these x."""
    count = len(places)
    frames, x = (np.array(column) for column in zip(*places, strict=True))
    transl = np.column_stack([x, np.zeros(count), np.full(count, 0.5)])
    person = np.full(count, -1) if persons is None else np.array(persons)
    betas = np.full((count, NUM_BETAS), np.nan)
    pose = np.zeros((count, 3)), np.zeros((count, POSE)), transl
    return FoundHands(frames.astype(int), np.ones(count, dtype=int), person, betas, *pose)


def test_each_goes_to_the_nearest_that_is_free() -> None:
    """In whatever order hands come; one that is new begins a new track."""
    places = [(0.3, 0.0), (0.01, 0.31), (0.32, 0.02, 0.9)]
    found = hands(*((frame, x) for frame, row in enumerate(places) for x in row))
    first, second, third = followed(found, np.arange(3), Asked(), [])
    for track, xs in ((first, [0.3, 0.31, 0.32]), (second, [0.0, 0.01, 0.02]), (third, [0.9])):
        np.testing.assert_allclose(track.transl[track.present, 0], xs)


def test_hands_and_persons_are_bounded() -> None:
    crowd = [(1, float(x)) for x in range(TAKE_LIMITS.max_hands + 1)]
    assert len(followed(hands(*crowd[1:]), np.array([1]), Asked(), [])) == TAKE_LIMITS.max_hands
    with pytest.raises(Unfit, match="more than 200 hands"):
        followed(hands(*crowd), np.array([1]), Asked(), [])
    with pytest.raises(ValueError, match="4001 hands in frame 1, and at most 4000"):
        followed(hands(*[(1, 0.0)] * (MOST_IN_FRAME + 1)), np.array([1]), Asked(), [])
    with pytest.raises(Unfit, match="more than 200 hands"):
        followed(hands(*crowd, persons=list(range(len(crowd)))), np.array([1]), Asked(), [])
    with pytest.raises(Unfit, match="twice in one frame"):
        followed(hands((1, 0.0), (1, 1.0), persons=[0, 0]), np.array([1]), Asked(), [])
