"""Photos, image sequences and videos as one thing: numbered frames with a time.

Frame numbers are Blender's: photos and videos count from 1, sequences use the numbers in their file
names. Pictures come out upright, as (H, W, 3) uint8 RGB, whatever they were on disk.
"""

from __future__ import annotations

import glob
import logging
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.errors import InputError
from handfit_core.files import shown, why
from handfit_core.media.exif import is_tiff, read_orientation, upright
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.size_limit import (
    check_frame_size,
    check_limit,
    check_picture,
    check_video,
    is_picture,
    is_video,
    not_a_video,
)
from handfit_core.take import Source

log = logging.getLogger("handfit")

PHOTO_SUFFIXES = frozenset(
    f".{name}" for name in "jpg jpeg jpe png webp bmp dib tif tiff ppm pgm pnm hdr".split(" ")
)
VIDEO_SUFFIXES = frozenset(
    f".{name}" for name in "mp4 mov avi mkv webm m4v mpg mpeg wmv mts m2ts ogv gif".split(" ")
)

DEFAULT_FPS = 24.0
"""Frames per second of photos and sequences (Blender's own default) and of videos that name none."""

MAX_FPS = 1000.0

MAX_FRAME_NUMBER = 1_048_574
"""Blender's last frame."""

WIDEST_GAPS = 10
"""A sequence has at least one picture per so many frame numbers on average."""

MediaInput = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

_NUMBER_IN_PATTERN = re.compile(r"%0?\d*d|#+")
_LAST_NUMBER = re.compile(r"(\d+)(?!.*\d)")


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of the input."""

    number: int
    time: float
    """seconds since the clip's first frame"""
    rgb: np.ndarray | None
    """(H, W, 3) uint8, upright; None where the picture could not be read"""


class Media:
    """An opened input. Iterate `frames()`; `source`, `fps`, `width` and `height` are known at once."""

    source: Source
    fps: float
    width: int
    height: int
    expected_frames: int
    """How many frames `frames()` will yield, for progress; a video's own header may lie about it"""

    first_and_last: tuple[int, int]
    """Frame numbers that `frames()` begins and ends with, as far as the header tells"""

    def frames(self) -> Iterator[Frame]:
        """Yield the frames in order."""
        raise NotImplementedError


def open_media(
    source: MediaInput, frames: FrameRange | None = None, *, max_megapixels: float | None = None
) -> Media:
    """Open a photo, a list or folder of photos, a `name.%04d.png`, `name.####.png` or glob pattern, or
    a video.

    `frames` picks source frame numbers of sequences and videos. `max_megapixels` takes the place of the
    limits of `size_limit`. Raises InputError, and OptionError for a limit that is none.
    """
    opening = _Opening(frames or FrameRange(), check_limit(max_megapixels))
    try:
        if not isinstance(source, str | os.PathLike):
            return _open_pictures([_path_of(p) for p in source], opening, "the list of pictures")
        if not str(source):
            raise InputError("no input was given; name a photo, a folder of photos or a video")
        return _open_path(_path_of(source), opening)
    except OSError as error:  # a folder that may not be read, a name that is too long
        what = shown(error.filename) if isinstance(error.filename, str) else "the input"
        raise InputError(f"{what}: cannot be opened ({why(error)}); choose another file") from error


@dataclass(frozen=True)
class _Opening:
    """What was asked for besides the input."""

    frames: FrameRange
    max_megapixels: float | None


def _path_of(name: str | os.PathLike[str]) -> Path:
    """Its path, with ~ as the user's folder; ~nobody, where there is no such user, is a name like others."""
    try:
        return Path(name).expanduser()
    except RuntimeError:
        return Path(name)


def _open_path(path: Path, opening: _Opening) -> Media:
    if path.is_dir():
        return _open_pictures(pictures_in(path), opening, str(path))
    if path.is_file():
        if path.stat().st_size == 0:
            raise InputError(f"{path}: the file is empty (0 bytes); copy or export it again")
        if path.suffix.lower() in VIDEO_SUFFIXES:
            return _Video(path, opening)
        if path.suffix.lower() in PHOTO_SUFFIXES:
            return _photo(path, opening)
        return _open_unknown(path, opening)
    if is_pattern(str(path)):
        found, numbers = _matching(path)
        if not found:
            raise InputError(f"{shown(path)}: no file matches this pattern")
        return _open_pictures(found, opening, str(path), numbers)
    raise InputError(f"{shown(path)}: there is no such file or folder")


