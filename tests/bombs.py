"""Small files that claim to be enormous, made from good ones."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np


def _good(suffix: str) -> bytes:
    channels, kind = (1 if suffix == ".pgm" else 3), (np.float32 if suffix == ".hdr" else np.uint8)
    options = [cv2.IMWRITE_WEBP_QUALITY, 50] if suffix == ".webp" else []
    return cv2.imencode(suffix, np.zeros((48, 80, channels), dtype=kind), options)[1].tobytes()


def with_claimed_size(suffix: str, width: int, height: int) -> bytes:
    """A picture whose header claims this size; what follows is that of 80 x 48 pixels."""
    data = _good(suffix)
    old, new = (80, 48), (width, height)
    if suffix in (".ppm", ".pgm"):
        return data.replace(b"80 48", f"{width} {height}".encode(), 1)
    if suffix == ".hdr":
        return data.replace(b"-Y 48 +X 80", f"-Y {height} +X {width}".encode(), 1)
    if suffix == ".tif":
        order = "<" if data[:2] == b"II" else ">"
        for tag, value in ((256, width), (257, height)):
            at = next(
                i
                for i in range(8, len(data) - 12)
                if struct.unpack_from(order + "HHI", data, i) in ((tag, 3, 1), (tag, 4, 1))
            )
            data = data[:at] + struct.pack(order + "HHII", tag, 4, 1, value) + data[at + 12 :]
        return data
    if suffix == ".jpg":
        old, new = old[::-1], new[::-1]
    layouts = {".jpg": ">HH", ".png": ">II", ".webp": "<HH", ".bmp": "<ii"}
    assert struct.pack(layouts[suffix], *old) in data
    data = data.replace(struct.pack(layouts[suffix], *old), struct.pack(layouts[suffix], *new))
    if suffix == ".png":
        data = data[:29] + struct.pack(">I", zlib.crc32(data[12:29])) + data[33:]
    return data


def with_app_segments(jpeg: bytes, count: int) -> bytes:
    """A JPEG with so many segments of metadata, each of 64 kB."""
    return jpeg[:2] + (b"\xff\xe2" + struct.pack(">H", 65535) + bytes(65533)) * count + jpeg[2:]


def clip(path: Path, code: str = "mp4v", frames: int = 10) -> bytes:
    """A video of 64 x 48 pixels, written to `path`."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 25.0, (64, 48))
    for i in range(frames):
        writer.write(np.full((48, 64, 3), 20 * i, dtype=np.uint8))
    writer.release()
    return path.read_bytes()


def with_frame_count(mp4: bytes, count: int) -> bytes:
    """An MP4 whose table of times claims so many frames."""
    at = mp4.index(b"stts") + 12
    return mp4[:at] + struct.pack(">I", count) + mp4[at + 4 :]


def with_sample_count(mp4: bytes, count: int) -> bytes:
    """An MP4 whose table of sizes claims so many frames, of one byte each."""
    at = mp4.index(b"stsz") + 8
    return mp4[:at] + struct.pack(">II", 1, count) + mp4[at + 8 :]
