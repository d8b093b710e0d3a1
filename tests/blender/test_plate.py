"""The picture behind the hands: the right one, upright, on the right frame."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.scene.build import build_take
from blender_manient.scene.plate import load_plate, rows_of
from blender_manient.scene.preview import render_plate
from blender_manient.scene.timing import timing_in
from handfit_core.media.source import Source

from .conftest import HEIGHT, OFF_CENTRE, WIDTH, write_png


def background(built):
    return built.camera.data.background_images[0]


def test_photo_is_shown_behind(make_take, picture):
    built = build_take(make_take().take)
    assert built.warnings == ()
    assert built.camera.data.show_background_images
    assert background(built).image.filepath == str(picture)


def test_picture_can_be_left_out(make_take):
    built = build_take(make_take().take, picture=False)
    assert not built.camera.data.background_images
    assert not bpy.data.images


def test_missing_picture_is_a_warning(make_take, tmp_path):
    gone = str(tmp_path / "gone.png")
    built = build_take(make_take(source=Source("photo", (gone,))).take)
    assert len(built.warnings) == 1
    assert gone in built.warnings[0]
    assert len(built.hands) == 2
    assert not built.camera.data.background_images


def test_hands_of_another_program_have_no_picture_and_the_time_of_a_video(make_take, tmp_path):
    take = make_take(source=Source("data", (str(tmp_path / "walk.npz"),)), fps=12.0).take
    built = build_take(take)
    assert built.warnings == ()
    assert not built.camera.data.background_images
    bpy.context.scene.render.fps, bpy.context.scene.render.fps_base = 24, 1.0
    assert timing_in(bpy.context.scene, take).scale == 2.0


def test_picture_of_another_size_is_a_warning(make_take):
    built = build_take(make_take(width=200, height=100).take)
    assert "160 x 120" in built.warnings[0]


# How a camera stores an upright picture under each EXIF orientation, written out independently.
STORED = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: np.rot90(a, 2),
    4: lambda a: a[::-1],
    5: lambda a: a.transpose(1, 0, 2),
    6: lambda a: np.rot90(a, 1),
    7: lambda a: np.rot90(a, 2).transpose(1, 0, 2),
    8: lambda a: np.rot90(a, -1),
}


@pytest.mark.parametrize("orientation", sorted(STORED))
def test_exif_orientation_is_undone(make_take, tmp_path, orientation):
    upright = np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 4)).astype(np.float32) / 255
    upright[..., 3] = 1.0
    stored = write_png(tmp_path / "turned.png", np.ascontiguousarray(STORED[orientation](upright)))
    source = Source("photo", (str(stored),), orientation)
    built = build_take(make_take(source=source).take)
    image = background(built).image
    assert built.warnings == ()
    assert tuple(image.size) == (WIDTH, HEIGHT)
    np.testing.assert_allclose(rows_of(image), upright, atol=1e-6)
    assert bool(image.packed_file) == (orientation != 1)


def grey(path, value: float):
    """A picture of one grey."""
    rows = np.full((HEIGHT, WIDTH, 4), value, dtype=np.float32)
    rows[..., 3] = 1.0
    return write_png(path, rows)


def test_sequence_shows_the_file_of_the_frames_number(make_take, tmp_path):
    """Rendered, so that Blender's own arithmetic is what is tested."""
    numbers = np.array([8, 9, 11, 12])
    for number in range(5, 16):  # more files on disk than were captured
        grey(tmp_path / f"shot_v2.{number:04d}.png", number / 255 * 10)
    files = tuple(str(tmp_path / f"shot_v2.{n:04d}.png") for n in numbers)
    made = make_take(source=Source("sequence", files), frame_numbers=numbers)
    built = build_take(made.take)
    assert built.warnings == ()
    assert built.collection.name == "shot_v2"
    user = background(built).image_user
    assert (user.frame_start, user.frame_offset, user.frame_duration) == (8, 7, 5)
    plate, _ = load_plate(made.take)
    for number in numbers:
        rows = render_plate(plate, made.take, int(number), 1.0)
        assert np.median(rows[..., 0]) * 255 == pytest.approx(number * 10, abs=1)


def test_numberless_pictures_warn(make_take, tmp_path):
    files = tuple(str(grey(tmp_path / f"{name}.png", 0.5)) for name in ("left", "right"))
    built = build_take(make_take(source=Source("sequence", files), frame_numbers=np.array([1, 2])).take)
    assert "not one numbered sequence" in built.warnings[0]


def test_movie_shows_the_frame(make_take, tmp_path):
    cv2 = pytest.importorskip("cv2")
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (WIDTH, HEIGHT))
    for number in range(1, 21):
        writer.write(np.full((HEIGHT, WIDTH, 3), number * 10, dtype=np.uint8))
    writer.release()
    numbers = np.array([3, 4, 7])
    made = make_take(source=Source("video", (str(path),)), frame_numbers=numbers)
    built = build_take(made.take)
    assert built.warnings == ()
    user = background(built).image_user
    assert (user.frame_start, user.frame_offset, user.frame_duration) == (1, 0, 20)
    plate, _ = load_plate(made.take)
    for number in numbers:
        rows = render_plate(plate, made.take, int(number), 1.0)
        assert np.median(rows[..., 0]) * 255 == pytest.approx(number * 10, abs=3)


def test_plate_is_rendered_unchanged(make_take):
    """Pixel by pixel, through the off-centre, anamorphic camera."""
    made = make_take(intrinsics=OFF_CENTRE)
    plate, _ = load_plate(made.take)
    rows = render_plate(plate, made.take, 1, 1.0)
    assert np.abs(rows - rows_of(plate.image))[..., :3].max() <= 1.01 / 255
