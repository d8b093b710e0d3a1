import struct
import zlib

import cv2
import numpy as np
import pytest

from handfit_core.exif import read_orientation, upright


def tiff_block(orientation: int, order: str) -> bytes:
    mark = {"<": b"II*\0", ">": b"MM\0*"}[order]
    # A second tag before it, so that the search is a search.
    entries = struct.pack(order + "HHIHH", 0x0100, 3, 1, 640, 0)
    entries += struct.pack(order + "HHIHH", 0x0112, 3, 1, orientation, 0)
    return mark + struct.pack(order + "IH", 8, 2) + entries + struct.pack(order + "I", 0)


def encoded(suffix: str) -> bytes:
    pixels = np.zeros((4, 6, 3), dtype=np.uint8)
    return cv2.imencode(suffix, pixels)[1].tobytes()


def with_exif(suffix: str, block: bytes) -> bytes:
    data = encoded(suffix)
    if suffix == ".jpg":
        segment = b"Exif\0\0" + block
        return data[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + data[2:]
    if suffix == ".png":
        chunk = b"eXIf" + block
        chunk = struct.pack(">I", len(block)) + chunk + struct.pack(">I", zlib.crc32(chunk))
        return data[:33] + chunk + data[33:]  # behind the header chunk
    chunk = b"EXIF" + struct.pack("<I", len(block)) + block + b"\0" * (len(block) % 2)
    body = data[8:] + chunk
    return b"RIFF" + struct.pack("<I", len(body)) + body


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_reads_what_is_written(suffix: str, order: str, orientation: int) -> None:
    assert read_orientation(with_exif(suffix, tiff_block(orientation, order))) == orientation


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".bmp"])
def test_no_tag_is_upright(suffix: str) -> None:
    assert read_orientation(encoded(suffix)) == 1


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_damaged_metadata_is_upright(suffix: str) -> None:
    data = with_exif(suffix, tiff_block(6, "<"))
    start = data.index(b"II*\0")
    for end in range(2, start + 40):
        assert read_orientation(data[:end]) in (1, 6)
    assert read_orientation(with_exif(suffix, tiff_block(77, "<"))) == 1


def test_upright_agrees_with_opencv(tmp_path) -> None:
    """OpenCV undoes the orientation of JPEGs itself; ours must do the same."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (3, 5, 3), dtype=np.uint8)
    pixels = np.repeat(np.repeat(coarse, 16, axis=0), 16, axis=1)
    plain = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    for orientation in range(1, 9):
        segment = b"Exif\0\0" + tiff_block(orientation, ">")
        data = plain[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + plain[2:]
        buffer = np.frombuffer(data, dtype=np.uint8)
        stored = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(upright(stored, orientation), cv2.imdecode(buffer, cv2.IMREAD_COLOR))
