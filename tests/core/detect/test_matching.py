"""Detections of one picture are compared, and the mean of predictions is taken."""

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.matching import covers, distance, is_part_of, is_same_hand, mean_detection

SHAPE = np.random.default_rng(5).uniform(0, 1, (21, 3))
SHAPE = 100.0 * (SHAPE - SHAPE.min(axis=0)) / np.ptp(SHAPE, axis=0)  # 100 pixels a side


def hand(x: float, side: Side = "right", score: float = 0.9) -> Detections:
    return Detections.hand(side, score, SHAPE + [x, 0.0, 0.0], SHAPE / 1000 + x)


def overlapped(one: Detections, other: Detections) -> np.ndarray:
    """(21,) bool: which points of a hand lie on the other hand."""
    return covers(Detections.of([[other]]), np.zeros(1, dtype=int), one.keypoints_2d[0])


def test_distance_is_in_units_of_the_hand():
    assert distance(hand(0), hand(30)) == pytest.approx(0.3)
    others = Detections.of([[hand(10), hand(30)]])
    np.testing.assert_allclose(distance(hand(0), others), [0.1, 0.3])


def test_points_on_another_hand():
    """Points at the other hand's tip lie on its bones; of those around it, the near ones do."""
    points = SHAPE.copy()
    points[:, :2] = SHAPE[4, :2]
    middle = SHAPE[:, :2].mean(axis=0)
    points[1:, :2] += np.linspace(0.0, 400.0, 20)[:, None] * (SHAPE[4, :2] - middle) / 100.0
    covered = overlapped(Detections.hand("left", 0.9, points, SHAPE), hand(0))
    assert covered[0]
    assert not covered[-1]
    assert overlapped(hand(0), hand(0)).all()
    assert not overlapped(hand(0), hand(150)).any()
    assert np.array_equal(overlapped(hand(0), hand(50, "left")), overlapped(hand(7), hand(57)))


@pytest.mark.parametrize(
    ("x", "scale", "turn", "expected"),
    [
        (20.0, 1.0, 0, True),
        (0.0, 1.0, 2, True),
        (0.0, 0.8, 1, True),
        (90.0, 1.0, 0, False),
        (0.0, 0.3, 0, True),
    ],
    ids=["beside", "upside down", "a part of it", "the next one", "a finger of it"],
)
def test_of_one_hand_or_of_two(x, scale, turn, expected):
    keypoints, quarter = SHAPE.copy(), np.array([[0.0, 1.0], [-1.0, 0.0]])
    about = (SHAPE[:, :2] - 50.0) @ np.linalg.matrix_power(quarter, turn)
    keypoints[:, :2] = 50.0 + scale * about + [x, 0.0]
    first, second = hand(0), Detections.hand("left", 0.9, keypoints, SHAPE)
    assert is_same_hand(first, second) == is_same_hand(second, first) == expected


@pytest.mark.parametrize(
    ("x", "scale", "expected"), [(60.0, 0.4, True), (90.0, 0.4, False), (0.0, 0.8, False), (0.0, 2.5, True)]
)
def test_a_hand_and_its_part(x, scale, expected):
    """A part may also be the same hand without its forearm; of two of about one size each may be a hand."""
    second = Detections.hand("left", 0.9, scale * SHAPE + [x, 0.0, 0.0], SHAPE)
    assert is_part_of(hand(0), second) is is_part_of(second, hand(0)) is expected


def test_the_mean_of_predictions():
    predictions = [hand(0, "left", 0.6), hand(6, "right", 0.9), hand(12, "left", 0.6)]
    mean = mean_detection(Detections.of([predictions]))
    assert mean.side == SIDES.index("left")
    assert mean.score == pytest.approx(1.2 / 3)  # the second saw another side
    np.testing.assert_allclose(mean.keypoints[0], SHAPE + [6.0, 0.0, 0.0])
    np.testing.assert_allclose(mean.world[0], SHAPE / 1000 + 6.0)
    np.testing.assert_allclose(mean.spread[0], np.tile([np.sqrt(24.0), 0.0, 0.0], (21, 1)), atol=1e-9)
    assert mean.keypoints_2020 is None
    assert mean_detection(hand(0)).spread is None
    first, last = (
        replace(hand(0), keypoints_2020=SHAPE[None]),
        replace(hand(0), keypoints_2020=SHAPE[None] + 4.0),
    )
    mean = mean_detection(Detections.of([[first, hand(6), last]]))
    np.testing.assert_allclose(mean.keypoints_2020[0], SHAPE + 2.0)
