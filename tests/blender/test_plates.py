"""What Blender shows behind the hands is what the capture read, pixel for pixel and moment for moment."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from blender_manient.scene.background import Plate, load_plate
from blender_manient.scene.camera import show_behind
from blender_manient.scene.preview import render_plate
from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import capture_to_file
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.copies import copy_path, write_copy
from handfit_core.media.opening import open_media
from tests.clips import MATRICES, written_clip
from tests.plates import dpx

FRAMES = 40
LEFT_OUT = 17


def picture(number: int) -> np.ndarray:
    """(48, 64, 3) uint8: as grey as the number tells, with four corners that differ."""
    rgb = np.full((48, 64, 3), 4 + 6 * number, dtype=np.uint8)
    rgb[:12, :16], rgb[:12, -16:], rgb[-12:, :16] = (200, 30, 30), (30, 200, 30), (30, 30, 200)
    return rgb


def trim(path: Path) -> None:
    """Hide the first frames and the last ones of an MP4 by its edit list, as phones do."""
    data = bytearray(path.read_bytes())
    at = data.index(b"elst") + 12
    _, began = struct.unpack_from(">2i", data, at)
    (scale,) = struct.unpack_from(">I", data, data.index(b"mdhd") + 16)
    struct.pack_into(">2i", data, at, 20 * 1000 // 25, began + LEFT_OUT * scale // 25)
    path.write_bytes(data)


def times(*steps: float) -> list[float]:
    """When the pictures are shown, in frames, with these steps between two."""
    return np.cumsum(np.random.default_rng(2).choice(steps, FRAMES)).tolist()


KINDS = {
    "upright": {},
    **{f"orientation {each}": {"orientation": each} for each in (2, 3, 4, 5, 6, 7, 8)},
    "wide pixels": {"aspect": Fraction(2, 1)},
    "high pixels, turned": {"aspect": Fraction(1, 2), "orientation": 6},
    "wavering rate": {"times": times(0.98, 1.0, 1.04)},
    "variable rate": {"times": times(0.8, 1.7, 2.5)},
    "trimmed": {},
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_clip(make_take, tmp_path, kind):
    path = written_clip(tmp_path / "clip.mp4", [picture(n) for n in range(FRAMES)], **KINDS[kind])
    if kind == "trimmed":
        trim(path)
    assert min(shown_frames(make_take, path)) == (LEFT_OUT if kind == "trimmed" else 0)


@pytest.mark.parametrize(("name", "codec", "count"), [("a.apng", "apng", FRAMES), ("a.avif", "libsvtav1", 1)])
def test_a_copy_of_what_blender_cannot_read(make_take, tmp_path, monkeypatch, name, codec, count):
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path / "cache"))
    path = written_clip(tmp_path / name, [picture(n) for n in range(count)], codec=codec)
    media = open_media(path)
    capture_to_file(path, tmp_path / "a.take.npz", CaptureOptions(), bare=True)
    written = copy_path(media.source)
    assert written is not None
    made = written.stat().st_mtime_ns
    shown_frames(make_take, path, min(count, 10))
    write_copy(media.source)
    assert written.stat().st_mtime_ns == made
    assert [image.name for image in bpy.data.images if image.packed_file] == ["a"][: count == 1]
    path.touch()
    assert copy_path(media.source) != written


def test_a_dpx(make_take, tmp_path):
    path = tmp_path / "a.dpx"
    path.write_bytes(dpx(picture(9)))
    assert shown_frames(make_take, path, 1) == {9}


def shown_frames(make_take, path: Path, count: int = 10) -> set[int]:
    """The numbers of the pictures of as many of a clip's frames, which Blender shows as they were read."""
    media = open_media(path)
    read = [frame for frame in media.frames() if frame.rgb is not None]
    numbers = np.arange(1, read[-1].number + 1)
    size = {"width": media.width, "height": media.height}
    take = make_take(sides=(), source=media.source, fps=media.fps, frame_numbers=numbers, **size).take
    plate, warnings = load_plate(take)
    assert not warnings
    found = set()
    for frame in read[:: len(read) // count][:count]:
        shown = render_plate(plate, take, frame.number, 1.0)[..., :3] * 255
        assert shown.shape == frame.rgb.shape
        assert np.abs(shown - frame.rgb).mean() < 3.5
        found.add(round((float(np.median(frame.rgb)) - 4) / 6))
    assert len(found) == count
    return found


@pytest.mark.parametrize("orientation", sorted(MATRICES))
def test_the_viewport_shows_what_renders_show(orientation):
    """Blender flips a background picture, and turns it clockwise then."""
    plate = Plate(bpy.data.images.new("plate", 64, 48), orientation=orientation)
    width, height = (64, 48) if orientation < 5 else (48, 64)
    take = SimpleNamespace(width=width, height=height, intrinsics=Intrinsics(130.0, 100.0, 30.0, 30.0))
    background = show_behind(bpy.data.cameras.new("camera"), plate, take, None)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    flipped = corners * [-1 if background.use_flip_x else 1, -1 if background.use_flip_y else 1]
    c, s = np.cos(background.rotation), np.sin(background.rotation)
    shown = flipped @ np.array([[c, -s], [s, c]])
    np.testing.assert_allclose(2 * plate.places((shown + 1) / 2) - 1, corners, atol=1e-6)
    mirrored = plate.mirrored().places((shown * [-1, 1] + 1) / 2)
    np.testing.assert_allclose(2 * mirrored - 1, corners, atol=1e-6)
