"""Inputs that are no pictures but what another program found in pictures, beside these or alone."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.arrays import arrays_of
from handfit_core.common.errors import InputError
from handfit_core.common.files import shown
from handfit_core.common.values import Unfit
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import READERS, recognised
from handfit_core.interchange.recording import VIRTUAL_SIZE, PointsHand, ReadOptions, Recording
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import MediaInput, pictures_in
from handfit_core.media.settings import MEDIA
from handfit_core.media.source import DEFAULT_FPS, Frame, Media, Source
from handfit_core.take import is_take

DATA_SUFFIXES: Final = frozenset(
    ".json .jsonl .csv .tsv .trc .txt .npz .npy .bvh .pose .pkl .pickle .joblib .pth .pt".split()
)
"""Endings of files that are read as recordings, whatever the files hold"""

NO_RATE: Final = f"frames per second are not told: {DEFAULT_FPS:g} (--fps tells them)"
"""The phrase for a recording alone that does not tell its rate, which pictures beside it would tell"""

RELATIVE: Final = (1, 1)
"""The size of a recording whose keypoints are parts of the picture's width and height"""


class RecordedMedia(Media):
    """A recording as an input without pictures: its frames cannot be read."""

    def __init__(self, recording: Recording, given: str, frames: FrameRange | None) -> None:
        self.recording = recording
        self.given = given
        self.source = Source("data", recording.files)
        self.fps = recording.fps
        self.width, self.height = recording.size or VIRTUAL_SIZE
        wanted = frames or FrameRange()
        self._numbers = [int(n) for n in recording.frame_numbers if int(n) in wanted]
        if not self._numbers:
            raise InputError(
                f"{shown(given)}: none of its frames lies in {wanted}; it has "
                f"{int(recording.frame_numbers[0])} to {int(recording.frame_numbers[-1])}"
            )
        self.expected_frames = len(self._numbers)
        self.first_and_last = self._numbers[0], self._numbers[-1]

    def in_range(self) -> Recording:
        """The part of the recording in the range of frames that the user wants."""
        rows = np.flatnonzero(np.isin(self.recording.frame_numbers, self._numbers))
        return at_rows(self.recording, rows, self.recording.frame_numbers[rows])

    def numbers(self, first: int = 0, count: int | None = None) -> Sequence[int]:
        """Return the numbers of the wanted frames from `first` on, at most `count` of them."""
        return self._numbers[first:] if count is None else self._numbers[first : first + count]

    def frames(self, first: int = 0, count: int | None = None, step: int = 1) -> Iterator[Frame]:
        """Yield the wanted frames from `first` on, without pictures."""
        for number in self.numbers(first, count)[::step]:
            yield Frame(number, (number - self._numbers[0]) / self.fps, None)


def is_recording(source: MediaInput) -> bool:
    """True if an input is a file of data by its ending, or a folder of such files and no pictures."""
    if not isinstance(source, str | os.PathLike):
        return len(source) == 1 and is_recording(source[0])
    path = Path(source)
    try:
        if path.is_dir():
            document = Document(path)
            return not pictures_in(path) and _holds_data(document)
        return path.suffix.lower() in DATA_SUFFIXES
    except (OSError, ValueError, RuntimeError):
        return False


def _holds_data(document: Document) -> bool:
    """Return whether a folder, or a folder in it as a reader knows them, has files of data."""
    if document.files(*(DATA_SUFFIXES - {".txt"})):  # Notes lie beside clips.
        return True
    return any(reader.recognises(document) for reader in READERS.built_in().values())


