"""scripts/measure_takes.py: meshes inside themselves against closed forms, and depth at rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import load_model
from scripts.measure_takes import Skin, depth_steps_at_rest, distances_to, lid, main, rims, winding_numbers
from tests.takes import take_of, track_of

MODEL = load_model(None, "right")
CAMERA = Intrinsics(500.0, 500.0, 320.0, 240.0)
CORNERS = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
BOX = np.array(
    [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6)]
    + [(0, 6, 4), (1, 5, 7), (1, 7, 3)]
)
"""The unit cube's triangles, counter-clockwise from outside"""


def crossed(degrees: float) -> np.ndarray:
    """(45,) the flat hand with the index finger's first joint sideways into the middle finger's."""
    pose = np.zeros((15, 3))
    pose[0, 1], pose[3, 1] = np.radians([-degrees, degrees])
    return pose.ravel()


def depth(pose: np.ndarray) -> float:
    return Skin(MODEL).depth(MODEL.posed(None, np.zeros(3), pose, np.zeros(3)).vertices)


def test_inside_and_outside_of_a_cube_and_how_far_its_skin_is() -> None:
    points = np.random.default_rng(0).uniform(-0.5, 1.5, (600, 3))
    inside = ((points > 0.0) & (points < 1.0)).all(axis=1)
    np.testing.assert_allclose(winding_numbers(points, CORNERS[BOX]), inside, atol=1e-9)
    distances, nearest = distances_to(points, CORNERS[BOX])
    within = np.minimum(points, 1.0 - points).min(axis=1)
    without = np.linalg.norm(points - points.clip(0.0, 1.0), axis=1)
    np.testing.assert_allclose(distances, np.where(inside, within, without), atol=1e-12)
    # The nearest triangle alone is as near.
    alone = [distances_to(p[None], CORNERS[BOX][[n]])[0][0] for p, n in zip(points, nearest, strict=True)]
    np.testing.assert_allclose(alone, distances, atol=1e-12)


def test_an_open_mesh_is_closed_by_its_lids() -> None:
    tube = BOX[4:]  # two opposite walls are missing
    holes = rims(tube)
    assert sorted(len(rim) for rim in holes) == [4, 4]
    closed = np.concatenate([CORNERS[tube], *(lid(CORNERS[rim]) for rim in holes)])
    points = np.random.default_rng(1).uniform(0.05, 0.95, (20, 3))
    np.testing.assert_allclose(winding_numbers(points, closed), 1.0, atol=1e-9)
    np.testing.assert_allclose(winding_numbers(points + 1.0, closed), 0.0, atol=1e-9)


def test_hands_that_touch_nothing_are_not_in_themselves_and_crossed_fingers_are() -> None:
    for pose in (np.zeros(45), MODEL.hands_mean):
        assert depth(pose) < 0.0005
    found = [depth(crossed(degrees)) for degrees in (0.0, 6.0, 9.0, 18.0)]
    assert found == sorted(found)
    # The way out of a finger is never longer than its radius.
    assert 0.004 < found[-1] < 0.010


def test_depth_steps_count_where_the_palm_rests_in_the_picture() -> None:
    transl = np.zeros((40, 3))
    transl[:, 2] = 0.5 + 0.003 * (np.arange(40) % 2)
    hand = track_of("right", np.zeros((40, 3)), np.zeros((40, 45)), transl, CAMERA)
    points = np.repeat(hand.keypoints_2d[:1], 40, axis=0)
    points[20:] += 30.0 * np.arange(1, 21)[:, None, None]
    steps = depth_steps_at_rest(replace(hand, keypoints_2d=points))
    # Three frames before the arm sets off are no rest.
    np.testing.assert_allclose(steps, np.full(16, 0.003), atol=1e-9)


def test_a_line_for_each_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = np.stack([np.zeros(45), crossed(18.0)])
    transl = np.tile([0.0, 0.0, 0.5], (2, 1))
    hand = track_of("right", np.zeros((2, 3)), poses, transl, CAMERA)
    path = take_of([hand], CAMERA, 640, 480).save(tmp_path / "crossed.take.npz")
    assert main([str(path)]) == 0
    assert "right hand: 2 frames, 0.500 of them more than 2 mm in itself, 0.500 more than 4 mm" in (
        capsys.readouterr().out
    )
    assert main([str(tmp_path / "none.npz")]) == 1
    assert capsys.readouterr().err.startswith("error: ")
