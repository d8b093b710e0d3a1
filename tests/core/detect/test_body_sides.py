"""The votes of bodies on the sides of hands, on made detections."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.detect.body import NUM_BODY_POINTS, WRISTS, BodyTrack
from handfit_core.detect.body_sides import with_body_sides
from handfit_core.detect.keypoints import Detections, Track

COUNT, SIZE = 40, 60.0
PLACES = {"left": np.array([400.0, 300.0]), "right": np.array([200.0, 300.0])}
POINTS = SIZE * np.random.default_rng(0).uniform(0.0, 1.0, (21, 3)) * [1.0, -1.0, 1.0]


def track(named: Side, at: Side | Sequence[Side], **fields):
    """A hand of that side at the body's wrist of another one, or of one in each frame, which the hands'
    detector names then."""
    frames = []
    for frame in range(COUNT):
        side = at if isinstance(at, str) else at[frame]
        points = POINTS - POINTS[0] + [*PLACES[side], 0.0]
        seen = named if isinstance(at, str) else side
        frames.append([Detections.hand(seen, 0.95, points, 0.001 * points, **fields)])
    return Track(named, Detections.of(frames), COUNT)


def body(visibility=0.9, score=0.9, misplaced=0.0):
    points = np.zeros((COUNT, NUM_BODY_POINTS, 2))
    for side, place in PLACES.items():
        points[:, WRISTS[side]] = place + misplaced
    return BodyTrack(
        keypoints=points,
        visibility=np.full((COUNT, NUM_BODY_POINTS), visibility),
        world=np.zeros((COUNT, NUM_BODY_POINTS, 3)),
        score=np.full(COUNT, score),
        present=np.ones(COUNT, dtype=bool),
        cut=np.zeros(COUNT, dtype=bool),
    )


LEFT, WRONG = track("left", "left"), track("left", "right")


@pytest.mark.parametrize(
    ("tracks", "seen", "hands", "expected"),
    [
        pytest.param([WRONG], [body()], "auto", ["right"], id="wrong"),
        pytest.param([LEFT, WRONG], [body()], "both", ["left", "right"], id="two of one side"),
        pytest.param([track("right", "left"), WRONG], [body()], "auto", ["left", "right"], id="swapped"),
        pytest.param([LEFT], [body()], "auto", ["left"], id="right already"),
        pytest.param([WRONG], [], "auto", ["left"], id="no body"),
        pytest.param([WRONG], [body(visibility=0.3)], "auto", ["left"], id="hidden arm"),
        pytest.param([WRONG], [body(score=0.5)], "auto", ["left"], id="hardly a person"),
        pytest.param([WRONG], [body(misplaced=50.0)], "auto", ["left"], id="wrist elsewhere"),
        pytest.param([WRONG], [body()], "left", ["left"], id="asked for"),
        pytest.param(
            [track("left", "right", given_side=SIDES.index("left"))], [body()], "auto", ["left"], id="given"
        ),
        pytest.param(
            [track("right", "right"), WRONG], [body()], "auto", ["right", "left"], id="one wrist for two"
        ),
    ],
)
def test_which_side_a_hand_has(tracks, seen, hands, expected):
    found = with_body_sides(tracks, seen, hands)
    assert [each.side for each in found] == expected
    assert all(len(each.detections) == COUNT for each in found)


def test_frames_on_the_other_hand_are_left_out(caplog):
    """But not where only the body says so."""
    right: list[Side] = ["right"]
    left: list[Side] = ["left"]
    jumping = track("right", 20 * right + 8 * left + 12 * right)
    with caplog.at_level(logging.WARNING):
        (found,) = with_body_sides([jumping], [body()], "auto")
    assert found.side == "right"
    assert np.flatnonzero(~found.detected).tolist() == list(range(20, 28))
    assert "in 8 frames the right hand was followed on the other one" in caplog.text

    named = replace(jumping.detections, side=np.full(COUNT, SIDES.index("right")))
    (found,) = with_body_sides([replace(jumping, detections=named)], [body()], "auto")
    assert found.detected.all()