def is_pattern(text: str) -> bool:
    """Whether a path that does not exist is meant as `%04d`, `####` or glob pattern."""
    name = Path(text).name
    return bool(_NUMBER_IN_PATTERN.search(name)) or any(c in name for c in "*?[")


def pictures_in(folder: Path) -> list[Path]:
    """The pictures of a folder, in the order of the numbers in their names."""
    found = [p for p in folder.iterdir() if p.suffix.lower() in PHOTO_SUFFIXES and not p.name.startswith(".")]
    return sorted(found, key=_natural)


def sequence_numbers(files: Sequence[Path]) -> list[int] | None:
    """The frame numbers of files that form one numbered sequence (same name but for the last number
    in it), or None.

    Numbers with wide gaps are no frames but a camera's counter or a time of day, as phones name photos.
    """
    numbers: list[int] = []
    shapes: set[tuple[str, str]] = set()
    for file in files:
        match = _LAST_NUMBER.search(file.stem)
        if not match:
            return None
        numbers.append(int(match[1]))
        shapes.add((file.stem[: match.start()], file.stem[match.end() :]))
    if len(shapes) != 1 or not _can_be_frames(numbers):
        return None
    span = max(numbers) - min(numbers) + 1
    return numbers if span <= WIDEST_GAPS * len(numbers) else None


def numbered_like(file: Path) -> list[tuple[int, Path]]:
    """The files beside `file`, itself included, that differ from it in the last number of their names only,
    with that number; none where its name has no number."""
    match = _LAST_NUMBER.search(file.stem)
    if not match:
        return []
    head, tail = file.name[: match.start()], file.name[match.end() :]
    like = re.compile(re.escape(head) + r"(\d+)" + re.escape(tail))
    found = [(like.fullmatch(other.name), other) for other in file.parent.iterdir()]
    return sorted((int(number[1]), other) for number, other in found if number)


def _can_be_frames(numbers: Sequence[int]) -> bool:
    """Whether Blender could hold them all, each once."""
    return max(numbers) <= MAX_FRAME_NUMBER and len(set(numbers)) == len(numbers)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    parts = re.split(r"(\d+)", path.name.lower())
    return [(0, int(p), "") if p.isdigit() else (1, 0, p) for p in parts]


def _matching(pattern: Path) -> tuple[list[Path], list[int] | None]:
    """The files of a pattern, and the numbers that stand where it has `%04d` or `####`."""
    pieces = _NUMBER_IN_PATTERN.split(pattern.name)
    if len(pieces) == 1:
        # Only the last part is a pattern: folders may be called "[final]".
        found = [Path(p) for p in glob.glob(str(Path(glob.escape(str(pattern.parent))) / pattern.name))]
        return sorted((p for p in found if p.suffix.lower() in PHOTO_SUFFIXES), key=_natural), None
    exact = re.compile(r"(\d+)".join(map(re.escape, pieces)) + "$")
    folder = pattern.parent
    names = {p: exact.match(p.name) for p in folder.iterdir()} if folder.is_dir() else {}
    numbered = sorted((int(match[1]), p) for p, match in names.items() if match and p.is_file())
    return [p for _, p in numbered], [n for n, _ in numbered]


def _open_pictures(
    files: list[Path], opening: _Opening, what: str, numbers: list[int] | None = None
) -> Media:
    """A sequence of pictures; `numbers` are their frame numbers where the user said which they are."""
    if not files:
        raise InputError(f"{what}: no pictures in it; give photos ({_suffixes(PHOTO_SUFFIXES)}) or a video")
    for file in files:
        if not file.is_file():
            raise InputError(f"{shown(file)}: there is no such file")
    if len(files) == 1 and numbers is None:
        return _open_path(files[0], opening)
    if numbers is None or not _can_be_frames(numbers):
        numbers = sequence_numbers(files) or list(range(1, len(files) + 1))
    ordered = sorted(zip(numbers, files, strict=True))
    chosen = [(n, f) for n, f in ordered if n in opening.frames]
    if not chosen:
        raise InputError(
            f"{what}: no picture lies in frames {opening.frames}; its frames are "
            f"{ordered[0][0]}-{ordered[-1][0]}"
        )
    return _Pictures([f for _, f in chosen], [n for n, _ in chosen], opening, kind="sequence")


