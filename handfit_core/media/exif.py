"""The few EXIF tags that matter here, read without an imaging library: how a picture is turned, and its lens.

OpenCV either drops a picture's orientation or applies it while also dropping alpha and 16 bits, so
the tag is read here and undone by `upright`.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.source import Media

_ORIENTATION_TAG = 0x0112
_EXIF_IFD_TAG = 0x8769
_FOCAL_35MM_TAG = 0xA405
_SHORT = 3
_LONG = 4


def read_orientation(data: bytes) -> int:
    """EXIF orientation 1-8 of an encoded JPEG, PNG, WebP or TIFF; 1 where there is none."""
    value = _short(data, _ORIENTATION_TAG)
    return value if value is not None and 1 <= value <= 8 else 1


def read_focal_35mm(data: bytes) -> float | None:
    """Focal length in mm as on 35 mm film (EXIF FocalLengthIn35mmFilm); None where it is not told."""
    value = _short(data, _FOCAL_35MM_TAG, within=_EXIF_IFD_TAG)
    return float(value) if value else None


def _short(data: bytes, tag: int, within: int | None = None) -> int | None:
    """A tag's 16-bit number, from the first directory or from the one that the tag `within` leads to; None
    where there is none, and in damaged metadata, which are no reason to refuse a picture."""
    try:
        tiff = _tiff_block(data)
        order = None if tiff is None else {b"II": "<", b"MM": ">"}.get(tiff[:2])
        if tiff is None or order is None:
            return None
        (directory,) = struct.unpack_from(order + "I", tiff, 4)
        if within is not None:
            directory = _ifd_value(tiff, order, directory, within, _LONG)
        return None if directory is None else _ifd_value(tiff, order, directory, tag, _SHORT)
    except (struct.error, IndexError, ValueError):
        return None


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Undo an EXIF orientation: (H, W, ...) as stored -> as meant to be seen (a view where possible).

    Orientations 5-8 swap height and width.
    """
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels


def is_tiff(data: bytes) -> bool:
    """Whether an encoded picture is a TIFF, which OpenCV turns upright by itself."""
    return data[:4] in (b"II*\0", b"MM\0*")


def _tiff_block(data: bytes) -> bytes | None:
    """The TIFF structure that holds the EXIF tags, from the container around it."""
    if data[:2] == b"\xff\xd8":
        return _from_jpeg(data)
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return _from_chunks(data, 8, ">I", b"eXIf", type_first=False)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        block = _from_chunks(data, 12, "<I", b"EXIF", type_first=True)
        return block[6:] if block and block[:6] == b"Exif\0\0" else block
    if is_tiff(data):
        return data
    return None


def _from_jpeg(data: bytes) -> bytes | None:
    position = 2
    while data[position] == 0xFF:
        marker = data[position + 1]
        if marker == 0xDA:  # the picture itself starts; metadata comes before
            return None
        (length,) = struct.unpack_from(">H", data, position + 2)
        segment = data[position + 4 : position + 2 + length]
        if marker == 0xE1 and segment[:6] == b"Exif\0\0":
            return segment[6:]
        position += 2 + length
    return None


def _from_chunks(
    data: bytes, start: int, size_format: str, wanted: bytes, *, type_first: bool
) -> bytes | None:
    """Walk PNG chunks (size, type, data, checksum) or RIFF chunks (type, size, data, padding)."""
    position = start
    while position + 8 <= len(data):
        kind_at, size_at = (0, 4) if type_first else (4, 0)
        kind = data[position + kind_at : position + kind_at + 4]
        (size,) = struct.unpack_from(size_format, data, position + size_at)
        if kind == wanted:
            return data[position + 8 : position + 8 + size]
        position += 8 + size + (size % 2 if type_first else 4)
    return None


def _ifd_value(tiff: bytes, order: str, offset: int, tag: int, wanted: int) -> int | None:
    (count,) = struct.unpack_from(order + "H", tiff, offset)
    for i in range(count):
        entry = offset + 2 + 12 * i
        found, kind = struct.unpack_from(order + "HH", tiff, entry)
        if found == tag and kind == wanted:
            return struct.unpack_from(order + ("H" if kind == _SHORT else "I"), tiff, entry + 8)[0]
    return None


FILM_DIAGONAL: Final = math.hypot(36.0, 24.0)
"""mm; equivalent focal lengths are defined by equal diagonals (CIPA DCG-001)"""
_HEAD: Final = 1 << 20
"""Bytes; EXIF tags stand at a file's beginning"""


def known_intrinsics(media: Media) -> Intrinsics | None:
    """The camera of a photo or image sequence whose first file names its focal length (EXIF, 35 mm film);
    None where it does not, and for videos. A picture that was cropped afterwards misleads: nothing in it
    tells."""
    if media.source.kind == "video":
        return None
    try:
        with open(Path(media.source.files[0]), "rb") as stream:
            focal_mm = read_focal_35mm(stream.read(_HEAD))
    except OSError:
        return None
    if focal_mm is None:
        return None
    focal = focal_mm / FILM_DIAGONAL * math.hypot(media.width, media.height)
    return Intrinsics(focal, focal, media.width / 2.0, media.height / 2.0)
