"""Add Hand in the window: a hand is laid into a drawing and posed by a few points."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from tests.window.inputs import write_robot_hand

ORDER = (0, 9, 8, 4, 20, 12)
"""Wrist and knuckle, then tips: index, thumb, little and middle finger"""


@pytest.fixture
def robot(tmp_path):
    """A drawing, and where its keypoints are."""
    path = tmp_path / "robot.png"
    return path, write_robot_hand(path)


def test_six_points_pose_a_hand_in_a_drawing(blender, robot):
    path, truth = robot
    points = [(k, truth[k].tolist()) for k in ORDER]
    played = blender.play("adding.posed", source=path, side="right", points=points, timeout=300).value
    landmarks = np.array(played["landmarks"])
    size = np.ptp(truth, axis=0).max()
    away = np.linalg.norm(landmarks - truth, axis=1)
    assert played["side"] == "right"
    assert played["pins"] == sorted(ORDER)
    assert played["undone"] == sorted(ORDER[:-1])
    assert away[list(ORDER)].max() < 0.02 * size  # as near as the mouse's whole pixels are
    assert away.mean() < 0.06 * size  # the others lie where the drawing has them
    assert min(played["moved"]) > 0.002
    assert played["line"] == "6 points of the right hand placed"


def test_left_or_right_palm_or_back_and_escape(blender, robot):
    played = blender.play("adding.cancelled", source=robot[0], timeout=300).value
    assert (played["side"], played["seen"], played["cancelled"]) == ("left", "palm", 0)
    wrist, knuckle = np.array(played["upright"])
    assert np.linalg.norm(wrist - (450, 450)) < 3
    np.testing.assert_allclose(knuckle - wrist, (0, -0.12 * 700), atol=1.0)
    assert (played["captures"], played["hands"]) == (1, 1)


def test_in_a_clip_it_is_added_at_the_current_frame(blender, rendered_hand, tmp_path):
    clip = shutil.copytree(rendered_hand, tmp_path / "clip")
    points = [(0, (200.0, 260.0)), (9, (200.0, 180.0)), (8, (180.0, 110.0))]
    played = blender.play(
        "adding.posed", source=clip, side="left", points=points, frame=9, shot="add-clip", timeout=300
    ).value
    assert played["pins"] == [0, 8, 9]
