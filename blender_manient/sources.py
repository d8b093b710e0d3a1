"""From what the panel names to the files that a capture reads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy

from handfit_core.errors import InputError
from handfit_core.files import shown, why
from handfit_core.media.opening import PHOTO_SUFFIXES, VIDEO_SUFFIXES, pictures_in, sequence_numbers


@dataclass(frozen=True)
class SourceFiles:
    """What a capture reads."""

    kind: str
    """photo, sequence or video"""
    files: tuple[str, ...]
    """absolute: the photo, the video, or every picture of a sequence in order"""

    @property
    def name(self) -> str:
        """For people."""
        path = Path(self.files[0])
        return path.name if self.kind != "sequence" else f"{path.name} ({len(self.files)} pictures)"

    @property
    def numbers(self) -> list[int] | None:
        """The frame numbers of a numbered sequence; None for anything else."""
        return sequence_numbers([Path(f) for f in self.files]) if self.kind == "sequence" else None


def resolve(path_text: str, *, as_sequence: bool) -> SourceFiles:
    """The files behind a path of the panel. Blender's `//` and `~` are understood.

    Raises InputError with a sentence for the panel.
    """
    try:
        return _resolved(path_text, as_sequence)
    except (OSError, RuntimeError, ValueError) as error:  # names that no file can have, ~nobody
        why_not = why(error) if isinstance(error, (OSError, ValueError)) else str(error)
        raise InputError(f"{shown(path_text)} cannot be opened ({why_not}): choose another file") from error


def _resolved(path_text: str, as_sequence: bool) -> SourceFiles:
    if not path_text:
        raise InputError("Choose a photo, an image sequence or a video")
    # Absolute, since Blender and FFmpeg take a relative name that begins with "http:" for an address.
    path = Path(bpy.path.abspath(path_text)).expanduser().absolute()
    if path.is_dir():
        pictures = pictures_in(path)
        if not pictures:
            raise InputError(f"No pictures in the folder {path.name}: choose a file or another folder")
        kind = "sequence" if len(pictures) > 1 else "photo"
        return SourceFiles(kind, tuple(map(str, pictures)))
    if not path.is_file():
        raise InputError(f"{path.name} is not there any more: choose the file again")
    suffix = path.suffix.lower()
    if suffix in VIDEO_SUFFIXES:
        return SourceFiles("video", (str(path),))
    if suffix in PHOTO_SUFFIXES:
        numbered = numbered_siblings(path) if as_sequence else []
        if len(numbered) > 1:
            return SourceFiles("sequence", tuple(map(str, numbered)))
        return SourceFiles("photo", (str(path),))
    raise InputError(f"{path.name} is neither a picture nor a video: choose another file")


def numbered_siblings(path: Path) -> list[Path]:
    """The pictures beside `path` whose names differ from its own in the last number only, in order;
    without the numbers of a camera's counter (see `sequence_numbers`)."""
    stem = path.stem.rstrip("0123456789")
    if stem == path.stem:
        return []
    beside = [
        p
        for p in pictures_in(path.parent)
        if p.suffix == path.suffix and p.stem.startswith(stem) and p.stem[len(stem) :].isdigit()
    ]
    return beside if len(beside) > 1 and sequence_numbers(beside) is not None else []
