"""The picture behind the hands: the right one, upright, on the right frame."""

from __future__ import annotations

import os
from types import SimpleNamespace

import bpy
import cv2
import numpy as np
import pytest
from mathutils import Euler, Matrix, Vector

from blender_manient.scene import preview
from blender_manient.scene.background import load_plate
from blender_manient.scene.build import build_take
from blender_manient.scene.preview import preview_rows, render_plate, render_preview, spread_frames
from blender_manient.scene.timing import timing_in
from blender_manient.session import source_info
from handfit_core.geometry.picture_map import mapped, picture_to_region
from handfit_core.media.exif import upright
from handfit_core.media.source import Source
from tests.bombs import clip, with_claimed_size
from tests.listener import listening
from tests.playlists import names, playlists

from .conftest import FRAMES, HEIGHT, OFF_CENTRE, UNSEEN, WIDTH, movie, write_png


def background(built):
    return built.camera.data.background_images[0]


def test_hands_of_another_program_have_no_picture_and_the_time_of_a_video(make_take, tmp_path):
    take = make_take(source=Source("data", (str(tmp_path / "walk.npz"),)), fps=12.0).take
    built = build_take(take)
    assert built.warnings == ()
    assert not built.camera.data.background_images
    bpy.context.scene.render.fps, bpy.context.scene.render.fps_base = 24, 1.0
    assert timing_in(bpy.context.scene, take).scale == 2.0


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["photo", "sequence"])
def test_exif_orientation_is_undone(make_take, tmp_path, orientation, kind):
    """`upright` is what the capture undoes it with."""
    stored = np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 4)).astype(np.float32) / 255
    stored[..., 3] = 1.0
    path = write_png(tmp_path / "turned.0003.png", stored)
    expected = upright(stored, orientation)
    size = {"width": expected.shape[1], "height": expected.shape[0]}
    source, numbers = Source(kind, (str(path),), orientation), np.array([3])
    take = make_take(source=source, frame_numbers=numbers, **size).take
    plate, warnings = load_plate(take)
    assert not warnings
    np.testing.assert_allclose(render_plate(plate, take, 3, 1.0), expected, atol=1.5 / 255)


def grey(path, value: float):
    """A picture of one grey."""
    rows = np.full((HEIGHT, WIDTH, 4), value, dtype=np.float32)
    rows[..., 3] = 1.0
    return write_png(path, rows)


@pytest.mark.parametrize(
    ("kind", "numbers", "offsets"),
    [("sequence", [8, 9, 11, 12], (8, 7, 5)), ("video", [3, 4, 7], (1, 0, 40))],
)
def test_a_clip_shows_the_picture_of_the_frames_number(make_take, tmp_path, kind, numbers, offsets):
    """Rendered, so that Blender's own arithmetic is tested. More files lie there than were captured."""
    if kind == "video":
        source = movie(tmp_path / "shot_v2.avi")
    else:
        for number in range(5, 16):
            grey(tmp_path / f"shot_v2.{number:04d}.png", number / 255 * 6)
        source = Source("sequence", tuple(str(tmp_path / f"shot_v2.{n:04d}.png") for n in numbers))
    take = make_take(source=source, frame_numbers=np.array(numbers)).take
    built = build_take(take)
    assert built.warnings == ()
    assert built.collection.name == "shot_v2"
    user = background(built).image_user
    assert (user.frame_start, user.frame_offset, user.frame_duration) == offsets
    plate, _ = load_plate(take)
    for number in numbers:
        rows = render_plate(plate, take, number, 1.0)
        assert np.median(rows[..., 0]) * 255 == pytest.approx(number * 6, abs=3)


def test_a_picture_can_be_left_out_or_missing(make_take, tmp_path):
    assert not build_take(make_take().take, picture=False).camera.data.background_images
    assert not bpy.data.images
    gone = str(tmp_path / "gone.png")
    files = tuple(str(grey(tmp_path / f"{name}.png", 0.5)) for name in ("left", "right"))
    numberless = {"source": Source("sequence", files), "frame_numbers": np.array([1, 2])}
    for fields, said in (
        ({"source": Source("photo", (gone,))}, gone),
        ({"width": 200, "height": 100}, "160 x 120"),
        (numberless, "not one numbered sequence"),
    ):
        built = build_take(make_take(**fields).take)
        assert len(built.warnings) == 1
        assert said in built.warnings[0]
        assert len(built.hands) == 2


# Previews: the picture on the left, the hands where the model is on the right


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


