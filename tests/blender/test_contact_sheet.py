"""scripts/contact_sheet.py: rows of frames, and the hands from a second viewpoint."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient.scene.build import build_take
from blender_manient.scene.plate import rows_of
from blender_manient.scene.preview import turned_rows
from handfit_core.geometry.rotations import rotvec_to_rotmat
from scripts.contact_sheet import find_takes, main, row

from .conftest import HEIGHT, WIDTH

GAP = 4


def picture(path: Path) -> np.ndarray:
    """(H, W) brightness, the first row on top."""
    return rows_of(bpy.data.images.load(str(path)))[..., :3].mean(axis=-1)


@pytest.fixture
def take_file(make_take, tmp_path) -> Path:
    return make_take(sides=("right",)).take.save(tmp_path / "one.take.npz")


def test_one_row_a_take(take_file, tmp_path):
    sheet = tmp_path / "sheet.png"
    assert main([str(take_file), str(take_file), "-o", str(sheet), "--frames", "2", "--height", "30"]) == 0
    height, width = picture(sheet).shape
    # A frame and its hand side by side, twice.
    assert (height, width) == (2 * (30 + GAP), 2 * (2 * WIDTH * 30 // HEIGHT + GAP))


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


def test_nothing_is_left_behind(make_take):
    made = make_take(sides=("right",))
    built = build_take(made.take, picture=False)
    before = {name: len(getattr(bpy.data, name)) for name in ("objects", "cameras", "scenes", "materials")}
    turned_rows(built, made.take, [made.seen[0][1]], 30.0)
    assert {name: len(getattr(bpy.data, name)) for name in before} == before


def test_row_without_turned_is_narrower(make_take):
    take = make_take(sides=("right",)).take
    plain, turned = row(take, 1, 24), row(take, 1, 24, 45.0)
    cell = round(WIDTH * 24 / HEIGHT)
    assert plain.shape == (24, 2 * cell + GAP, 3)
    assert turned.shape == (24, 3 * cell + GAP, 3)
    np.testing.assert_allclose(turned[:, : 2 * cell - 2], plain[:, : 2 * cell - 2], atol=0.1)


def test_folders_and_mistakes(make_take, tmp_path, capsys):
    for name in ("b", "a"):
        make_take(sides=("right",)).take.save(tmp_path / "takes" / f"{name}.take.npz")
    assert len(find_takes(tmp_path / "takes")) == 2
    (tmp_path / "empty").mkdir()
    assert main([str(tmp_path / "empty"), "-o", str(tmp_path / "sheet.png")]) == 1
    assert "no takes" in capsys.readouterr().err
    assert main([str(tmp_path / "gone.take.npz"), "-o", str(tmp_path / "sheet.png")]) == 1
    assert not (tmp_path / "sheet.png").exists()
