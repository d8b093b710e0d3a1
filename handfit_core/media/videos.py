"""Videos: their pictures, upright and with square pixels."""

from __future__ import annotations

import itertools
import logging
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from handfit_core.common.errors import InputError
from handfit_core.media.exif import upright
from handfit_core.media.kinds import unreadable
from handfit_core.media.settings import MEDIA
from handfit_core.media.size_limit import VIDEO, check_video, is_picture
from handfit_core.media.source import DEFAULT_FPS, Frame, Media, Source, Wanted

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

    from handfit_core.media.decoding import Reading

log = logging.getLogger("handfit")

_ORIENTATIONS: Final = (
    *((1, 0, 0, 1), (-1, 0, 0, 1), (-1, 0, 0, -1), (1, 0, 0, -1)),
    *((0, 1, 1, 0), (0, 1, -1, 0), (0, -1, -1, 0), (0, -1, 1, 0)),
)
"""The signs of a display matrix for each of EXIF's orientations, as ISO 14496-12 6.2.2 has it: x' = a x + c y
and y' = b x + d y"""


@dataclass(frozen=True)
class _Form:
    """The way in which the pictures of a clip become those of a take."""

    width: int
    height: int
    """Height in pixels, with `width` beside it, of the picture with square pixels, before it is turned"""
    orientation: int
    """EXIF orientation, 1-8, that is undone"""

    @classmethod
    def of(cls, picture: VideoFrame, aspect: float) -> _Form:
        """Return the form of a clip's first picture; `aspect` is the width of a pixel by its height."""
        width, height = picture.width, picture.height
        if abs(aspect - 1.0) > MEDIA.square_pixels and 1.0 / MEDIA.max_aspect < aspect < MEDIA.max_aspect:
            width, height = round(width * max(aspect, 1.0)), round(height / min(aspect, 1.0))
        matrix = picture.side_data.get("DISPLAYMATRIX")
        orientation = 1
        if matrix is not None:
            values = np.frombuffer(matrix, dtype=np.int32)[[0, 1, 3, 4]].astype(np.float64)
            signs = np.round(values / max(np.abs(values).max(), 1.0)).astype(int)
            orientation = 1 + (_ORIENTATIONS.index(found) if (found := tuple(signs)) in _ORIENTATIONS else 0)
        return cls(width, height, orientation)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels of the upright picture."""
        return (self.height, self.width) if self.orientation >= 5 else (self.width, self.height)

    def applied(self, picture: VideoFrame, scaler: Any) -> np.ndarray:
        """Return a picture as upright (H, W, 3) uint8 RGB. `scaler` is PyAV's reformatter, which one thread
        uses."""
        # With as many colors as pixels, planes are converted faster, and to the same values.
        wanted = "gbrp" if "444" in picture.format.name else "rgb24"
        picture = scaler.reformat(picture, self.width, self.height, wanted, threads=1)
        rgb = _merged(picture) if wanted == "gbrp" else picture.to_ndarray()
        return rgb if self.orientation == 1 else np.ascontiguousarray(upright(rgb, self.orientation))


def _merged(picture: VideoFrame) -> np.ndarray:
    """Return (H, W, 3) uint8 RGB of a picture with planes of green, blue and red."""
    import cv2

    def pixels(plane: Any) -> np.ndarray:
        rows = np.frombuffer(memoryview(plane), dtype=np.uint8).reshape(plane.height, plane.line_size)
        return rows[:, : plane.width]

    green, blue, red = map(pixels, picture.planes)
    return cv2.merge([red, green, blue])


class Video(Media):
    """A video file, read through FFmpeg."""

    _reading: tuple[Reading, Iterator[tuple[int, VideoFrame]], int] | None = None
    """The decoder of a video that was read in part, its pictures, and the frame number of the last one that
    it gave"""
    _threads = 0
    """Number of threads that decode; 0: one a core"""

    def __init__(self, path: Path, wanted: Wanted) -> None:
        self._path, self._range, frames = path, wanted.frames, wanted.frames
        if not is_picture(path):  # an animation
            check_video(path, wanted.max_megapixels)
        self._max_megapixels = wanted.max_megapixels
        # Until it has seen a large piece freed, glibc gives the memory of each picture back to the system; to
        # get it again page by page for the next one takes as long as to decode that.
        np.empty(MEDIA.kept_bytes, dtype=np.uint8)
        reading = self._opened()
        pictures = reading.pictures()
        self._reading = reading, pictures, 0
        try:
            check_video(path, wanted.max_megapixels, reading.size)
            first = next(pictures, None)
            if first is None:
                raise unreadable(path)
            self._reading = reading, itertools.chain([first], pictures), 0
            self._form = _Form.of(first[1], reading.aspect)
            self.width, self.height = self._form.size
            check_video(path, wanted.max_megapixels, self._form.size)
            if not reading.fps:
                log.warning("%s: names no frame rate; %g frames per second are assumed", path, DEFAULT_FPS)
            self.fps = reading.fps or DEFAULT_FPS
            count = self._frame_count(reading)
            if frames.first is not None and count > 0 and frames.first > count:
                raise InputError(f"{path}: frames {frames} lie behind its end; it has frames 1-{count}")
        except InputError:
            self.close()
            raise
        used = frames.within(1, count)
        self.expected_frames = len(used)
        self.first_and_last = (used[0], used[-1]) if used else (1, 1)
        self._count = count
        self.source = Source("video", (str(path.resolve()),), self._form.orientation)

    def _opened(self) -> Reading:
        from handfit_core.media.decoding import opened

        return opened(self._path, int(1e6 * (self._max_megapixels or VIDEO.of(self._path))), self._threads)

    def limit_threads(self, count: int) -> None:
        """Decode with so many threads from now on."""
        self.close()
        self._threads = count

    def _frame_count(self, reading: Reading) -> int:
        """Return how many frames the clip has by its header; 0 where it tells no length, or more frames than
        the file has bytes."""
        count = round(reading.seconds * self.fps)
        return count if 0 < count <= min(self._path.stat().st_size, MEDIA.max_frame_number) else 0

    def numbers(self, first: int = 0, count: int | None = None) -> range:
        """Return the numbers of the wanted frames, without an end, since the header's count is not
        trusted."""
        return self._range.within(1, sys.maxsize)[first:][:count]

    def all_numbers(self) -> range:
        """Return the numbers from 1 to the header's count, or without an end where it has none."""
        return range(1, self._count + 1 if self._count else sys.maxsize)

    def frames(self, first: int = 0, count: int | None = None, step: int = 1) -> Iterator[Frame]:
        """Yield the frames in order, see `Media`; warns of a video that breaks off.

        A frame on which the picture before is shown again has no picture. Frames behind those that were read
        last are found by reading on, or from a nearer place that the container's index has; others by reading
        from the beginning.
        """
        wanted = self.numbers(first, count)[::step]
        if not wanted:
            return
        kept, self._reading = self._reading, None
        if kept is not None and kept[2] >= wanted[0]:
            kept[0].close()
            kept = None
        if kept is None:
            reading = self._opened()
            kept = reading, reading.pictures(), 0
        reading, pictures, number = kept
        if reading.begins_between(number, wanted[0]):
            pictures = reading.sought(wanted[0])
        at, ended = 0, True
        try:
            for number, picture in pictures:
                while at < len(wanted) and wanted[at] < number:
                    yield Frame(wanted[at], (wanted[at] - 1) / self.fps, None)
                    at += 1
                if at < len(wanted) and wanted[at] == number:
                    yield Frame(number, (number - 1) / self.fps, self._form.applied(picture, reading.scaler))
                    at += 1
                if at == len(wanted):
                    ended = False
                    break
        finally:
            if not ended and count is not None:
                self._reading = reading, pictures, number
            else:
                reading.close()
        if ended:
            self._warn(reading, number, within=not first or at > 0)

    def _warn(self, reading: Reading, last: int, *, within: bool) -> None:
        """Warn of what was missing in a video that was read to its end."""
        if reading.ended:
            log.warning("%s: %s; the clip is read up to there", self._path, reading.ended)
        elif within and last + MEDIA.missing_frames < self._count:
            said = "%s: the video breaks off after frame %d of %d; the rest is missing"
            log.warning(said, self._path, last, self._count)
        if reading.broken:
            said = "%s: no pictures came for %.1f seconds; no hand is there meanwhile"
            log.warning(said, self._path, reading.broken)
        if reading.out_of_order:
            said = "%s: the times of %d pictures run back; they are left out"
            log.warning(said, self._path, reading.out_of_order)

    def pictures(self, numbers: Sequence[int]) -> Iterator[np.ndarray | None]:
        """Yield the pictures (H, W, 3) uint8 RGB that are shown on single frames, by increasing number; None
        for one that cannot be read. Frames that are far apart are sought."""
        reading = self._opened()
        try:
            following = reading.pictures()
            shown, ahead = None, next(following, None)
            for wanted in numbers:
                if ahead is not None and wanted - ahead[0] > MEDIA.min_seek_frames:
                    following = reading.sought(wanted)
                    shown, ahead = None, next(following, None)
                while ahead is not None and ahead[0] <= wanted:
                    shown, ahead = ahead, next(following, None)
                is_shown = shown is not None and (ahead is not None or wanted == shown[0])
                yield self._form.applied(shown[1], reading.scaler) if shown is not None and is_shown else None
        finally:
            reading.close()

    def close(self) -> None:
        """Release the file. A later read opens it again."""
        if self._reading is not None:
            self._reading[0].close()
            self._reading = None

    def __del__(self) -> None:
        self.close()
