"""Orientation and focal length, as cameras write them into pictures."""

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
from tests.plates import box

ORDERS = {"<": b"II*\0", ">": b"MM\0*"}


def tiff_block(orientation: int = 1, order: str = "<", focal: int | None = None, kind: int = 3) -> bytes:
    """A directory with an orientation and, for a focal length in millimetres, EXIF's own directory with a
    number of this kind; each behind another tag."""

    def directory(*entries: tuple[int, int, int]) -> bytes:
        packed = (
            struct.pack(order + "HHI" + ("I" if e[1] == 4 else "Hxx"), *e[:2], 1, e[2]) for e in entries
        )
        return struct.pack(order + "H", len(entries)) + b"".join(packed) + bytes(4)

    first = [(0x0100, 3, 640), (0x0112, 3, orientation)]
    header = ORDERS[order] + struct.pack(order + "I", 8)
    if focal is None:
        return header + directory(*first)
    return header + directory(*first, (0x8769, 4, 50)) + directory((0xA402, 3, 1), (0xA405, kind, focal))


def encoded(suffix: str, pixels: np.ndarray | None = None) -> bytes:
    return cv2.imencode(suffix, np.zeros((4, 6, 3), np.uint8) if pixels is None else pixels)[1].tobytes()


def with_exif(suffix: str, block: bytes, data: bytes | None = None) -> bytes:
    data = encoded(suffix) if data is None else data
    if suffix == ".jpg":
        segment = b"Exif\0\0" + block
        return data[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + data[2:]
    if suffix == ".png":
        chunk = b"eXIf" + block
        chunk = struct.pack(">I", len(block)) + chunk + struct.pack(">I", zlib.crc32(chunk))
        return data[:33] + chunk + data[33:]  # behind the header chunk
    body = data[8:] + b"EXIF" + struct.pack("<I", len(block)) + block + b"\0" * (len(block) % 2)
    return b"RIFF" + struct.pack("<I", len(body)) + body


def photo(path: Path, block: bytes | None, width: int = 60, height: int = 40) -> Path:
    data = encoded(".jpg", np.full((height, width, 3), 90, dtype=np.uint8))
    path.write_bytes(data if block is None else with_exif(".jpg", block, data))
    return path


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_reads_what_is_written(suffix, order):
    for orientation in range(1, 9):
        data = with_exif(suffix, tiff_block(orientation, order, 26))
        assert (read_orientation(data), read_focal_35mm(data)) == (orientation, 26.0)
    assert read_focal_35mm(tiff_block(1, order, 300)) == 300.0


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_damaged_metadata_is_upright(suffix):
    data = with_exif(suffix, tiff_block(6))
    for end in range(2, data.index(b"II*\0") + 40):
        assert read_orientation(data[:end]) in (1, 6)
    assert read_orientation(with_exif(suffix, tiff_block(77))) == 1
    assert read_orientation(encoded(suffix)) == 1


def test_upright_agrees_with_opencv():
    """OpenCV undoes the orientation of JPEGs itself; ours must do the same."""
    coarse = np.random.default_rng(0).integers(0, 255, (3, 5, 3), dtype=np.uint8)
    plain = encoded(".jpg", coarse.repeat(16, axis=0).repeat(16, axis=1))
    for orientation in range(1, 9):
        buffer = np.frombuffer(with_exif(".jpg", tiff_block(orientation, ">"), plain), dtype=np.uint8)
        stored = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(upright(stored, orientation), cv2.imdecode(buffer, cv2.IMREAD_COLOR))


def test_tiff_is_turned_once(tmp_path):
    """OpenCV turns TIFFs whatever one asks for."""
    pixels = np.zeros((12, 20, 3), dtype=np.uint8)
    pixels[0, 0] = 255  # top left as stored
    data = cv2.imencode(".tif", pixels, [cv2.IMWRITE_TIFF_COMPRESSION, 1])[1].tobytes()
    (offset,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, offset)
    entries = [data[offset + 2 + 12 * i :][:12] for i in range(count)]
    entries = [each for each in entries if each[:2] != struct.pack("<H", 0x0112)]
    data += b"\0" * (len(data) % 2)
    corners = [(0, 0), (0, 19), (11, 19), (11, 0), (0, 0), (0, 11), (19, 11), (19, 0)]
    for orientation, corner in enumerate(corners, 1):
        tag = struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0)
        tags = sorted([*entries, tag], key=lambda each: struct.unpack_from("<H", each))
        directory = struct.pack("<H", len(tags)) + b"".join(tags) + bytes(4)
        path = tmp_path / f"{orientation}.tif"
        path.write_bytes(data[:4] + struct.pack("<I", len(data)) + data[8:] + directory)
        rgb, found = read_picture(path)
        assert found == orientation
        assert tuple(int(i) for i in np.argwhere(rgb[..., 0] == 255)[0]) == corner


