"""Opens what a user names: a photo, a folder, a pattern, numbered files, a video."""

from __future__ import annotations

import glob
import logging
import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from handfit_core.common.errors import InputError
from handfit_core.common.files import path_of, printable, shown, why
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.headers import is_animated
from handfit_core.media.kinds import unreadable
from handfit_core.media.pictures import Pictures
from handfit_core.media.settings import MEDIA
from handfit_core.media.size_limit import is_picture, is_video
from handfit_core.media.source import Media, Wanted
from handfit_core.media.videos import Video

PHOTO_SUFFIXES = frozenset(
    f".{name}"
    for name in "jpg jpeg jpe png webp bmp dib tif tiff ppm pgm pnm hdr exr dpx heic heif hif avif".split(" ")
)
VIDEO_SUFFIXES = frozenset(
    f".{name}"
    for name in "mp4 mov avi mkv webm m4v mpg mpeg wmv mts m2ts ts vob mxf 3gp flv dv ogv gif apng".split()
)


MediaInput = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

log = logging.getLogger("handfit")

_NUMBER_IN_PATTERN = re.compile(r"%0?\d*d|#+")
_LAST_NUMBER = re.compile(r"(.*?)(-?)(\d+)(\D*(?:\.[^.]*)?)", re.DOTALL)
_MOST_NAMED = 5
"""Most series, kinds of files and places for a number that are looked at"""
_NOT_MISSED = frozenset(".npz .json .blend .db .ini".split(" "))
"""Suffixes of files that lie beside pictures without being meant to be read"""


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
            files = [path_of(p) for p in source]
            for file in files:
                if not file.is_file():
                    raise InputError(f"{shown(file)}: there is no such file")
            numbers = sequence_numbers(files) if len(files) > 1 else None
            media = _open_pictures(files, numbers, "", wanted, "the list of pictures")
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
        files, others = pictures_and_others(path)
        if not files:
            there = f", but {', '.join(_kinds(others))}" if others else ""
            raise InputError(f"{path}: no pictures in it{there}; give photos, a folder of photos or a video")
        return _open_pictures(*to_read(path, files, others), wanted, str(path))
    if path.is_file():
        still = is_picture(path)
        if still and not is_animated(path):
            return Pictures([(1, path)], Wanted(FrameRange(), wanted.max_megapixels), kind="photo")
        if still or path.suffix.lower() in VIDEO_SUFFIXES or is_video(path):
            return Video(path, wanted)
        raise unreadable(path)
    if is_pattern(str(path)):
        found, numbers = matching(path)
        if not found:
            raise InputError(f"{shown(path)}: no file matches this pattern")
        chosen = to_read(path, found) if numbers is None else (found, numbers, "")
        return _open_pictures(*chosen, wanted, str(path))
    raise InputError(f"{shown(path)}: there is no such file or folder")


def is_pattern(text: str) -> bool:
    """Return True if a path that does not exist is meant as `%04d`, `####` or glob pattern."""
    name = Path(text).name
    return bool(_NUMBER_IN_PATTERN.search(name)) or any(c in name for c in "*?[")


def pictures_in(folder: Path) -> list[Path]:
    """Return the pictures of a folder, in the order of the numbers in their names."""
    return pictures_and_others(folder)[0]


