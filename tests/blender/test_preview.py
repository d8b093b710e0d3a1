"""Previews: the picture unchanged on the left, the hands where the model is on the right."""

from __future__ import annotations

from pathlib import Path

import bpy
import cv2
import numpy as np
import pytest

from blender_manient.scene.build import build_take
from blender_manient.scene.preview import preview_rows, render_preview, spread_frames
from handfit_core.geometry.rotations import rotvec_to_rotmat
from scripts import side_view
from scripts.side_view import turned_rows

from .conftest import FRAMES, HEIGHT, OFF_CENTRE, UNSEEN, WIDTH


def test_hands_cover_exactly_where_the_model_projects(make_take):
    made = make_take()
    built = build_take(made.take)
    row, frame = made.seen[2]
    both = preview_rows(built, made.take, frame)
    assert both.shape == (HEIGHT, 2 * WIDTH, 3)
    left, right = both[:, :WIDTH], both[:, WIDTH:]
    ramp = np.linspace(0, 1, WIDTH)
    assert np.abs(left[..., 0] - ramp).max() < 0.01, "the picture comes out as it went in"
    covered = np.abs(left - right).max(axis=-1) > 0.02
    pixels = np.concatenate([OFF_CENTRE.project(made.vertices[s][row]) for s in ("left", "right")])
    inside = (pixels > 1).all(-1) & (pixels < [WIDTH - 1, HEIGHT - 1]).all(-1)
    columns, rows = np.floor(pixels[inside]).astype(int).T
    near = np.zeros_like(covered)
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            near[np.clip(rows + dy, 0, HEIGHT - 1), np.clip(columns + dx, 0, WIDTH - 1)] = True
    assert covered[rows, columns].mean() > 0.9
    # Between neighbouring vertices there is skin; far from all of them there is none.
    assert not covered[: max(0, rows.min() - 2)].any()
    assert not covered[:, columns.max() + 3 :].any()


def test_frames_without_a_hand_show_the_picture_only(make_take):
    made = make_take()
    both = preview_rows(build_take(made.take), made.take, int(FRAMES[UNSEEN]))
    np.testing.assert_allclose(both[:, :WIDTH], both[:, WIDTH:], atol=1e-6)


def test_preview_leaves_the_file_as_it_was(make_take, tmp_path):
    bpy.ops.mesh.primitive_cube_add()
    made = make_take()
    built = build_take(made.take)
    bpy.context.scene.frame_set(5)
    before = _contents()
    path = render_preview(built, made.take, made.seen[0][1], tmp_path / "new folder" / "preview.png")
    assert path.stat().st_size > 0
    assert _contents() == before
    assert bpy.context.scene.frame_current == 5


def _contents() -> dict[str, list[str]]:
    kinds = "scenes objects meshes materials lights cameras images worlds collections".split()
    return {k: sorted(x.name for x in getattr(bpy.data, k) if x.name != "Render Result") for k in kinds}


def test_large_pictures_are_made_smaller(make_take):
    made = make_take(width=4800, height=2400, sides=("left",))
    both = preview_rows(build_take(made.take), made.take, 3)
    assert both.shape == (600, 2400, 3)


def test_spread_frames(make_take):
    take = make_take().take
    assert spread_frames(take, 3) == [3, 12, 18]
    assert spread_frames(take, 1) == [3]
    assert len(spread_frames(take, 100)) == len(FRAMES) - 1


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
