"""The camera from a photo's EXIF, written here byte by byte."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.media.lens import known_intrinsics
from handfit_core.media.opening import open_media

WIDTH, HEIGHT = 60, 40


def exif(focal_35mm: int, order: str = "<", orientation: int = 1) -> bytes:
    """A TIFF block: the first directory holds the orientation, EXIF's own the focal length."""
    mark = {"<": b"II*\0", ">": b"MM\0*"}[order]
    entries = struct.pack(order + "HHIHH", 0x0112, 3, 1, orientation, 0)
    entries += struct.pack(order + "HHII", 0x8769, 4, 1, 8 + 2 + 24 + 4)
    first = struct.pack(order + "H", 2) + entries + struct.pack(order + "I", 0)
    entry = struct.pack(order + "HHIHH", 0xA405, 3, 1, focal_35mm, 0)
    nested = struct.pack(order + "H", 1) + entry + struct.pack(order + "I", 0)
    return mark + struct.pack(order + "I", 8) + first + nested


def jpeg(path: Path, block: bytes | None, width: int = WIDTH, height: int = HEIGHT) -> Path:
    data = cv2.imencode(".jpg", np.full((height, width, 3), 90, dtype=np.uint8))[1].tobytes()
    if block is not None:
        segment = b"Exif\0\0" + block
        data = data[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + data[2:]
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("order", "<>")
def test_focal_length_in_pixels(tmp_path: Path, order: str) -> None:
    """A 26 mm lens sees 2 atan(43.27 / 52) across the diagonal, on any sensor."""
    found = known_intrinsics(open_media(jpeg(tmp_path / "a.jpg", exif(26, order))))
    assert found is not None
    half_angle = math.atan(math.hypot(36, 24) / 2 / 26)
    expected = math.hypot(WIDTH, HEIGHT) / 2 / math.tan(half_angle)
    assert found.fx == found.fy == pytest.approx(expected)
    assert (found.cx, found.cy) == (WIDTH / 2, HEIGHT / 2)


def test_a_full_frame_picture_is_exact(tmp_path: Path) -> None:
    """36 x 24 mm: 50 mm are 50/36 of the width."""
    found = known_intrinsics(open_media(jpeg(tmp_path / "a.jpg", exif(50), 360, 240)))
    assert found is not None
    assert (found.fx, found.cx, found.cy) == pytest.approx((500.0, 180.0, 120.0))


def test_a_picture_on_its_side(tmp_path: Path) -> None:
    """The principal point is of the upright picture; the diagonal stays."""
    plain = known_intrinsics(open_media(jpeg(tmp_path / "a.jpg", exif(26))))
    turned = known_intrinsics(open_media(jpeg(tmp_path / "b.jpg", exif(26, orientation=6))))
    assert plain is not None
    assert turned is not None
    assert turned.fx == pytest.approx(plain.fx)
    assert (turned.cx, turned.cy) == (HEIGHT / 2, WIDTH / 2)


def test_a_sequence_goes_by_its_first_picture(tmp_path: Path) -> None:
    for i, focal in enumerate((35, 85), start=1):
        jpeg(tmp_path / f"shot_{i:04d}.jpg", exif(focal))
    found = known_intrinsics(open_media(str(tmp_path / "shot_%04d.jpg")))
    assert found is not None
    assert found.fx == pytest.approx(35 / math.hypot(36, 24) * math.hypot(WIDTH, HEIGHT))


@pytest.mark.parametrize(
    "block", [None, exif(0), exif(26)[:20], b"no tiff"], ids=["none", "zero", "cut", "junk"]
)
def test_pictures_that_do_not_tell(tmp_path: Path, block: bytes | None) -> None:
    assert known_intrinsics(open_media(jpeg(tmp_path / "a.jpg", block))) is None


def test_a_file_that_is_gone(tmp_path: Path) -> None:
    media = open_media(jpeg(tmp_path / "a.jpg", exif(26)))
    (tmp_path / "a.jpg").unlink()
    assert known_intrinsics(media) is None


def test_videos_do_not_tell(tmp_path: Path) -> None:
    path = tmp_path / "clip.avi"
    fourcc = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(path), fourcc, 25.0, (WIDTH, HEIGHT))
    for _ in range(3):
        writer.write(np.full((HEIGHT, WIDTH, 3), 90, dtype=np.uint8))
    writer.release()
    assert known_intrinsics(open_media(path)) is None