def read_recording(path: str | os.PathLike[str], options: ReadOptions | None = None) -> Recording:
    """Read what a file or folder holds. Raises InputError and OptionError."""
    options, document = options or ReadOptions(), Document(path)
    if not os.path.exists(document.path):  # noqa: PTH110  (raises for no name, however long)
        raise InputError(f"{shown(path)}: there is no such file or folder")
    if document.suffix == ".npz" and is_take(document.path):
        raise InputError(
            f"{shown(path)}: this is a take, which is captured already: write it in another format with "
            "convert, or open it in Blender with File > Import > Hand Take"
        )
    name, reader = recognised(document, options.reader)
    try:
        with READERS.blamed(name):
            recording = reader.read(document, options)
            recording = replace(recording, size=recording.size or options.picture_size)
            recording = _with_rate(recording, options.fps)
            recording.check()
    except Unfit as error:
        raise InputError(f"{shown(path)}: read as {reader.title}, {str(error)[:300]}") from error
    except (
        ArithmeticError,
        AssertionError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as error:
        raise InputError(
            f"{shown(path)}: this is meant to be {reader.title} ({reader.layout}), and is damaged or of a "
            f"version that is not known ({' '.join(str(error).split())[:200] or type(error).__name__})"
        ) from error
    return recording


def _with_rate(recording: Recording, fps: float | None) -> Recording:
    """Return the recording with the rate in frames per second that is asked for, else its own, else the usual
    one."""
    if fps is not None or recording.fps:
        return replace(recording, fps=fps or recording.fps)
    assumed = recording.assumed if len(recording.frame_numbers) == 1 else (*recording.assumed, NO_RATE)
    return replace(recording, fps=DEFAULT_FPS, assumed=assumed)


def beside(media: Media, recording: Recording) -> Recording:
    """Fit a recording to its pictures: its rows and pixels become theirs, and a frame that it lacks has no
    hands.

    Which frame is which picture's is decided by all of the source's pictures, of which a part may be wanted
    (`_as_numbered`), and said in `assumed`. Raises InputError where none is of these pictures, and for
    keypoints most of which lie outside them.
    """
    # A video whose header counts no frames has those of which something is told.
    count = media.expected_frames or min(int(recording.frame_numbers[-1]) + 1, MEDIA.max_frame_number)
    numbers = np.asarray(media.numbers(0, count))
    theirs, taken = _as_numbered(media.all_numbers(), np.asarray(recording.frame_numbers))
    if not np.isin(theirs, numbers).any():
        raise InputError(
            f"{shown(recording.files[0])}: its frames are {theirs[0]} to {theirs[-1]}, and the pictures' are "
            f"{numbers[0]} to {numbers[-1]}; give the keypoints of these pictures"
        )
    rows = np.full(len(numbers), -1)
    common, here, there = np.intersect1d(numbers, theirs, return_indices=True)
    assert len(common)
    rows[here] = there
    assumed = (*(phrase for phrase in recording.assumed if phrase != NO_RATE), *taken)
    recording = replace(at_rows(recording, rows, numbers), fps=media.fps, assumed=assumed)
    recording = scaled(recording, media.width, media.height)
    _check_inside(recording)
    return recording


def _as_numbered(pictures: Sequence[int], frames: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the pictures' numbers of a recording's frames (T,), and phrases about what was assumed for it.

    Frames without gaps from 0 or 1, as many as there are pictures, are in the pictures' order, whatever the
    pictures' numbers are. Others that count from 0, which no picture does, are counted along the pictures.
    All others have the pictures' numbers.
    """
    if len(pictures) == 1 == len(frames):
        return np.array(pictures), ()
    first, last = int(frames[0]), int(frames[-1])
    taken, why = frames, "by their numbers"
    if first in (0, 1) and len(frames) == len(pictures) == last - first + 1:
        taken, why = np.array(pictures), "as there are as many of both"
    elif first == 0 != pictures[0] and last < len(pictures):
        taken, why = np.array([pictures[i] for i in frames.tolist()]), "as it counts from 0"
    elif first == 0 and pictures[0] == 1:
        taken, why = frames + 1, "as it counts from 0"
    elif pictures[0] == 1 <= first and last < pictures[-1]:
        why += "; if it counts from 0, give it a frame 0 without hands"
    return taken, (f"its frame {first} is taken for the pictures' frame {taken[0]}, {why}",)


def _check_inside(recording: Recording) -> None:
    """Raise InputError for keypoints of which most lie outside the recording's pictures."""
    if recording.seen is None or recording.size is None:
        return
    points = recording.seen.keypoints[np.isfinite(recording.seen.keypoints).all(axis=-1)]
    # Keypoints may lie outside by a quarter of the picture's size.
    outside = np.any(np.abs(points / recording.size - 0.5) > 0.5 + 0.25, axis=1)
    if len(points) and outside.mean() > 0.5:
        reach = np.abs(points).max(axis=0)
        raise InputError(
            f"{shown(recording.files[0])}: most of its keypoints lie outside the pictures, at up to "
            f"{reach[0]:.0f}, {reach[1]:.0f} of {recording.size[0]}x{recording.size[1]} pixels; give the "
            "size of the pictures that they were found in as --picture-size, or these pictures' keypoints"
        )


def at_rows(recording: Recording, rows: np.ndarray, numbers: np.ndarray) -> Recording:
    """Return the recording's frames at `rows` (T,), -1 for a frame without hands, with the frame numbers
    `numbers` (T,)."""
    seen = recording.seen
    if seen is not None:
        place = np.full(len(recording.frame_numbers), -1)
        place[rows[rows >= 0]] = np.flatnonzero(rows >= 0)
        kept = seen.select(place[seen.row] >= 0)
        seen = replace(kept, row=place[kept.row])
    return replace(
        recording,
        frame_numbers=numbers,
        seen=seen,
        points=tuple(_hand_at(hand, rows) for hand in recording.points),
        posed=tuple(_hand_at(hand, rows) for hand in recording.posed),
    )


def _hand_at(hand: PointsHand | HandMotion, rows: np.ndarray) -> Any:
    def at(array: np.ndarray) -> np.ndarray:
        taken = np.array(array, dtype=np.float64)[rows]
        taken[rows < 0] = np.nan
        return taken

    return replace(hand, **{name: at(value) for name, value in arrays_of(hand, "T").items()})


def scaled(recording: Recording, width: int, height: int) -> Recording:
    """Return the recording with its keypoints in pixels of pictures of that size, whatever size it was made
    at."""
    if recording.size is None or recording.size == (width, height):
        return replace(recording, size=(width, height))
    by = np.array([width / recording.size[0], height / recording.size[1]])
    seen, camera = recording.seen, recording.intrinsics
    if seen is not None:
        seen = replace(seen, points=seen.points * [*by, by[0]])
    if camera is not None:
        camera = type(camera)(camera.fx * by[0], camera.fy * by[1], camera.cx * by[0], camera.cy * by[1])
    return replace(recording, seen=seen, intrinsics=camera, size=(width, height))