def test_preview_leaves_the_file_as_it_was(make_take, tmp_path, monkeypatch):
    """Large pictures are made smaller."""
    monkeypatch.setattr(preview, "LONGEST_SIDE", WIDTH // 2)
    take = make_take(sides=("left",)).take
    built = build_take(take)
    bpy.context.scene.frame_set(5)

    def contents() -> dict[str, list[str]]:
        kinds = "scenes objects meshes materials lights cameras images worlds collections".split()
        return {k: [x.name for x in getattr(bpy.data, k) if x.name != "Render Result"] for k in kinds}

    before = contents()
    path = render_preview(built, take, 3, tmp_path / "new folder" / "preview.png")
    assert contents() == before
    assert bpy.context.scene.frame_current == 5
    assert tuple(bpy.data.images.load(str(path)).size) == (WIDTH, HEIGHT // 2)


def test_frames_are_spread(make_take):
    take = make_take().take
    assert spread_frames(take, 3) == [3, 12, 18]
    assert spread_frames(take, 1) == [3]
    assert len(spread_frames(take, 100)) == len(FRAMES) - 1


# Handles lie where Blender draws the picture


@pytest.mark.parametrize("moved", [False, True])
def test_the_picture_fills_a_region_of_its_size(make_take, moved):
    made, render = make_take(sides=("right",)), bpy.context.scene.render
    camera = build_take(made.take).camera
    if moved:
        place = Matrix.LocRotScale(Vector((0.3, -2.0, 1.1)), Euler((0.4, -0.2, 2.1)), Vector((2.0, 2.0, 2.0)))
        camera.matrix_world = place @ camera.matrix_world
    bpy.context.view_layer.update()
    # What RegionView3D.perspective_matrix is in a region that shows just the picture.
    projection = camera.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(),
        x=render.resolution_x,
        y=render.resolution_y,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    perspective = np.array(projection @ camera.matrix_world.normalized().inverted())
    place = np.array(camera.matrix_world)
    matrix = picture_to_region(made.take.intrinsics, place, perspective, (WIDTH, HEIGHT))
    pixels = np.array([[0.0, 0.0], [WIDTH, 0.0], [WIDTH, HEIGHT], [31.0, 47.5]])
    expected = np.stack([pixels[:, 0], HEIGHT - pixels[:, 1]], axis=-1)
    np.testing.assert_allclose(mapped(matrix, pixels), expected, atol=0.02)
    np.testing.assert_allclose(mapped(np.linalg.inv(matrix), expected), pixels, atol=0.02)


# A take may name any file: what Blender is given as the picture behind the hands is looked at first.


def test_a_name_is_no_address(make_take, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = clip(tmp_path / "clip.mp4")
    with listening(tmp_path) as (port, connections):
        for name in names(port):
            (tmp_path / name).write_bytes(content)
            built = build_take(make_take(source=Source("video", (name,)), width=64, height=48).take)
            image = built.camera.data.background_images[0].image
            assert image.filepath == str(tmp_path / name)
            assert tuple(image.size) == (64, 48)
            assert source_info.resolve(name, as_sequence=False).files == (str(tmp_path / name),)
        assert connections() == 0


@pytest.mark.parametrize("kind", ["video", "photo", "sequence"])
def test_a_playlist_is_no_picture(make_take, tmp_path, kind):
    path = tmp_path / "list.0001.mp4"
    with listening(tmp_path) as (port, connections):
        for content in playlists(f"http://127.0.0.1:{port}/clip.mp4").values():
            path.write_bytes(content)
            built = build_take(make_take(source=Source(kind, (str(path),))).take)
            assert len(built.warnings) == 1
            assert "cannot read" in built.warnings[0]
            assert not built.camera.data.background_images
        assert connections() == 0
    assert not bpy.data.images


def test_a_source_is_what_it_holds(tmp_path):
    (tmp_path / "a").write_bytes(clip(tmp_path / "clip.mp4"))
    (tmp_path / "b").write_bytes(with_claimed_size(".png", 80, 48))
    kinds = [source_info.resolve(str(tmp_path / name), as_sequence=False).kind for name in "ab"]
    assert kinds == ["video", "photo"]


def test_a_picture_that_claims_too_much_is_not_loaded(make_take, tmp_path):
    path = tmp_path / "large.jpg"
    path.write_bytes(with_claimed_size(".jpg", 32000, 32000))
    take = make_take(source=Source("photo", (str(path),))).take
    built = build_take(take)
    assert "claims 32000 x 32000 pixels (1024 megapixels)" in built.warnings[0]
    assert not bpy.data.images
    path.write_bytes(cv2.imencode(".jpg", np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8))[1].tobytes())
    assert build_take(take, max_megapixels=1.0).warnings == ()
    assert "no more than 0.01 are read" in build_take(take, max_megapixels=0.01).warnings[0]


def test_every_picture_that_blender_would_show_is_looked_at(make_take, tmp_path):
    """Also those between the captured ones, which no take names; a pipe is not opened."""
    files = [tmp_path / f"shot.{number:04}.png" for number in range(1, 6)]
    for file in files:
        grey(file, 0.0)
    captured = Source("sequence", tuple(str(files[row]) for row in (0, 1, 3)))
    take = make_take(source=captured, frame_numbers=np.array([1, 2, 4])).take
    large = with_claimed_size(".png", 16000, 15000)
    assert build_take(take).warnings == ()
    files[4].write_bytes(large)
    assert build_take(take).warnings == ()  # behind the last
    files[2].write_bytes(large)
    assert "shot.0003.png: claims 16000 x 15000" in build_take(take).warnings[0]
    if hasattr(os, "mkfifo"):
        files[1].unlink()
        os.mkfifo(files[1])
        assert "there is no such file" in build_take(take).warnings[0]


def test_no_drop_of_what_may_not_be_read(tmp_path):
    clip(tmp_path / "hidden.mp4")
    (tmp_path / "list.mp4").write_bytes(playlists(str(tmp_path / "hidden.mp4"))["hls"])
    for name in ("list.mp4", "hidden.mp4"):
        footage = source_info.dropped_footage(SimpleNamespace(camera="SOLVE"), tmp_path / name)
        assert (footage is None) == (name == "list.mp4")
