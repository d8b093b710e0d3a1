"""Size limits: pictures and videos that claim too many pixels, or are no pictures and videos, are refused
before anything decodes them. The core checks before OpenCV opens a file, the add-on before Blender does.

A limit that is given (`max_megapixels`) holds for every picture and every frame, whatever its bits and its
file's size. By default pictures and videos have a limit each, and a lower one where the whole input has so
few bytes that only a hostile one would need as much memory. Pictures with more than 8 bits per channel count
several times (`Header.cost`) in small files, and in those with fewer bytes than pixels, which can hardly need
so many bits.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from handfit_core.common.errors import InputError
from handfit_core.media.headers import PICTURES, Header, begins, read_picture_header, read_video_header
from handfit_core.media.kinds import unreadable

SMALL_FILE: Final = 10_000_000
"""Bytes below which an input counts as small; it may claim less than a larger one, so that it needs less than
1 GB in the worker and in Blender. That a larger one needs more surprises nobody."""


@dataclass(frozen=True)
class Limit:
    """Megapixels that one picture, or one frame of a video, may have by default."""

    small_file: float
    large_file: float

    def of(self, path: Path) -> float:
        """Return the limit, in megapixels, for a picture or frame in this file."""
        return self.small_file if path.stat().st_size < SMALL_FILE else self.large_file

    def __str__(self) -> str:
        return f"{self.large_file:g}, in inputs under {SMALL_FILE / 1e6:g} MB {self.small_file:g}"


PICTURE: Final = Limit(64.0, 250.0)
"""Full-frame cameras and most phones have up to 61; the largest sensors have 200 in phones and 151 in
cameras."""
VIDEO: Final = Limit(12.0, 80.0)
"""4K has 8.3 to 12, 8K 36 and 12K 80. Decoders keep up to some 30 frames at once, of one and a half bytes a
pixel."""
_NO_PATTERNS: Final = frozenset(".mp4 .mov .m4v .mkv .webm .avi .mts .m2ts .mxf .wmv .mpg .mpeg .ogv".split())
LONGEST_SIDE: Final = 65_535
"""Pixels; no JPEG is longer"""


def common_limit(files: Sequence[Path], max_megapixels: float | None) -> float | Limit | None:
    """Return the limit, in megapixels, for each of an input's pictures: the one that is given, or that of
    large files where the pictures are large together. None: each has the limit of its own file."""
    if max_megapixels is not None or len(files) < 2:
        return max_megapixels
    left = SMALL_FILE
    for file in files:
        with contextlib.suppress(OSError):  # reading it will say so
            left -= file.stat().st_size
        if left <= 0:
            return Limit(PICTURE.large_file, PICTURE.large_file)
    return None


def check_picture(path: Path, max_megapixels: float | Limit | None = None) -> None:
    """Check a picture's header. Raises InputError where it claims more than `max_megapixels`, or is no
    picture that can be read."""
    _check(path, _header(path, read_picture_header), max_megapixels or PICTURE)


def check_video(
    path: Path, max_megapixels: float | Limit | None = None, size: tuple[int, int] | None = None
) -> None:
    """Raise InputError for a file that is no video which holds its frames itself: a playlist would make
    FFmpeg open other files and addresses. `max_megapixels` is the limit for each frame, of which `size` is
    width and height; None: as far as the header says it, as a GIF's does."""
    _check(path, Header(*size) if size else _header(path, read_video_header), max_megapixels or VIDEO)


def check_for_blender(path: Path, max_megapixels: float | Limit | None = None) -> None:
    """Raise InputError for a file that Blender should not be given as picture or video: one that is neither,
    one that it cannot read, one that is too large, and a video with %d in its name whose ending does not keep
    its FFmpeg from taking that for the numbers of pictures."""
    if begins(path, PICTURES["HEIC"]):
        raise InputError(f"{path}: this is a HEIC or AVIF photo, which few Blenders read; export it as JPEG")
    if is_picture(path):
        check_picture(path, max_megapixels)
        return
    check_video(path, max_megapixels)
    if path.suffix.lower() not in _NO_PATTERNS and re.search(r"%\d*d", str(path.absolute())):
        raise InputError(
            f"{path}: Blender takes %d in the names of a video and its folders for other files; rename them"
        )


def is_picture(path: Path) -> bool:
    """Return True if a file begins as a picture does. Raises InputError where it cannot be read."""
    return _header(path, read_picture_header) is not None


def is_video(path: Path) -> bool:
    """Return True if a file begins as a video does. Raises InputError where it cannot be read."""
    return _header(path, read_video_header) is not None


def _header(path: Path, read: Callable[[BinaryIO], Header | None]) -> Header | None:
    if not path.is_file():  # a named pipe would be waited for
        raise InputError(f"{path}: there is no such file")
    try:
        with open(path, "rb") as stream:
            return read(stream)
    except OSError as error:  # also where a header names a place that no file reaches
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def _check(path: Path, header: Header | None, limit: Limit | float) -> None:
    if header is None:
        raise unreadable(path)
    pixels, cost, size = header.width * header.height, 1, path.stat().st_size
    where = ""
    if isinstance(limit, Limit):
        small = size < SMALL_FILE
        cost = header.cost if small or size < pixels else 1
        where = f"in a file under {SMALL_FILE / 1e6:g} MB " if small else ""
        limit = limit.of(path)
    claims = f"{path}: claims {header.width} x {header.height} pixels"
    if max(header.width, header.height) > LONGEST_SIDE:
        raise InputError(f"{claims}, and no side of more than {LONGEST_SIDE} is read; save it smaller")
    if pixels / 1e6 * cost > limit:
        counted = f", which count as {_megapixels(pixels * cost)}" if cost > 1 else ""
        raise InputError(
            f"{claims} ({_megapixels(pixels)} megapixels{counted}), and {where}no more than {limit:g} are "
            "read; save it smaller, or allow more (max_megapixels)"
        )


def _megapixels(pixels: float) -> str:
    return f"{pixels / 1e6:.0f}" if pixels >= 1e7 else f"{pixels / 1e6:.1f}"