def _photo(path: Path, opening: _Opening) -> Media:
    return _Pictures([path], [1], _Opening(FrameRange(), opening.max_megapixels), kind="photo")


def _open_unknown(path: Path, opening: _Opening) -> Media:
    """A file whose name says nothing: its content does."""
    if is_picture(path):
        return _photo(path, opening)
    if is_video(path):
        return _Video(path, opening)
    raise InputError(
        f"{path}: neither a picture nor a video that can be read; known are "
        f"{_suffixes(PHOTO_SUFFIXES)} and {_suffixes(VIDEO_SUFFIXES)}"
    )


def _suffixes(suffixes: frozenset[str]) -> str:
    return " ".join(sorted(suffixes))


_JPEG_2000 = (b"\0\0\0\x0cjP  \r\n\x87\n", b"\xff\x4f\xff\x51")
"""What such files begin with. OpenCV 4.11's decoder ends the process on every header that it refuses."""


def read_picture(
    path: Path, *, as_stored: bool = False, max_megapixels: float | None = None
) -> tuple[np.ndarray, int]:
    """Read any photo as upright (H, W, 3) uint8 RGB, and the EXIF orientation that was undone.

    `as_stored` leaves the orientation alone, for pictures whose labels are in stored pixels.
    Alpha is laid over mid grey, 16-bit and float pictures are brought to 8 bits. `max_megapixels` takes the
    place of the limits of `size_limit`. Raises InputError.
    """
    import cv2

    check_picture(path, max_megapixels)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if data.startswith(_JPEG_2000):
        raise InputError(f"{path}: JPEG 2000 pictures are not read; save it as .png or .jpg")
    try:
        # From memory, since OpenCV cannot open paths that are not ASCII on Windows.
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        # OpenCV refuses more than 2^30 pixels.
        raise InputError(f"{path}: the picture is too large or damaged; save it again, smaller") from error
    if pixels is None:
        raise InputError(f"{path}: not a picture, or a damaged one; open it in a viewer and save it again")
    orientation = 1 if as_stored else read_orientation(data)
    rgb = _rgb8(pixels)
    if not is_tiff(data):  # OpenCV has turned those already
        rgb = upright(rgb, orientation)
    return np.ascontiguousarray(rgb), orientation


_ROWS_AT_ONCE = 256
"""Of a picture that is brought to 8-bit RGB: what that takes besides the picture is a few rows"""


def _rgb8(pixels: np.ndarray) -> np.ndarray:
    """OpenCV's (H, W), (H, W, 1|3|4) of any depth, BGR -> (H, W, 3) uint8 RGB, in place where it has that
    form."""
    in_place = pixels.dtype == np.uint8 and pixels.ndim == 3 and pixels.shape[2] == 3
    rgb = pixels if in_place else np.empty((*pixels.shape[:2], 3), dtype=np.uint8)
    for first in range(0, len(pixels), _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        rgb[rows] = _rows_rgb8(pixels[rows])
    return rgb


def _rows_rgb8(pixels: np.ndarray) -> np.ndarray:
    import cv2

    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    elif np.issubdtype(pixels.dtype, np.integer) and pixels.dtype != np.uint8:
        info = np.iinfo(pixels.dtype)
        pixels = np.round((pixels.astype(np.float64) - info.min) * (255.0 / (info.max - info.min)))
        pixels = pixels.astype(np.uint8)
    elif pixels.dtype != np.uint8:
        # Scene-linear floats, as .hdr and float TIFF hold them.
        linear = np.clip(np.nan_to_num(pixels.astype(np.float32)), 0.0, 1.0)
        pixels = np.round(255.0 * linear ** (1 / 2.2)).astype(np.uint8)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.shape[2] == 2:  # grey and alpha
        pixels = pixels[..., (0, 0, 0, 1)]
    if pixels.shape[2] == 4 and pixels[..., 3].min() < 255:
        alpha = pixels[..., 3:].astype(np.uint16)
        over_grey = (pixels[..., :3] * alpha + 128 * (255 - alpha) + 127) // 255
        pixels = over_grey.astype(np.uint8)
    # Not by NumPy's indexing, which takes as long as decoding does.
    to_rgb = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}[pixels.shape[2]]
    return cv2.cvtColor(pixels, to_rgb)


