"""Previews: the picture unchanged on the left, the hands where the model is on the right."""

from __future__ import annotations

import bpy
import numpy as np

from blender_manient.scene.build import build_take
from blender_manient.scene.preview import preview_rows, render_preview, spread_frames

from .conftest import FRAMES, HEIGHT, OFF_CENTRE, UNSEEN, WIDTH


def test_hands_cover_exactly_where_the_model_projects(make_take):
    made = make_take()
    built = build_take(made.take)
    row, frame = made.seen[2]
    both = preview_rows(built, made.take, frame)
    assert both.shape == (HEIGHT, 2 * WIDTH, 3)
    left, right = both[:, :WIDTH], both[:, WIDTH:]
    assert np.abs(left[..., 0] - np.linspace(0, 1, WIDTH)).max() < 0.01, "the picture comes out as it went in"
    covered = np.abs(left - right).max(axis=-1) > 0.02
    pixels = np.concatenate([OFF_CENTRE.project(vertices[row]) for vertices in made.vertices.values()])
    inside = (pixels > 1).all(-1) & (pixels < [WIDTH - 1, HEIGHT - 1]).all(-1)
    columns, rows = np.floor(pixels[inside]).astype(int).T
    assert covered[rows, columns].mean() > 0.9
    # Between neighbouring vertices there is skin; far from all of them there is none.
    assert not covered[: max(0, rows.min() - 2)].any()
    assert not covered[:, columns.max() + 3 :].any()
    unseen = preview_rows(built, made.take, int(FRAMES[UNSEEN]))
    np.testing.assert_allclose(unseen[:, :WIDTH], unseen[:, WIDTH:], atol=1e-6)


def test_preview_leaves_the_file_as_it_was(make_take, tmp_path):
    """Large pictures are made smaller."""
    take = make_take(width=4800, height=2400, sides=("left",)).take
    built = build_take(take)
    bpy.context.scene.frame_set(5)

    def contents() -> dict[str, list[str]]:
        kinds = "scenes objects meshes materials lights cameras images worlds collections".split()
        return {k: [x.name for x in getattr(bpy.data, k) if x.name != "Render Result"] for k in kinds}

    before = contents()
    path = render_preview(built, take, 3, tmp_path / "new folder" / "preview.png")
    assert contents() == before
    assert bpy.context.scene.frame_current == 5
    assert tuple(bpy.data.images.load(str(path)).size) == (2400, 600)


def test_frames_are_spread(make_take):
    take = make_take().take
    assert spread_frames(take, 3) == [3, 12, 18]
    assert spread_frames(take, 1) == [3]
    assert len(spread_frames(take, 100)) == len(FRAMES) - 1
