import math
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.media.exif import known_intrinsics, read_focal_35mm, read_orientation, upright
from handfit_core.media.opening import open_media
from handfit_core.media.pictures import read_picture
from tests.bombs import clip


def tiff_block(orientation: int, order: str) -> bytes:
    mark = {"<": b"II*\0", ">": b"MM\0*"}[order]
    # A second tag before it, so that the search is a search.
    entries = struct.pack(order + "HHIHH", 0x0100, 3, 1, 640, 0)
    entries += struct.pack(order + "HHIHH", 0x0112, 3, 1, orientation, 0)
    return mark + struct.pack(order + "IH", 8, 2) + entries + struct.pack(order + "I", 0)


def encoded(suffix: str) -> bytes:
    pixels = np.zeros((4, 6, 3), dtype=np.uint8)
    return cv2.imencode(suffix, pixels)[1].tobytes()


def jpeg_with_exif(data: bytes, block: bytes) -> bytes:
    segment = b"Exif\0\0" + block
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + data[2:]


def with_exif(suffix: str, block: bytes) -> bytes:
    data = encoded(suffix)
    if suffix == ".jpg":
        return jpeg_with_exif(data, block)
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


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_damaged_metadata_is_upright(suffix: str) -> None:
    data = with_exif(suffix, tiff_block(6, "<"))
    start = data.index(b"II*\0")
    for end in range(2, start + 40):
        assert read_orientation(data[:end]) in (1, 6)
    assert read_orientation(with_exif(suffix, tiff_block(77, "<"))) == 1
    assert read_orientation(encoded(suffix)) == 1


def test_upright_agrees_with_opencv(tmp_path) -> None:
    """OpenCV undoes the orientation of JPEGs itself; ours must do the same."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (3, 5, 3), dtype=np.uint8)
    pixels = np.repeat(np.repeat(coarse, 16, axis=0), 16, axis=1)
    plain = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    for orientation in range(1, 9):
        buffer = np.frombuffer(jpeg_with_exif(plain, tiff_block(orientation, ">")), dtype=np.uint8)
        stored = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(upright(stored, orientation), cv2.imdecode(buffer, cv2.IMREAD_COLOR))


def test_tiff_is_turned_once(tmp_path) -> None:
    """OpenCV turns TIFFs whatever one asks for."""
    pixels = np.zeros((12, 20, 3), dtype=np.uint8)
    pixels[0, 0] = 255  # top left as stored
    params = [cv2.IMWRITE_TIFF_COMPRESSION, 1]
    data = bytearray(cv2.imencode(".tif", pixels, params)[1].tobytes())
    corners = [(0, 0), (0, 19), (11, 19), (11, 0), (0, 0), (0, 11), (19, 11), (19, 0)]
    for orientation, corner in enumerate(corners, 1):
        path = tmp_path / f"{orientation}.tif"
        path.write_bytes(with_tiff_orientation(bytes(data), orientation))
        rgb, found = read_picture(path)
        assert found == orientation
        assert tuple(int(i) for i in np.argwhere(rgb[..., 0] == 255)[0]) == corner


def with_tiff_orientation(data: bytes, orientation: int) -> bytes:
    """The same TIFF with an orientation tag: its directory copied to the end with one more entry."""
    (offset,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, offset)
    entries = [data[offset + 2 + 12 * i : offset + 14 + 12 * i] for i in range(count)]
    entries = [e for e in entries if struct.unpack_from("<H", e)[0] != 0x0112]
    entries.append(struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0))
    entries.sort(key=lambda e: struct.unpack_from("<H", e)[0])
    data += b"\0" * (len(data) % 2)
    directory = struct.pack("<H", len(entries)) + b"".join(entries) + struct.pack("<I", 0)
    return data[:4] + struct.pack("<I", len(data)) + data[8:] + directory


def lens_block(millimetres: int, order: str = "<", kind: int = 3, orientation: int = 1) -> bytes:
    """A first directory that names EXIF's own one, which names the focal length; each behind another tag."""
    mark = {"<": b"II*\0", ">": b"MM\0*"}[order]
    first = struct.pack(order + "HHHIHH", 2, 0x0112, 3, 1, orientation, 0)
    first += struct.pack(order + "HHIII", 0x8769, 4, 1, 38, 0)
    entries = struct.pack(order + "HHIHH", 0xA402, 3, 1, 1, 0)
    entries += struct.pack(order + "HHIHH", 0xA405, kind, 1, millimetres, 0)
    return mark + struct.pack(order + "I", 8) + first + struct.pack(order + "H", 2) + entries + bytes(4)


