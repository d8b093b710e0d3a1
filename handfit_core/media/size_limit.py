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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from handfit_core.errors import InputError
from handfit_core.media.headers import read_picture_header, read_video_header

SMALL_FILE: Final = 10_000_000
"""Bytes; a smaller input may claim less than a larger one: what it may claim stays below 1 GB in the worker
and in Blender. That a larger one needs more surprises nobody."""


@dataclass(frozen=True)
class Limit:
    """Megapixels that one picture, or one frame of a video, may have by default."""

    small_file: float
    large_file: float

    def __str__(self) -> str:
        return f"{self.large_file:g}, in inputs under {SMALL_FILE / 1e6:g} MB {self.small_file:g}"


PICTURE: Final = Limit(64.0, 250.0)
"""Full-frame cameras and most phones have up to 61; the largest sensors have 200 in phones and 151 in
cameras."""
VIDEO: Final = Limit(12.0, 80.0)
"""4K has 8.3 to 12, 8K 36 and 12K 80. Decoders keep up to some 30 frames at once, of one and a half bytes a
pixel."""

LONGEST_SIDE: Final = 65_535
"""Pixels; no JPEG is longer"""


def common_limit(files: Sequence[Path], max_megapixels: float | None) -> float | Limit | None:
    """The limit for each of an input's pictures: the one that is given, or that of large files where the
    pictures are large together. None: each has the limit of its own file."""
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
    with _opened(path) as stream:
        if stream.seek(0, 2) == 0:
            raise InputError(f"{path}: the file is empty (0 bytes); copy or export it again")
        header = read_picture_header(stream)
    if header is None:
        raise InputError(f"{path}: not a picture, or a damaged one; open it in a viewer and save it again")
    _check(path, header.width, header.height, header.cost, max_megapixels or PICTURE)


def check_video(path: Path, max_megapixels: float | Limit | None = None) -> None:
    """Check a video's header; `max_megapixels` is the limit for each frame.

    Raises InputError where a frame is larger, and where the file is no video that holds its frames itself: a
    playlist would make FFmpeg open other files and addresses, and a name with %d in it other pictures.
    """
    if re.search(r"%\d*d", str(path.absolute())):
        raise InputError(
            f"{path}: the names of a video and its folders must not have %d in them, which stands for other "
            "files; rename them"
        )
    with _opened(path) as stream:
        header = read_video_header(stream)
    if header is None:
        raise InputError(not_a_video(path))
    check_frame_size(path, header.width, header.height, max_megapixels)


def check_frame_size(
    path: Path, width: int, height: int, max_megapixels: float | Limit | None = None
) -> None:
    """Raise InputError for a video whose frames are too large."""
    _check(path, width, height, 1, max_megapixels or VIDEO)


def check_for_blender(path: Path, max_megapixels: float | Limit | None = None) -> None:
    """Raise InputError for a file that Blender should not be given as picture or video: one that is neither,
    and one that is too large."""
    (check_picture if is_picture(path) else check_video)(path, max_megapixels)


def is_picture(path: Path) -> bool:
    """Whether a file begins as a picture does. Raises InputError where it cannot be read."""
    with _opened(path) as stream:
        return read_picture_header(stream) is not None


def is_video(path: Path) -> bool:
    """Whether a file begins as a video does. Raises InputError where it cannot be read."""
    with _opened(path) as stream:
        return read_video_header(stream) is not None


def claimed_frames(path: Path) -> int:
    """How many frames a video claims to have; 0: it is unknown, or the file is no video that can be read."""
    try:
        with _opened(path) as stream:
            header = read_video_header(stream)
    except InputError:
        return 0
    return 0 if header is None else header.frames


def not_a_video(path: Path) -> str:
    """The error message for a file that cannot be read as a video."""
    return (
        f"{path}: not a video, or one that is damaged or empty; play it in a viewer, and convert it to .mp4 "
        "(H.264) if that works"
    )


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    if not path.is_file():  # a named pipe would be waited for
        raise InputError(f"{path}: there is no such file")
    try:
        with open(path, "rb") as stream:
            yield stream
    except OSError as error:  # also where a header names a place that no file reaches
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def _check(path: Path, width: int, height: int, cost: float, limit: Limit | float) -> None:
    megapixels = width * height / 1e6
    small = False
    if isinstance(limit, Limit):
        size = path.stat().st_size
        small = size < SMALL_FILE
        deep = cost >= 2 and size < width * height
        cost, limit = cost if small or deep else 1, limit.small_file if small else limit.large_file
    else:
        cost = 1
    if max(width, height) > LONGEST_SIDE:
        raise InputError(
            f"{path}: claims {width} x {height} pixels, and no side of more than {LONGEST_SIDE} is read; "
            "save it smaller"
        )
    if megapixels * cost <= limit:
        return
    counted = f", which count as {_rounded(megapixels * cost)}" if cost > 1 else ""
    raise InputError(
        f"{path}: claims {width} x {height} pixels ({_rounded(megapixels)} megapixels{counted}), and "
        f"{f'in a file under {SMALL_FILE / 1e6:g} MB ' if small else ''}no more than {limit:g} are read; "
        "save it smaller, or allow more (max_megapixels)"
    )


def _rounded(megapixels: float) -> str:
    return f"{megapixels:.0f}" if megapixels >= 10 else f"{megapixels:.1f}"
