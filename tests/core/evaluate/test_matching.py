from __future__ import annotations

import numpy as np

from handfit_core.evaluate.matching import label_pixels, match
from tests.core.evaluate.hands import CAMERA, joints, label, seen

LEFT_OF_PICTURE, RIGHT_OF_PICTURE = joints(at=(-0.12, 0.08, 0.5)), joints(at=(0.12, 0.08, 0.5))


def test_each_hand_gets_its_own_detection_whatever_the_order_and_side() -> None:
    labels = [label(LEFT_OF_PICTURE).keypoints_2d, label(RIGHT_OF_PICTURE).keypoints_2d]
    detections = [seen(RIGHT_OF_PICTURE, "left"), seen(LEFT_OF_PICTURE, "left")]
    assert match(labels, detections) == [1, 0]


def test_a_stray_far_away_is_no_detection_of_the_hand() -> None:
    assert match([label(LEFT_OF_PICTURE).keypoints_2d], [seen(RIGHT_OF_PICTURE)]) == [None]


def test_a_stray_does_not_push_the_right_pair_apart() -> None:
    labels = [label(LEFT_OF_PICTURE).keypoints_2d, label(RIGHT_OF_PICTURE).keypoints_2d]
    assert match(labels, [seen(LEFT_OF_PICTURE)]) == [0, None]
    assert match(labels, []) == [None, None]


def test_a_few_labelled_points_are_enough() -> None:
    points = LEFT_OF_PICTURE.copy()
    points[np.arange(21) != 8] = np.nan
    pixels = label(points).keypoints_2d
    assert match([pixels], [seen(RIGHT_OF_PICTURE), seen(LEFT_OF_PICTURE)]) == [1]


def test_a_hand_without_pixels_takes_what_is_left() -> None:
    nowhere = np.full((21, 2), np.nan)
    labels = [nowhere, label(RIGHT_OF_PICTURE).keypoints_2d]
    assert match(labels, [seen(RIGHT_OF_PICTURE), seen(LEFT_OF_PICTURE)]) == [1, 0]


def test_missing_pixels_are_projected_and_points_behind_the_camera_are_not() -> None:
    points = LEFT_OF_PICTURE.copy()
    points[4, 2] = -0.1
    hand = label(points)
    without = type(hand)(hand.side, points, np.full((21, 2), np.nan))
    pixels = label_pixels(without, CAMERA)
    assert np.isnan(pixels[4]).all()
    np.testing.assert_allclose(pixels[8], CAMERA.project(points[8]))
    assert np.isnan(label_pixels(without, None)).all()