def photo(path: Path, block: bytes | None, width: int = 60, height: int = 40) -> Path:
    data = cv2.imencode(".jpg", np.full((height, width, 3), 90, dtype=np.uint8))[1].tobytes()
    path.write_bytes(data if block is None else jpeg_with_exif(data, block))
    return path


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_reads_the_focal_length(suffix: str, order: str) -> None:
    assert read_focal_35mm(with_exif(suffix, lens_block(26, order))) == 26.0
    assert read_focal_35mm(lens_block(300, order)) == 300.0


def test_focal_lengths_that_are_none() -> None:
    """Zero means unknown (EXIF 2.32); a value of another type is not taken, nor another directory's."""
    assert read_focal_35mm(with_exif(".jpg", lens_block(0, "<"))) is None
    assert read_focal_35mm(with_exif(".jpg", lens_block(26, "<", kind=5))) is None
    assert read_focal_35mm(with_exif(".jpg", tiff_block(6, "<"))) is None


def test_the_camera_of_a_photo(tmp_path: Path) -> None:
    """A 26 mm lens sees 2 atan(43.27 / 52) across the diagonal, on any sensor; 50 mm are 50/36 of a full
    frame's width. The principal point is of the upright picture."""
    found = known_intrinsics(open_media(photo(tmp_path / "a.jpg", lens_block(26, ">"))))
    assert found is not None
    half_angle = math.atan(math.hypot(36, 24) / 2 / 26)
    assert found.fx == found.fy == pytest.approx(math.hypot(60, 40) / 2 / math.tan(half_angle))
    turned = known_intrinsics(open_media(photo(tmp_path / "b.jpg", lens_block(26, orientation=6))))
    assert turned is not None
    assert (turned.fx, turned.cx, turned.cy) == pytest.approx((found.fx, 20.0, 30.0))
    found = known_intrinsics(open_media(photo(tmp_path / "a.jpg", lens_block(50), 360, 240)))
    assert found is not None
    assert (found.fx, found.cx, found.cy) == pytest.approx((500.0, 180.0, 120.0))


def test_a_sequence_goes_by_its_first_picture(tmp_path: Path) -> None:
    for i, focal in enumerate((35, 85), start=1):
        photo(tmp_path / f"shot_{i:04d}.jpg", lens_block(focal))
    media = open_media(str(tmp_path / "shot_%04d.jpg"))
    found = known_intrinsics(media)
    assert found is not None
    assert found.fx == pytest.approx(35 / math.hypot(36, 24) * math.hypot(60, 40))
    (tmp_path / "shot_0001.jpg").unlink()
    assert known_intrinsics(media) is None


@pytest.mark.parametrize("block", [None, lens_block(0), lens_block(26)[:20], b"no tiff"], ids=str)
def test_pictures_that_do_not_tell(tmp_path: Path, block: bytes | None) -> None:
    assert known_intrinsics(open_media(photo(tmp_path / "a.jpg", block))) is None


def test_videos_do_not_tell(tmp_path: Path) -> None:
    clip(tmp_path / "clip.avi", "MJPG")
    assert known_intrinsics(open_media(tmp_path / "clip.avi")) is None
