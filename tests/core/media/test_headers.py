"""What a file claims by its first bytes, read without a decoder."""

import io
import struct
import zlib

import cv2
import numpy as np
import pytest

from handfit_core.media.headers import Header, read_picture_header, read_video_header
from tests.bombs import clip, with_app_segments, with_sample_count
from tests.playlists import playlists


def encoded(suffix: str, kind: type = np.uint8, *options: int, channels: int = 3) -> bytes:
    return cv2.imencode(suffix, np.zeros((48, 80, channels), kind), list(options))[1].tobytes()


def picture(data: bytes) -> Header | None:
    return read_picture_header(io.BytesIO(data))


def video(data: bytes) -> Header | None:
    return read_video_header(io.BytesIO(data))


@pytest.mark.parametrize(
    ("data", "cost"),
    [
        (encoded(".jpg"), 1),
        (encoded(".jpg", np.uint8, cv2.IMWRITE_JPEG_PROGRESSIVE, 1), 1),
        (with_app_segments(encoded(".jpg"), 40), 1),
        (encoded(".jpg").replace(b"\xff", b"\xff\xff\xff", 2)[2:], 1),  # padding before a marker
        (encoded(".png"), 1),
        (encoded(".png", np.uint16), 3),
        (encoded(".webp", np.uint8, cv2.IMWRITE_WEBP_QUALITY, 50), 1),
        (encoded(".webp", np.uint8, cv2.IMWRITE_WEBP_QUALITY, 101), 2),
        (encoded(".bmp"), 1),
        (encoded(".tif", np.uint16), 3),
        (encoded(".tif", np.float32), 4),
        (encoded(".tif", np.float64), 8),
        (encoded(".ppm", np.uint16), 3),
        (encoded(".pgm", channels=1), 1),
        (encoded(".pbm", channels=1), 1),
        (encoded(".hdr", np.float32), 4),
        (b"P5 # 9 9\n80 # a # comment\n#\n48\n255\n", 1),
    ],
    ids=lambda value: str(value)[:12],
)
def test_size_and_cost(data, cost):
    assert picture(data) == Header(80, 48, cost)


def tiff(order: str, *tags: tuple[int, int]) -> bytes:
    """With these tags and values, in the picture's own or the other type of numbers."""
    sizes = b"".join(struct.pack(order + "HHII", tag, 4, 1, v) for tag, v in tags if tag not in (258, 277))
    counts = b"".join(struct.pack(order + "HHIHH", tag, 3, 1, v, 0) for tag, v in tags if tag in (258, 277))
    mark = {"<": b"II*\0", ">": b"MM\0*"}[order]
    return mark + struct.pack(order + "IH", 8, len(tags)) + sizes + counts + bytes(4)


def test_large_tiles_and_many_channels_count():
    """A decoder holds a whole tile."""
    data = tiff(">", (256, 80), (257, 48), (258, 8), (277, 1), (322, 30000), (323, 29000))
    assert picture(data) == Header(30000, 29000)
    assert picture(tiff("<", (256, 80), (257, 48), (258, 16), (277, 400))) == Header(80, 48, 300)


def png_of(*chunks: tuple[bytes, bytes], size: int | None = None) -> bytes:
    """A PNG of 64 x 48 pixels with these chunks, the last of which claims another `size`."""
    header = b"IHDR", struct.pack(">2I5B", 64, 48, 8, 6, 0, 0, 0)
    parts = [(len(data), name + data) for name, data in (header, *chunks)]
    parts[-1] = size or parts[-1][0], parts[-1][1]
    each = (struct.pack(">I", size) + data + struct.pack(">I", zlib.crc32(data)) for size, data in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(each)


def test_a_png_holds_what_it_says():
    assert picture(png_of((b"IDAT", bytes(100)), (b"IEND", b"")) + bytes(1000)) == Header(64, 48)
    for name in (b"IDAT", b"tEXt"):
        assert picture(png_of((name, bytes(100)), size=0x7FFF_0000)) is None
    for frame in ((16_000, 16_000, 0, 0), (64, 48, 1, 0)):
        assert picture(png_of((b"fcTL", struct.pack(">5I6x", 0, *frame)), (b"IEND", b""))) is None


def test_videos(tmp_path):
    for name in ("mp4 mp4v", "mov mp4v", "avi MJPG", "mkv mp4v", "webm VP80", "wmv WMV2"):
        suffix, code = name.split()
        assert video(clip(tmp_path / f"a.{suffix}", code)) == Header()
    assert video(b"GIF89a" + struct.pack("<HH", 64, 48) + bytes(20)) == Header(64, 48)
    assert video(b"GIF89a" + bytes(20)) is None  # FFmpeg would look for what else it may be
    packet = b"G\x40\0\x10" + bytes(184)
    by_chance = b"G\x40\0\x10" + b"<mPd" + bytes(180)  # compressed data may hold any four bytes
    for data in (
        *(b"\0\0\1\xba" + bytes(40), b"\0\0\1\xb3" + bytes(40), b"OggS\0\2", b"FLV\1", b"\x1f\7\0\xbf"),
        *(packet * 5, (bytes(4) + packet) * 5, by_chance * 5),
    ):
        assert video(data) == Header()


def test_what_is_no_picture_and_no_video():
    lists = [each for to in ("http://127.0.0.1/a.ts", "/etc/hostname") for each in playlists(to).values()]
    for data in (b"", bytes(50), b"text", b"OggS\nmore", b"\x1a\x45\xdf\xa3" + b"c=IN IP4 1\n" * 9, *lists):
        assert picture(data) is None
        assert video(data) is None
    assert picture(b"GIF89a" + bytes(30)) is None
    assert video(b"RIFF____WEBP") is None


def test_more_frames_than_bytes(tmp_path):
    whole = clip(tmp_path / "a.mp4")
    assert video(with_sample_count(whole, len(whole) - 1)) == Header()
    assert video(with_sample_count(whole, len(whole) + 1)) is None
    fragment = b"trun" + struct.pack(">II", 0, 1 << 20)
    part = struct.pack(">I", len(fragment) + 4) + fragment
    for name in (b"traf", b"moof"):
        part = struct.pack(">I", len(part) + 8) + name + part
    assert video(whole + part) is None
    at = whole.index(b"mvhd")
    assert video(whole[:at] + b"cmov" + whole[at + 4 :]) is None  # to be unpacked to whatever it claims
    assert video(struct.pack(">I4s", 8, b"free") * 200_000) is None
