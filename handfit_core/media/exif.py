"""The two EXIF tags that matter here, read without an imaging library: orientation and focal length.

OpenCV either drops a picture's orientation or applies it while also dropping alpha and 16 bits, so
the tag is read here and undone by `upright`.
"""

from __future__ import annotations

import math
import re
import struct
from pathlib import Path

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.settings import MEDIA
from handfit_core.media.source import Media

_ORIENTATION_TAG = 0x0112
_EXIF_IFD_TAG = 0x8769
_FOCAL_35MM_TAG = 0xA405
_SHORT = 3


def read_orientation(data: bytes) -> int:
    """EXIF orientation 1-8 of an encoded JPEG, PNG, WebP or TIFF; 1 where there is none."""
    value = _short(data, _ORIENTATION_TAG)
    return value if value is not None and 1 <= value <= 8 else 1


def read_focal_35mm(data: bytes) -> float | None:
    """Focal length in mm as on 35 mm film (EXIF FocalLengthIn35mmFilm); None where there is none."""
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
            directory = _ifd_value(tiff, order, directory, within, 4)
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
    if is_tiff(data):
        return data
    # The bytes before the tags, by a picture's first bytes
    for container, marker in {
        rb"\xff\xd8": rb"\xff\xe1..Exif\0\0",
        rb"\x89PNG\r\n\x1a\n": rb"eXIf",
        rb"RIFF.{4}WEBP": rb"EXIF.{4}",
    }.items():
        if re.match(container, data, re.DOTALL):
            # The chance that these bytes are no EXIF marker is 2^-64.
            found = re.compile(marker + rb"(?:Exif\0\0)?(?=II\*\0|MM\0\*)", re.DOTALL).search(data)
            return data[found.end() : found.end() + MEDIA.exif_bytes] if found else None
    return None


def _ifd_value(tiff: bytes, order: str, offset: int, tag: int, wanted: int) -> int | None:
    (count,) = struct.unpack_from(order + "H", tiff, offset)
    for i in range(count):
        entry = offset + 2 + 12 * i
        found, kind = struct.unpack_from(order + "HH", tiff, entry)
        if found == tag and kind == wanted:
            return struct.unpack_from(order + ("H" if kind == _SHORT else "I"), tiff, entry + 8)[0]
    return None


def known_intrinsics(media: Media) -> Intrinsics | None:
    """The camera of a photo or image sequence whose first file names its focal length (EXIF, 35 mm film);
    None where it does not, and for videos. For a picture that was cropped afterwards the result is wrong,
    which nothing in the file shows."""
    if media.source.kind == "video":
        return None
    try:
        with open(Path(media.source.files[0]), "rb") as stream:
            focal_mm = read_focal_35mm(stream.read(MEDIA.exif_bytes))
    except OSError:
        return None
    if focal_mm is None:
        return None
    # In millimetres: equivalent focal lengths are defined by equal diagonals (CIPA DCG-001)
    focal = focal_mm / math.hypot(36.0, 24.0) * math.hypot(media.width, media.height)
    return Intrinsics(focal, focal, media.width / 2.0, media.height / 2.0)
