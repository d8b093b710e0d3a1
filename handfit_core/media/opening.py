"""From what a user names to what is opened: a photo, a folder, a pattern, numbered files, a video."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Sequence
from pathlib import Path

from handfit_core.common.errors import InputError
from handfit_core.common.files import path_of, shown, why
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.pictures import Pictures
from handfit_core.media.settings import MEDIA
from handfit_core.media.size_limit import is_picture, is_video
from handfit_core.media.source import Media, Wanted
from handfit_core.media.videos import Video

PHOTO_SUFFIXES = frozenset(
    f".{name}" for name in "jpg jpeg jpe png webp bmp dib tif tiff ppm pgm pnm hdr".split(" ")
)
VIDEO_SUFFIXES = frozenset(
    f".{name}" for name in "mp4 mov avi mkv webm m4v mpg mpeg wmv mts m2ts ogv gif".split(" ")
)


MediaInput = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

_NUMBER_IN_PATTERN = re.compile(r"%0?\d*d|#+")
_LAST_NUMBER = re.compile(r"(\d+)(?!.*\d)")


def open_media(
    source: MediaInput, frames: FrameRange | None = None, *, max_megapixels: float | None = None
) -> Media:
    """Open a photo, a list or folder of photos, a `name.%04d.png`, `name.####.png` or glob pattern, or
    a video.

    `frames` picks source frame numbers of sequences and videos. `max_megapixels` limits the size of a picture
    or frame; None: the defaults of `size_limit`. Raises InputError.
    """
    wanted = Wanted(frames or FrameRange(), max_megapixels)
    try:
        if not isinstance(source, str | os.PathLike):
            media = _open_pictures([path_of(p) for p in source], wanted, "the list of pictures")
            media.given, media.wanted = [str(p) for p in source], wanted
            return media
        if not str(source):
            raise InputError("no input was given; name a photo, a folder of photos or a video")
        media = _open_path(path_of(source), wanted)
        media.given, media.wanted = str(source), wanted
        return media
    except OSError as error:  # a folder that may not be read, a name that is too long
        what = shown(error.filename) if isinstance(error.filename, str) else "the input"
        raise InputError(f"{what}: cannot be opened ({why(error)}); choose another file") from error


def _open_path(path: Path, wanted: Wanted) -> Media:
    if path.is_dir():
        return _open_pictures(pictures_in(path), wanted, str(path))
    if path.is_file():
        if path.stat().st_size == 0:
            raise InputError(f"{path}: the file is empty (0 bytes); copy or export it again")
        suffix, known = path.suffix.lower(), PHOTO_SUFFIXES | VIDEO_SUFFIXES
        if suffix in PHOTO_SUFFIXES or (suffix not in known and is_picture(path)):
            return Pictures([path], [1], Wanted(FrameRange(), wanted.max_megapixels), kind="photo")
        if suffix in VIDEO_SUFFIXES or is_video(path):
            return Video(path, wanted)
        raise InputError(
            f"{path}: neither a picture nor a video that can be read; known are "
            f"{_suffixes(PHOTO_SUFFIXES)} and {_suffixes(VIDEO_SUFFIXES)}"
        )
    if is_pattern(str(path)):
        found, numbers = matching(path)
        if not found:
            raise InputError(f"{shown(path)}: no file matches this pattern")
        return _open_pictures(found, wanted, str(path), numbers)
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
    return numbers if span <= MEDIA.max_frame_gap * len(numbers) else None


def numbered_like(file: Path) -> list[tuple[int, Path]]:
    """The files beside `file`, itself included, that differ from it in the last number of their names only,
    with that number; none where its name has no number."""
    match = _LAST_NUMBER.search(file.stem)
    if not match:
        return []
    head, tail = file.name[: match.start()], file.name[match.end() :]
    return _numbered(file.parent, re.escape(head) + r"(\d+)" + re.escape(tail))


def _numbered(folder: Path, pattern: str) -> list[tuple[int, Path]]:
    """Everything in a folder whose name is of a pattern, by the number in it."""
    found = [(re.fullmatch(pattern, file.name), file) for file in folder.iterdir()] if folder.is_dir() else []
    return sorted((int(match[1]), file) for match, file in found if match)


def _can_be_frames(numbers: Sequence[int]) -> bool:
    """Whether Blender could hold them all, each once."""
    return max(numbers) <= MEDIA.max_frame_number and len(set(numbers)) == len(numbers)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    parts = re.split(r"(\d+)", path.name.lower())
    return [(0, int(p), "") if p.isdigit() else (1, 0, p) for p in parts]


def matching(pattern: Path) -> tuple[list[Path], list[int] | None]:
    """The files of a pattern, and their numbers in place of its `%04d` or `####`; None for a glob pattern."""
    pieces = _NUMBER_IN_PATTERN.split(pattern.name)
    if len(pieces) == 1:
        # Only the last part is a pattern: folders may be called "[final]".
        found = [Path(p) for p in glob.glob(str(Path(glob.escape(str(pattern.parent))) / pattern.name))]
        return sorted((p for p in found if p.suffix.lower() in PHOTO_SUFFIXES), key=_natural), None
    numbered = _numbered(pattern.parent, r"(\d+)".join(map(re.escape, pieces)))
    numbered = [(number, file) for number, file in numbered if file.is_file()]
    return [file for _, file in numbered], [number for number, _ in numbered]


def _open_pictures(files: list[Path], wanted: Wanted, what: str, numbers: list[int] | None = None) -> Media:
    """Open a sequence of pictures; `numbers` are their frame numbers where a pattern tells them."""
    if not files:
        raise InputError(f"{what}: no pictures in it; give photos ({_suffixes(PHOTO_SUFFIXES)}) or a video")
    for file in files:
        if not file.is_file():
            raise InputError(f"{shown(file)}: there is no such file")
    if len(files) == 1 and numbers is None:
        return _open_path(files[0], wanted)
    if numbers is None or not _can_be_frames(numbers):
        numbers = sequence_numbers(files) or list(range(1, len(files) + 1))
    ordered = sorted(zip(numbers, files, strict=True))
    chosen = [(n, f) for n, f in ordered if n in wanted.frames]
    if not chosen:
        raise InputError(
            f"{what}: no picture lies in frames {wanted.frames}; its frames are "
            f"{ordered[0][0]}-{ordered[-1][0]}"
        )
    return Pictures(
        [f for _, f in chosen],
        [n for n, _ in chosen],
        wanted,
        kind="sequence",
        all_numbers=[n for n, _ in ordered],
    )


def _suffixes(suffixes: frozenset[str]) -> str:
    return " ".join(sorted(suffixes))
