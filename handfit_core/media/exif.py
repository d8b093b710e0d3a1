"""The tags that matter here, read without an imaging library: EXIF's orientation and focal length, and the
focal length of clips.

OpenCV either drops a picture's orientation or applies it while also dropping alpha and 16 bits, so
the tag is read here and undone by `upright`.
"""

from __future__ import annotations

import io
import math
import re
import struct
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.headers import PICTURES, read_tiff_tags, read_video_focal_35mm
from handfit_core.media.settings import MEDIA
from handfit_core.media.source import Media

_ORIENTATION, _EXIF_DIRECTORY, _FOCAL_35MM = 0x0112, 0x8769, 0xA405
SHORTEST, LONGEST = 4.0, 2000.0
"""Shortest and longest focal length that is believed, in mm as on 35 mm film"""
_TIFF: Final = rb"(?:Exif\0\0)?(?=II\*\0|MM\0\*)"
_MARKERS: Final = {
    PICTURES["JPEG"]: re.compile(rb"\xff\xe1..Exif\0\0" + _TIFF, re.DOTALL),
    PICTURES["PNG"]: re.compile(rb"eXIf" + _TIFF),
    PICTURES["WebP"]: re.compile(rb"EXIF.{4}" + _TIFF, re.DOTALL),
    _TIFF: re.compile(_TIFF),
    PICTURES["HEIC"]: re.compile(rb"\0\0\0[\0\x06]" + _TIFF),
}
"""Pattern of what stands before the tags, by a picture's first bytes; the chance that it matches something
else is 2^-64"""


def read_orientation(data: bytes) -> int:
    """Return the EXIF orientation 1-8 of an encoded JPEG, PNG, WebP or TIFF; 1 where there is none."""
    value = _number(data, _ORIENTATION)
    return value if 1 <= value <= 8 else 1


def read_focal_35mm(data: bytes) -> float | None:
    """Return the focal length in mm as on 35 mm film (EXIF FocalLengthIn35mmFilm); None where there is
    none."""
    return float(_number(data, _EXIF_DIRECTORY, _FOCAL_35MM)) or None


def _number(data: bytes, *tags: int) -> int:
    """Return the number of the last of the tags, of which each one leads to the directory of the next one; 0
    where there is none, and in damaged metadata, which are no reason to refuse a picture."""
    for container, marker in _MARKERS.items():
        if re.match(container, data, re.DOTALL) and (found := marker.search(data)):
            block = io.BytesIO(data[found.end() : found.end() + MEDIA.exif_bytes])
            break
    else:
        return 0
    value = None
    try:
        for tag in tags:
            value = read_tiff_tags(block, value)[tag]
    except (struct.error, KeyError):
        return 0
    return value or 0


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Undo an EXIF orientation: turn pixels (H, W, ...) as stored into pixels as meant to be seen (a view
    where possible).

    Orientations 5-8 swap height and width.
    """
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels


def known_intrinsics(media: Media) -> Intrinsics | None:
    """Return the camera of a clip, photo or image sequence whose first file names its focal length
    (QuickTime's tags, EXIF; 35 mm film); None where it does not. For a picture that was cropped afterwards
    the result is wrong, which nothing in the file shows."""
    is_video = media.source.kind == "video"
    try:
        with open(Path(media.source.files[0]), "rb") as stream:
            tag = (
                read_video_focal_35mm(stream) if is_video else read_focal_35mm(stream.read(MEDIA.exif_bytes))
            )
    except OSError:
        return None
    if tag is None or not SHORTEST <= tag <= LONGEST:
        return None
    # Equivalent focal lengths of photos are defined by equal diagonals (CIPA DCG-001), while phones that film
    # use the sensor's whole width: measured lenses of 14 phones are 0.97 to 1.02 of what that gives.
    focal = tag / 36.0 * max(media.width, media.height)
    if not is_video:
        focal = tag / math.hypot(36.0, 24.0) * math.hypot(media.width, media.height)
    return Intrinsics(focal, focal, media.width / 2.0, media.height / 2.0)