def test_the_camera_of_a_photo(tmp_path):
    """A 26 mm lens sees 2 atan(43.27 / 52) across the diagonal, on any sensor; 50 mm are 50/36 of a full
    frame's width. The principal point is of the upright picture."""
    found = known_intrinsics(open_media(photo(tmp_path / "a.jpg", tiff_block(1, ">", 26))))
    assert found is not None
    half_angle = math.atan(math.hypot(36, 24) / 2 / 26)
    assert found.fx == found.fy == pytest.approx(math.hypot(60, 40) / 2 / math.tan(half_angle))
    turned = known_intrinsics(open_media(photo(tmp_path / "b.jpg", tiff_block(6, focal=26))))
    assert turned is not None
    assert (turned.fx, turned.cx, turned.cy) == pytest.approx((found.fx, 20.0, 30.0))
    # A sequence goes by its first picture.
    for i, focal in enumerate((50, 85), start=1):
        photo(tmp_path / f"shot_{i:04d}.jpg", tiff_block(focal=focal), 360, 240)
    media = open_media(str(tmp_path / "shot_%04d.jpg"))
    found = known_intrinsics(media)
    assert found is not None
    assert (found.fx, found.cx, found.cy) == pytest.approx((500.0, 180.0, 120.0))
    (tmp_path / "shot_0001.jpg").unlink()
    assert known_intrinsics(media) is None


UNKNOWN = {
    "no metadata": None,
    "zero, which means unknown": tiff_block(focal=0),
    "a fraction": tiff_block(focal=26, kind=5),
    "cut off": tiff_block(focal=26)[:20],
}


@pytest.mark.parametrize("block", UNKNOWN.values(), ids=UNKNOWN)
def test_pictures_and_videos_that_do_not_tell(tmp_path, block):
    assert known_intrinsics(open_media(photo(tmp_path / "a.jpg", block))) is None
    clip(tmp_path / "clip.avi", "MJPG")
    assert known_intrinsics(open_media(tmp_path / "clip.avi")) is None


def phone_tags(value: bytes, kind: int, *, version: bool) -> bytes:
    """Metadata as phones write them, of which the second is the focal length."""
    names = [b"com.apple.quicktime.make", b"com.apple.quicktime.camera.focal_length.35mm_equivalent"]
    keys = [box(b"mdta", name) for name in names]
    items = [(1, 1, b"Phone"), (2, kind, value)]
    listed = [
        struct.pack(">II", 24 + len(v), i) + box(b"data", struct.pack(">II", k, 0), v) for i, k, v in items
    ]
    head = [bytes(4)] if version else []
    return box(b"meta", *head, box(b"keys", struct.pack(">II", 0, 2), *keys), box(b"ilst", *listed))


def with_tags(path: Path, tags: bytes, *, in_track: bool) -> None:
    """Put metadata into a film that ends with its header, or into its only track."""
    data = bytearray(path.read_bytes())
    film, track = data.index(b"moov") - 4, data.index(b"trak") - 4
    (length,) = struct.unpack_from(">I", data, track)
    for at in (film, track) if in_track else (film,):
        struct.pack_into(">I", data, at, struct.unpack_from(">I", data, at)[0] + len(tags))
    data = data[: track + length] + tags + data[track + length :] if in_track else data + tags
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("value", "kind", "told", "in_track"),
    [
        (b"50.00mm", 1, 50.0, False),
        (struct.pack(">i", 27), 21, 27.0, True),
        (struct.pack(">f", 13.5), 23, 13.5, False),
        (b"wide", 1, None, True),
        (struct.pack(">f", math.nan), 23, None, False),
        (bytes([255]) * 200, 0, None, False),
    ],
)
def test_the_camera_of_a_phones_clip(tmp_path, value, kind, told, in_track):
    """Its focal length is told by the width of what is filmed, which 36 mm stand for."""
    path = tmp_path / "clip.mp4"
    clip(path, "mp4v")
    with_tags(path, phone_tags(value, kind, version=in_track), in_track=in_track)
    media = open_media(path)
    found = known_intrinsics(media)
    expected = None if told is None else told / 36.0 * max(media.width, media.height)
    assert (found and found.fx) == (expected and pytest.approx(expected))
    path.write_bytes(path.read_bytes()[:-7])
    known_intrinsics(media)
