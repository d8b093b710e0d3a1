"""The few EXIF tags that matter here, read without an imaging library.

OpenCV either drops a picture's orientation or applies it while also dropping alpha and 16 bits, so
the tag is read here and undone by `upright`.
"""

from __future__ import annotations

import struct

import numpy as np

_ORIENTATION_TAG = 0x0112
_EXIF_IFD_TAG = 0x8769
_FOCAL_35MM_TAG = 0xA405
_SHORT = 3
_LONG = 4


def read_orientation(data: bytes) -> int:
    """EXIF orientation 1-8 of an encoded JPEG, PNG, WebP or TIFF; 1 where there is none."""
    try:
        tiff = _tiff_block(data)
        value = None if tiff is None else _first_ifd_short(tiff, _ORIENTATION_TAG)
    except (struct.error, IndexError, ValueError):
        return 1  # damaged metadata is no reason to refuse a picture
    return value if value is not None and 1 <= value <= 8 else 1


def read_focal_35mm(data: bytes) -> float | None:
    """Focal length in mm as on 35 mm film (EXIF FocalLengthIn35mmFilm); None where it is not told."""
    try:
        tiff = _tiff_block(data)
        value = None if tiff is None else _exif_ifd_short(tiff, _FOCAL_35MM_TAG)
    except (struct.error, IndexError, ValueError):
        return None
    return float(value) if value else None


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


def _first_ifd_short(tiff: bytes, tag: int) -> int | None:
    order = _byte_order(tiff)
    if order is None:
        return None
    (offset,) = struct.unpack_from(order + "I", tiff, 4)
    return _ifd_value(tiff, order, offset, tag, _SHORT)


def _exif_ifd_short(tiff: bytes, tag: int) -> int | None:
    order = _byte_order(tiff)
    if order is None:
        return None
    (offset,) = struct.unpack_from(order + "I", tiff, 4)
    nested = _ifd_value(tiff, order, offset, _EXIF_IFD_TAG, _LONG)
    return None if nested is None else _ifd_value(tiff, order, nested, tag, _SHORT)


def _byte_order(tiff: bytes) -> str | None:
    return {b"II": "<", b"MM": ">"}.get(tiff[:2])


def _ifd_value(tiff: bytes, order: str, offset: int, tag: int, wanted: int) -> int | None:
    (count,) = struct.unpack_from(order + "H", tiff, offset)
    for i in range(count):
        entry = offset + 2 + 12 * i
        found, kind = struct.unpack_from(order + "HH", tiff, entry)
        if found == tag and kind == wanted:
            return struct.unpack_from(order + ("H" if kind == _SHORT else "I"), tiff, entry + 8)[0]
    return None
