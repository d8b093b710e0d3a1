"""What a picture claims, read without a decoder, is what a decoder finds."""

from __future__ import annotations

import io
import struct

import cv2
import numpy as np
import pytest

from handfit_core.media.headers import Header, read_picture_header
from tests.bombs import with_app_segments, with_claimed_size

SUFFIXES = (".jpg", ".png", ".webp", ".bmp", ".tif", ".jp2", ".ppm", ".pgm", ".hdr")


def encoded(suffix: str, pixels: np.ndarray, *options: int) -> bytes:
    return cv2.imencode(suffix, pixels, list(options))[1].tobytes()


def read(data: bytes) -> Header | None:
    return read_picture_header(io.BytesIO(data))


def picture(suffix: str, height: int = 48, width: int = 80) -> np.ndarray:
    channels, kind = (1 if suffix == ".pgm" else 3), (np.float32 if suffix == ".hdr" else np.uint8)
    return np.random.default_rng(1).integers(0, 200, (height, width, channels)).astype(kind)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_size(suffix: str) -> None:
    found = read(encoded(suffix, picture(suffix)))
    assert found is not None
    assert (found.width, found.height) == (80, 48)


@pytest.mark.parametrize(
    ("suffix", "pixels", "options", "cost"),
    [
        (".png", np.uint8, (), 1),
        (".png", np.uint16, (), 3),
        (".ppm", np.uint16, (), 3),
        (".tif", np.uint16, (), 3),
        (".tif", np.float32, (), 4),
        (".tif", np.float64, (), 8),
        (".hdr", np.float32, (), 4),
        (".jp2", np.uint8, (), 4),
        (".jpg", np.uint8, (), 1),
        (".jpg", np.uint8, (cv2.IMWRITE_JPEG_PROGRESSIVE, 1), 1.4),
        (".webp", np.uint8, (cv2.IMWRITE_WEBP_QUALITY, 50), 1),
        (".webp", np.uint8, (cv2.IMWRITE_WEBP_QUALITY, 101), 2),
    ],
)
def test_cost(suffix: str, pixels: type, options: tuple[int, ...], cost: float) -> None:
    found = read(encoded(suffix, np.zeros((48, 80, 3), dtype=pixels), *options))
    assert found == Header(80, 48, cost)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_changed_claim_is_read(suffix: str) -> None:
    found = read(with_claimed_size(suffix, 16000, 15000))
    assert found is not None
    assert (found.width, found.height) == (16000, 15000)


def test_size_behind_large_metadata() -> None:
    data = with_app_segments(encoded(".jpg", picture(".jpg")), 40)
    assert len(data) > 2_000_000
    assert read(data) == Header(80, 48)
    assert read(data[:2] + b"\xff\xff\xff" + data[3:]) == Header(80, 48)  # padding before a marker


def tiff(order: str, *tags: tuple[int, int]) -> bytes:
    """With these tags and values, in the picture's own or the other type of numbers."""
    sizes = b"".join(struct.pack(order + "HHII", tag, 4, 1, v) for tag, v in tags if tag not in (258, 277))
    counts = b"".join(struct.pack(order + "HHIHH", tag, 3, 1, v, 0) for tag, v in tags if tag in (258, 277))
    mark = {"<": b"II*\0", ">": b"MM\0*"}[order]
    return mark + struct.pack(order + "IH", 8, len(tags)) + sizes + counts + bytes(4)


def test_a_large_tile_counts() -> None:
    """A decoder holds a whole tile."""
    data = tiff(">", (256, 80), (257, 48), (258, 8), (277, 1), (322, 30000), (323, 29000))
    assert read(data) == Header(30000, 29000)


def test_many_channels_count() -> None:
    assert read(tiff("<", (256, 80), (257, 48), (258, 16), (277, 400))) == Header(80, 48, 300)
    whole = encoded(".jp2", picture(".jp2"))
    at = whole.index(b"\xff\x4f\xff\x51") + 40
    assert read(whole[:at] + struct.pack(">H", 4000) + whole[at + 2 :]) == Header(80, 48, 4000)


def test_other_files_are_none() -> None:
    for data in (b"", b"\0" * 50, b"this is a text", b"GIF89a" + bytes(30), b"RIFF____AVI " + bytes(30)):
        assert read(data) is None
