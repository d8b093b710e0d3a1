"""Hands from a second viewpoint, and scripts/side_view.py, which shows them moving."""

from __future__ import annotations

from pathlib import Path

import bpy
import cv2
import numpy as np
import pytest

from blender_manient.scene.build import build_take
from handfit_core.geometry.rotations import rotvec_to_rotmat
from scripts import side_view
from scripts.side_view import turned_rows

from .conftest import HEIGHT, WIDTH


@pytest.fixture
def take_file(make_take, tmp_path) -> Path:
    return make_take(sides=("right",)).take.save(tmp_path / "one.take.npz")


@pytest.mark.parametrize("degrees", [0.0, 70.0, -120.0])
def test_the_turned_hand_stands_where_geometry_says(make_take, degrees):
    """Its silhouette's box is that of the vertices, turned about the joints' middle the other way."""
    made = make_take(sides=("right",))
    built = build_take(made.take, picture=False)
    line = made.seen[1]
    (image,) = turned_rows(built, made.take, [line[1]], degrees)
    background = image[0, 0]
    drawn = np.abs(image - background).max(axis=-1) > 0.05
    centre = made.take.hands[0].joints_3d[line[0]].mean(axis=0)
    # The camera goes to its right: seen from it, what stands still turns about the upward axis (-y).
    turn = rotvec_to_rotmat(np.array([0.0, np.radians(degrees), 0.0]))
    points = (made.vertices["right"][line[0]] - centre) @ turn.T + centre
    pixels = made.take.intrinsics.project(points)
    rows, columns = np.nonzero(drawn)
    box = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    low, high = (
        np.clip(pixels.min(axis=0), 0, [WIDTH, HEIGHT]),
        np.clip(pixels.max(axis=0), 0, [WIDTH, HEIGHT]),
    )
    np.testing.assert_allclose(box, [*low, *high], atol=2.0)


def test_a_view_from_one_place_shows_how_hands_move(make_take):
    """The boxes of two frames lie as far apart as geometry says, about the middle of both."""
    made = make_take(sides=("right",))
    built = build_take(made.take, picture=False)
    lines = [made.seen[0], made.seen[-1]]
    images = turned_rows(built, made.take, [line[1] for line in lines], 60.0, still=True)
    centre = made.take.hands[0].joints_3d[[line[0] for line in lines]].mean(axis=(0, 1))
    turn = rotvec_to_rotmat(np.array([0.0, np.radians(60.0), 0.0]))
    for image, line in zip(images, lines, strict=True):
        drawn = np.abs(image - image[0, 0]).max(axis=-1) > 0.05
        points = (made.vertices["right"][line[0]] - centre) @ turn.T + centre
        pixels = made.take.intrinsics.project(points)
        rows, columns = np.nonzero(drawn)
        expected = np.clip([pixels.min(axis=0), pixels.max(axis=0)], 0, [WIDTH, HEIGHT])
        found = [[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]]
        np.testing.assert_allclose(found, expected, atol=2.0)


def test_a_moving_picture_of_takes_beside_each_other(take_file, tmp_path, make_take, capsys):
    numbers = [number for _, number in make_take(sides=("right",)).seen]
    view = tmp_path / "view.webp"
    ask = [f"one={take_file}", f"two={take_file}", "-o", str(view), "--size", "64"]
    frames = ["--frames", f"{numbers[0]}-{numbers[0]}"]
    assert side_view.main([*ask, *frames]) == 0
    found, animation = cv2.imreadanimation(str(view))
    assert found
    assert [picture.shape[:2] for picture in animation.frames] == [(64, 128)]
    one, two = animation.frames[0][30:, :64, :3].astype(int), animation.frames[0][30:, 64:, :3].astype(int)
    assert one.max() - one.min() > 60
    assert np.abs(one - two).mean() < 6.0
    assert side_view.main([f"one={tmp_path / 'gone.take.npz'}", *ask[2:], *frames]) == 1
    assert "gone" in capsys.readouterr().err


def test_nothing_is_left_behind(make_take):
    made = make_take(sides=("right",))
    built = build_take(made.take, picture=False)
    before = {name: len(getattr(bpy.data, name)) for name in ("objects", "cameras", "scenes", "materials")}
    turned_rows(built, made.take, [made.seen[0][1]], 30.0)
    assert {name: len(getattr(bpy.data, name)) for name in before} == before