class _Pictures(Media):
    """A photo or an image sequence."""

    def __init__(self, files: list[Path], numbers: list[int], opening: _Opening, *, kind: Any) -> None:
        self._files, self._numbers = files, numbers
        self._max_megapixels = opening.max_megapixels
        frames = opening.frames
        self._first_number = frames.first if frames.first is not None else numbers[0]
        self.fps = DEFAULT_FPS
        self.expected_frames = len(files)
        self.first_and_last = numbers[0], numbers[-1]
        # The first picture that can be read decides the size; unreadable ones become empty frames.
        first_file, first, orientation = self._first_readable()
        self._read_already = {first_file: first}
        self.height, self.width = first.shape[:2]
        self.source = Source(kind=kind, files=tuple(str(f.resolve()) for f in files), orientation=orientation)

    def _first_readable(self) -> tuple[Path, np.ndarray, int]:
        errors: list[InputError] = []
        for file in self._files:
            try:
                return file, *read_picture(file, max_megapixels=self._max_megapixels)
            except InputError as error:
                errors.append(error)
        raise errors[0]

    def frames(self) -> Iterator[Frame]:
        for number, file in zip(self._numbers, self._files, strict=True):
            # Taken out, so that it does not stay in memory.
            rgb = self._read_already.pop(file, None)
            try:
                if rgb is None:
                    rgb, _ = read_picture(file, max_megapixels=self._max_megapixels)
            except InputError as error:
                log.warning("%s; frame %d is left empty", error, number)
            if rgb is not None and rgb.shape[:2] != (self.height, self.width):
                raise InputError(
                    f"{file}: is {rgb.shape[1]}x{rgb.shape[0]} pixels, the first picture {self.width}x"
                    f"{self.height}; pictures of one sequence must have one size, capture others one by one"
                )
            yield Frame(number, (number - self._first_number) / self.fps, rgb)


def _frame_count(path: Path, claimed: float) -> int:
    """How many frames a video has by its header; 0 where that does not tell, or tells of more than the file
    has bytes."""
    return int(claimed) if 0 < claimed <= path.stat().st_size else 0


class _Video(Media):
    """A video file, read through OpenCV. Rotation stored in the file is applied by OpenCV."""

    def __init__(self, path: Path, opening: _Opening) -> None:
        import cv2

        frames = opening.frames
        self._path, self._range = path, frames
        check_video(path, opening.max_megapixels)
        # Absolute, since FFmpeg takes a relative name that begins with "http:" or "tcp:" for an address.
        self._name = str(path.absolute())
        try:
            self._name.encode()
        except UnicodeEncodeError as error:  # OpenCV would end the process
            raise InputError(f"{shown(path)}: its name is no text in UTF-8; rename the file") from error
        capture = cv2.VideoCapture(self._name)
        try:
            # What the decoder says: the container may have told another size.
            width, height = (capture.get(p) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
            check_frame_size(path, int(width), int(height), opening.max_megapixels)
            found, first = capture.read() if capture.isOpened() else (False, None)
            if not found or first is None:
                raise InputError(not_a_video(path))
            fps = float(capture.get(cv2.CAP_PROP_FPS))
            count = _frame_count(path, capture.get(cv2.CAP_PROP_FRAME_COUNT))
        finally:
            capture.release()
        if not math.isfinite(fps) or not 0.0 < fps <= MAX_FPS:
            log.warning("%s: names no frame rate; %g frames per second are assumed", path, DEFAULT_FPS)
            fps = DEFAULT_FPS
        if frames.first is not None and count > 0 and frames.first > count:
            raise InputError(f"{path}: frames {frames} lie behind its end; it has frames 1-{count}")
        self.fps = fps
        self.height, self.width = first.shape[:2]
        used = frames.within(1, count)
        self.expected_frames = len(used)
        self.first_and_last = (used[0], used[-1]) if used else (1, 1)
        self._count = count
        self.source = Source(kind="video", files=(str(path.resolve()),))

    def frames(self) -> Iterator[Frame]:
        import cv2

        capture = cv2.VideoCapture(self._name)
        number = 0
        try:
            while not self._range.is_past(number + 1) and capture.grab():
                number += 1
                if number not in self._range:
                    continue
                ok, bgr = capture.retrieve()
                rgb = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB) if ok else None
                yield Frame(number, (number - 1) / self.fps, rgb)
        finally:
            capture.release()
        stopped_early = number + 1 < self._count and not self._range.is_past(number + 1)
        if stopped_early:
            log.warning(
                "%s: the video breaks off after frame %d of %d; the rest is missing",
                self._path,
                number,
                self._count,
            )
