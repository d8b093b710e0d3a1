from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from handfit_core.evaluate.labels import Entry, Labels, units_of
from handfit_core.evaluate.rows import label_pixels, match, view_of
from handfit_core.geometry.rotations import rotvec_to_rotmat
from tests.core.evaluate.hands import CAMERA, joints, label, seen

LEFT_OF_PICTURE, RIGHT_OF_PICTURE = joints(at=(-0.12, 0.08, 0.5)), joints(at=(0.12, 0.08, 0.5))


def test_each_hand_gets_its_own_detection_whatever_the_order_and_side() -> None:
    labels = [label(LEFT_OF_PICTURE).keypoints_2d, label(RIGHT_OF_PICTURE).keypoints_2d]
    detections = [seen(RIGHT_OF_PICTURE, "left").keypoints_2d, seen(LEFT_OF_PICTURE, "left").keypoints_2d]
    assert match(labels, detections) == [1, 0]


def test_a_stray_far_away_is_no_detection_of_the_hand() -> None:
    assert match([label(LEFT_OF_PICTURE).keypoints_2d], [seen(RIGHT_OF_PICTURE).keypoints_2d]) == [None]


def test_a_stray_does_not_push_the_right_pair_apart() -> None:
    labels = [label(LEFT_OF_PICTURE).keypoints_2d, label(RIGHT_OF_PICTURE).keypoints_2d]
    assert match(labels, [seen(LEFT_OF_PICTURE).keypoints_2d]) == [0, None]
    assert match(labels, []) == [None, None]


def test_a_few_labelled_points_are_enough() -> None:
    points = LEFT_OF_PICTURE.copy()
    points[np.arange(21) != 8] = np.nan
    pixels = label(points).keypoints_2d
    assert match([pixels], [seen(RIGHT_OF_PICTURE).keypoints_2d, seen(LEFT_OF_PICTURE).keypoints_2d]) == [1]


def test_a_hand_without_pixels_takes_what_is_left() -> None:
    nowhere = np.full((21, 2), np.nan)
    labels = [nowhere, label(RIGHT_OF_PICTURE).keypoints_2d]
    assert match(labels, [seen(RIGHT_OF_PICTURE).keypoints_2d, seen(LEFT_OF_PICTURE).keypoints_2d]) == [1, 0]


def test_missing_pixels_are_projected_and_points_behind_the_camera_are_not() -> None:
    points = LEFT_OF_PICTURE.copy()
    points[4, 2] = -0.1
    hand = label(points)
    without = type(hand)(hand.side, points, np.full((21, 2), np.nan))
    pixels = label_pixels(without, CAMERA)
    assert np.isnan(pixels[4]).all()
    np.testing.assert_allclose(pixels[8], CAMERA.project(points[8]))
    assert np.isnan(label_pixels(without, None)).all()


ENTRIES = [
    Entry(name, Path(name), lambda: Labels((), None), clip)
    for name, clip in (("a", None), ("b", None), ("c", None), ("x1", "x"), ("x2", "x"), ("y1", "y"))
]


@pytest.mark.parametrize(
    ("every", "clips", "expected"),
    [
        (1, True, [["a"], ["b"], ["c"], ["x1", "x2"], ["y1"]]),
        (2, True, [["a"], ["c"], ["x1", "x2"]]),
        (1, False, [["a"], ["b"], ["c"], ["x1"], ["x2"], ["y1"]]),
        (3, False, [["a"], ["x1"]]),
    ],
)
def test_stills_are_units_and_clips_stay_whole(every: int, clips: bool, expected: list[list[str]]) -> None:
    units = units_of(ENTRIES, clips=clips, every=every)
    assert [[e.name for e in unit.entries] for unit in units] == expected
    assert [unit.is_clip for unit in units] == [clips and len(u) > 0 and u[0][0] in "xy" for u in expected]


def turned(points: np.ndarray, degrees: float) -> np.ndarray:
    """About the vertical through the palm."""
    middle = points[[0, 5, 17]].mean(axis=0)
    turn = rotvec_to_rotmat(np.array([0.0, np.radians(degrees), 0.0]))
    return (points - middle) @ turn.T + middle


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("degrees", "view"), [(0, "palm"), (40, "palm"), (90, "edge"), (-90, "edge"), (180, "back")]
)
def test_view_follows_the_palm_for_both_hands(side, degrees: float, view: str) -> None:
    assert view_of(turned(joints(side, at=(0.0, 0.05, 0.5)), degrees), side) == view


def test_view_is_unknown_without_a_side_or_a_knuckle() -> None:
    points = joints()
    assert view_of(points, None) == "unknown"
    points[17] = np.nan
    assert view_of(points, "right") == "unknown"
