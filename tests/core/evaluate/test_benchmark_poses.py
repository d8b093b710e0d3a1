"""What the rendered benchmark draws, before anything is rendered: poses, views, framing, clips."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes, joint_limits
from scripts.benchmark.clips import clip_shot
from scripts.benchmark.contact import penetration
from scripts.benchmark.kinematics import RightHand
from scripts.benchmark.pairs import pair_shots
from scripts.benchmark.poses import POSES, random_pose
from scripts.benchmark.shots import Shot, entries
from scripts.benchmark.stills import still_shot
from scripts.benchmark.views import outside

SIZE = 256
SLACK = 1e-6
"""radians"""


@pytest.fixture(scope="module")
def stills() -> list[Shot]:
    return [still_shot(0, i, SIZE) for i in range(24)]


@pytest.fixture(scope="module")
def clip() -> Shot:
    return clip_shot(0, 0, 40, SIZE)


def poses(kind: str, count: int = 8) -> list[tuple[RightHand, np.ndarray]]:
    found = []
    for i in range(count):
        rng = np.random.default_rng([7, i])
        hand = RightHand(np.clip(rng.normal(size=10), -2, 2))
        found.append((hand, random_pose(kind, hand, rng)))
    return found


def angles_of(shot: Shot) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Per hand the (F, 15, 3) anatomical angles of its labels, and the side's limits."""
    found = []
    for hand in shot.hands:
        limits = joint_limits(hand.side)
        rotmats = rotvec_to_rotmat(hand.hand_pose.reshape(-1, 15, 3))
        angles = anatomical_angles(rotmats, anatomical_axes(load_model(None, hand.side)))
        found.append((angles, limits.lower, limits.upper))
    return found


@pytest.mark.parametrize(
    ("number", "kind", "tips"),
    [
        (1, "random", [[-63.04681, 73.09533, 960.30056], [-38.52046, 25.76337, 949.58007]]),
        (17, "fist", [[84.24894, 99.35921, 1002.59872], [154.95432, 114.55381, 1006.62067]]),
        (36, "pinch", [[-9.74581, 37.77306, 497.76583], [-8.64786, 36.44501, 498.82826]]),
    ],
)
def test_old_seeds_give_what_they_gave(number: int, kind: str, tips: list[list[float]]) -> None:
    """Thumbs' and index fingers' tips, in millimetres."""
    (entry,) = entries(still_shot(7, number, 512))
    assert entry["tags"]["pose"] == kind
    np.testing.assert_allclose(np.array(entry["hands"][0]["joints_3d_mm"])[[4, 8]], tips, atol=0.15)


def test_every_label_lies_within_the_active_ranges(stills: list[Shot], clip: Shot) -> None:
    for shot in (*stills, clip):
        for angles, lower, upper in angles_of(shot):
            assert np.all(angles >= lower - SLACK)
            assert np.all(angles <= upper + SLACK)


@pytest.mark.parametrize("kind", POSES)
def test_fingers_do_not_cut_through_each_other(kind: str) -> None:
    depths = [penetration(hand.keypoints(angles), hand.scale) for hand, angles in poses(kind)]
    assert max(depths) < 0.0055


def test_the_same_number_gives_the_same_alone_and_in_every_size(stills: list[Shot], clip: Shot) -> None:
    for number in (21, 5):
        again = entries(still_shot(0, number, SIZE))
        assert again == entries(stills[number])
        double = entries(still_shot(0, number, 2 * SIZE))
        for hand, large in zip(again[0]["hands"], double[0]["hands"], strict=True):
            np.testing.assert_allclose(large["joints_3d_mm"], hand["joints_3d_mm"], atol=0.01)
    assert entries(still_shot(1, 5, SIZE)) != entries(stills[5])
    assert entries(stills[4]) != entries(stills[5])
    assert entries(clip_shot(0, 0, 40, SIZE)) == entries(clip)
    assert entries(clip_shot(0, 1, 40, SIZE)) != entries(clip)


def test_clip_labels_are_of_their_own_moments(clip: Shot) -> None:
    made = entries(clip)
    assert [e["time"] for e in made[:3]] == [0.0, 0.04, 0.08]
    assert {e["clip"] for e in made} == {"00"}
    inner = clip.hands[0].keypoints()[1:-1] * 1000
    np.testing.assert_allclose([e["hands"][0]["joints_3d_mm"] for e in made], inner, atol=1e-4)


def test_two_cameras_see_one_hand() -> None:
    """Both have the same bones and bends, and without an offset the hand is in one place at one moment."""
    first, second, truth = pair_shots(0, 0, 30, 320)
    a, b = (shot.hands[0].keypoints()[1:-1] for shot in (first, second))
    np.testing.assert_allclose(a, truth["joints3d"], atol=1e-7)
    late = truth["offset"] * truth["fps"]
    moments = np.arange(30) + late
    common = (moments >= 0) & (moments <= 29)
    moved = np.array([np.interp(moments[common], range(30), column) for column in a.reshape(30, -1).T])
    moved = moved.T.reshape(-1, 21, 3) @ np.array(truth["R"]).T + truth["t"]
    assert abs(late) > 1.0
    assert np.abs(moved - b[common]).max() < 2e-3
    assert outside(second.camera.project(b), second.size).max() == 0
    assert first.camera.fx != second.camera.fx
