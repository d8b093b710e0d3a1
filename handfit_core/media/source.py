"""Opened inputs: where the pictures came from, and the frames with their numbers and times.

Frame numbers are Blender's: photos and videos count from 1, sequences use the numbers in their file names.
Pictures are upright (H, W, 3) uint8 RGB, whatever they were on disk.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from handfit_core.common.errors import TakeError
from handfit_core.common.files import storable
from handfit_core.common.npz import LONGEST_HEADER
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.settings import MEDIA

SourceKind = Literal["photo", "sequence", "video", "data"]
"""Kind of an input; `data` means hands of another program, to which no pictures belong"""
SOURCE_KINDS: Final[tuple[SourceKind, ...]] = ("photo", "sequence", "video", "data")

DEFAULT_FPS: Final = 24.0
"""Frames per second of photos and sequences (Blender's own default) and of videos that name none"""

_MAX_PATHS_CHARS: Final = LONGEST_HEADER - (1 << 16)
"""Most characters of all pictures' paths in a take's header, beside which the rest has room"""


@dataclass(frozen=True)
class Source:
    """The files that the pictures came from."""

    kind: SourceKind
    files: tuple[str, ...]
    """Absolute paths: the photo, the video, every picture of the sequence that was read, or the other
    program's file or folder"""
    orientation: int = 1
    """EXIF orientation (1-8) that was undone on reading; pixels in a take are of the upright picture"""

    def __post_init__(self) -> None:
        """Raise TakeError for more names than a take's file holds: before a capture, and not after it."""
        count = len(json.dumps(self.files, ensure_ascii=False))
        if count > _MAX_PATHS_CHARS:
            raise TakeError(
                f"the paths of {len(self.files)} pictures have {count} characters, and a take holds no more "
                f"than {_MAX_PATHS_CHARS}; capture fewer frames at once, or move them to a folder with a "
                "shorter path"
            )

    @property
    def name(self) -> str:
        """A short name for people: the file's stem, or for a sequence the part before the number. Bytes of
        the file's name that are no UTF-8 become question marks."""
        stem = storable(Path(self.files[0]).stem)
        if self.kind != "sequence":
            return stem
        return stem.rstrip("0123456789").rstrip("._- ") or storable(Path(self.files[0]).parent.name)


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of an opened input."""

    number: int
    time: float
    """Seconds since the clip's first frame"""
    rgb: np.ndarray | None
    """(H, W, 3) uint8, upright; None where the picture could not be read"""


@dataclass(frozen=True)
class Wanted:
    """The frames to read of an input, and the limit of their size."""

    frames: FrameRange = FrameRange()  # noqa: RUF009 (frozen)
    max_megapixels: float | None = None


class Media:
    """An opened input. Iterate `frames()`; `source`, `fps`, `width` and `height` are known at once."""

    source: Source
    fps: float
    width: int
    height: int
    expected_frames: int
    """How many frames `frames()` will yield, for progress; a video's own header may lie about it"""

    given: str | list[str] | None = None
    """The path, pattern or list of files with which `open_media` opens the input again; None: it cannot be
    opened again"""
    wanted: Wanted = Wanted()
    """The frames and the size limit with which the input was opened"""

    first_and_last: tuple[int, int]
    """Frame numbers that `frames()` begins and ends with, as far as the header tells"""

    @property
    def chunk_frames(self) -> int:
        """How many frames are detected together: `MEDIA.chunk_frames` at most, and an even number of about
        equal chunks, so that threads end together."""
        chunks = -(-self.expected_frames // MEDIA.chunk_frames)
        if chunks < 2:
            return MEDIA.chunk_frames
        # Of an even length, as bodies are looked for in every second frame.
        return 2 * -(-self.expected_frames // (2 * (chunks + chunks % 2)))

    def frames(self, first: int = 0, count: int | None = None, step: int = 1) -> Iterator[Frame]:
        """Yield the frames in order, from index `first`, counted from 0: of `count` of them at most, every
        step-th one."""
        raise NotImplementedError

    def numbers(self, first: int = 0, count: int | None = None) -> Sequence[int]:
        """The numbers of the frames that `frames` yields with these arguments, as far as they are known
        without reading: a video may have fewer."""
        raise NotImplementedError

    def all_numbers(self) -> Sequence[int]:
        """The numbers of all frames of the input, whatever range of them is wanted, as far as they are
        known."""
        return self.numbers(0, self.expected_frames or None)

    def limit_threads(self, count: int) -> None:
        """Read with at most so many threads, since other threads read other frames."""

    def close(self) -> None:
        """Release the file. A later read opens it again."""