def pictures_and_others(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the pictures of a folder, in the order of the numbers in their names, and its other files."""
    pictures, others = [], []
    for file in _files_in(folder):
        suffix = file.suffix.lower()
        if suffix in PHOTO_SUFFIXES:
            pictures.append(file)
        elif suffix not in _NOT_MISSED:
            others.append(file)
    return sorted(pictures, key=_natural), others


def _files_in(folder: Path) -> list[Path]:
    """Return the files of a folder that are not hidden; none where there is no such folder."""
    if not folder.is_dir():
        return []
    # Asking a path whether it is a file would ask the disk, once for each.
    with os.scandir(folder) as entries:
        names = {entry.name for entry in entries if entry.name[0] != "." and entry.is_file()}
    return [path for path in folder.iterdir() if path.name in names]


def to_read(
    where: Path, pictures: list[Path], others: Sequence[Path] = ()
) -> tuple[list[Path], list[int] | None, str]:
    """Return which of the pictures of a folder or pattern are read together, their frame numbers if they are
    a numbered series, and a sentence that says what is left out, if anything is: `others`, and what does not
    belong to the longest series (the first by name of several), unless more pictures belong to none."""
    series, left, said = list(_series(pictures).values()), [], ""
    numbered = [each for each in series if len(each) > 1 and _are_frames([number for number, _ in each])]
    best = max(numbered, key=len, default=[])
    if len(best) < len(pictures) - sum(map(len, numbered)):
        best = []
    elif best:
        left = [[file.name for _, file in sorted(each)] for each in series if each is not best]
        best = sorted(best)
        pictures = [file for _, file in best]
    if left:
        tie = "longest" if max(map(len, left)) < len(best) else "first of the longest"
        said = f"of its series the {tie} is read, {pictures[0].name} to {pictures[-1].name}; "
    names = [each[0] if len(each) == 1 else f"{each[0]} to {each[-1]} ({len(each)})" for each in left]
    if len(names) > _MOST_NAMED:
        names[_MOST_NAMED:] = [f"{sum(map(len, left[_MOST_NAMED:]))} more"]
    count = sum(map(len, left)) + len(others)
    if count:
        are = "file is" if count == 1 else "files are"
        said = printable(f"{where}: {said}{count} {are} left out: {', '.join([*names, *_kinds(others)])}")
    return pictures, [number for number, _ in best] or None, said


def _kinds(files: Sequence[Path]) -> list[str]:
    """Return how many files of each kind there are, as text such as "2 .cr2"."""
    kinds = Counter(file.suffix.lower() or "without an ending" for file in files).most_common()
    if len(kinds) > _MOST_NAMED:
        kinds[_MOST_NAMED:] = [("others", sum(count for _, count in kinds[_MOST_NAMED:]))]
    return [f"{count} {kind}" for kind, count in kinds]


def sequence_numbers(files: Sequence[Path]) -> list[int] | None:
    """Return the frame numbers of files that form one numbered sequence (same name but for the last number in
    it), or None.

    Numbers with wide gaps are no frames but a camera's counter or a time of day, as phones name photos.
    """
    series = _series(files)
    numbers = [number for name, each in series.items() for number, _ in each if len(name) > 1]
    return numbers if len(series) == 1 and _are_frames(numbers) else None


def numbered_like(file: Path) -> list[tuple[int, Path]]:
    """Return all files beside `file`, itself included, that differ from it in the last number of their names
    only, each with that number; none where its name has no number."""
    there = file.parent.iterdir() if file.parent.is_dir() else ()
    beside = [each for each in there if each.name.endswith(file.suffix)]
    for name, each in _series(beside).items():
        if len(name) > 1 and file in (found for _, found in each):
            return sorted(each)
    return []


def _series(files: Sequence[Path]) -> dict[tuple[str, ...], list[tuple[int, Path]]]:
    """The files with names that differ in the last number only, with that number; those without one alone.

    As Blender writes negative numbers, a minus is one behind `_`, `.` or nothing, and behind anything
    where the same name without it is there, too.
    """
    parts: list[tuple[tuple[str, ...], str, int, Path]] = []
    for file in files:
        match = _LAST_NUMBER.fullmatch(file.name)
        if match:
            head, minus, number, tail = match.groups()
            parts.append(((head, tail), minus, int(number), file))
        else:
            parts.append(((file.name,), "", 0, file))
    positive = {name for name, minus, _, _ in parts if not minus}
    found: dict[tuple[str, ...], list[tuple[int, Path]]] = {}
    for name, minus, number, file in parts:
        head, *rest = name
        if minus and not (head[-1:] in ("_", ".", "") or name in positive):
            name, minus = (head + minus, *rest), ""
        found.setdefault(name, []).append((-number if minus else number, file))
    return found


def _are_frames(numbers: Sequence[int]) -> bool:
    """Return True if these numbers may be the frames of one sequence."""
    if not numbers or not _can_be_frames(numbers):
        return False
    return max(numbers) - min(numbers) + 1 <= MEDIA.max_frame_gap * len(numbers)


def _can_be_frames(numbers: Sequence[int]) -> bool:
    """Return True if Blender could hold frames of all these numbers, each once."""
    most = MEDIA.max_frame_number
    return -most <= min(numbers) and max(numbers) <= most and len(set(numbers)) == len(numbers)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    parts = re.split(r"(\d+)", path.name.lower())
    return [(0, int(p), "") if p.isdigit() else (1, 0, p) for p in parts]


def matching(pattern: Path) -> tuple[list[Path], list[int] | None]:
    """Return the files of a pattern, and their numbers in place of its `%04d` or `####`; None for a glob
    pattern."""
    places, name = list(_NUMBER_IN_PATTERN.finditer(pattern.name)), pattern.name
    if not places:
        # Only the last part is a pattern: folders may be called "[final]". So may files.
        parts = (name, name.replace("[", "[[]"))
        found = [glob.glob(str(Path(glob.escape(str(pattern.parent))) / part)) for part in parts]
        files = map(Path, found[0] or found[1])
        return sorted((p for p in files if p.suffix.lower() in PHOTO_SUFFIXES), key=_natural), None
    files = _files_in(pattern.parent)
    for place in reversed(places[-_MOST_NAMED:]):  # a name may also have "#3" and "100%done" in it
        number = re.compile(re.escape(name[: place.start()]) + r"(-?\d+)" + re.escape(name[place.end() :]))
        numbered = sorted((int(match[1]), p) for p in files if (match := number.fullmatch(p.name)))
        if numbered:
            return [file for _, file in numbered], [number for number, _ in numbered]
    return [], []


def _open_pictures(
    files: list[Path], numbers: list[int] | None, said: str, wanted: Wanted, what: str
) -> Media:
    """Open a sequence of pictures; `numbers` are their frame numbers where their names tell them, and `said`
    is a warning."""
    if not files:
        raise InputError(f"{what}: no pictures in it; give photos, a folder of photos or a video")
    if said:
        log.warning("%s", said)
    if len(files) == 1 and numbers is None:
        return _open_path(files[0], wanted)
    if numbers is None or not _can_be_frames(numbers):
        numbers = list(range(1, len(files) + 1))
    ordered = sorted(zip(numbers, files, strict=True))
    within = wanted.frames.within(ordered[0][0], ordered[-1][0])
    chosen = [(n, f) for n, f in ordered if n in within]
    if not chosen:
        raise InputError(
            f"{what}: no picture lies in frames {wanted.frames}; its frames are "
            f"{ordered[0][0]}-{ordered[-1][0]}"
        )
    return Pictures(chosen, wanted, kind="sequence", all_numbers=[n for n, _ in ordered])
