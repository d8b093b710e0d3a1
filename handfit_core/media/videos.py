"""Videos: their pictures, upright, on frames of a constant rate.

What a clip shows on a frame is what Blender shows there, so that hands and plate agree: frame n is the last
picture whose time stamp is not behind (n - 1) / fps, at the rate that FFmpeg guesses. Of pictures that come
faster than that the later ones count, and a frame on which the picture before is shown again has none of its
own. Blender's movie_read.cc (`ffmpeg_get_pts_to_search`) is the source of the rule.
"""

from __future__ import annotations

import contextlib
import heapq
import logging
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from handfit_core.common.errors import InputError
from handfit_core.media.exif import upright
from handfit_core.media.settings import MEDIA
from handfit_core.media.size_limit import check_frame_size, check_video, not_a_video, pixel_limit
from handfit_core.media.source import DEFAULT_FPS, Frame, Media, Source, Wanted

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

log = logging.getLogger("handfit")

_CONTAINERS: Final = "mov,matroska,avi,gif,apng,asf,mpeg,mpegts,mpegvideo,ogg,flv,mxf,dv"
"""FFmpeg's names of the containers that hold their frames themselves. Others, such as playlists, name files
and addresses that it would open."""
_ORIENTATIONS: Final = {
    (1, 0, 0, 1): 1,
    (-1, 0, 0, 1): 2,
    (-1, 0, 0, -1): 3,
    (1, 0, 0, -1): 4,
    (0, 1, 1, 0): 5,
    (0, 1, -1, 0): 6,
    (0, -1, -1, 0): 7,
    (0, -1, 1, 0): 8,
}
"""EXIF's orientation by the signs of a display matrix, as ISO 14496-12 6.2.2 has it: x' = a x + c y and
y' = b x + d y"""


@dataclass(frozen=True)
class _Form:
    """How the pictures of a clip become those of a take."""

    decoded: tuple[int, int]
    """Width and height of the first picture as it is decoded"""
    width: int
    height: int
    """Those with square pixels, before it is turned"""
    orientation: int
    """EXIF orientation that is undone"""

    @classmethod
    def of(cls, picture: VideoFrame, aspect: Any) -> _Form:
        """That of a clip's first picture; `aspect` is the width of a pixel by its height, None where the file
        does not tell."""
        width, height = picture.width, picture.height
        aspect = float(aspect or 1.0)
        if abs(aspect - 1.0) > MEDIA.square_pixels and 1.0 / MEDIA.max_aspect < aspect < MEDIA.max_aspect:
            width, height = round(width * max(aspect, 1.0)), round(height / min(aspect, 1.0))
        matrix = picture.side_data.get("DISPLAYMATRIX")
        orientation = 1
        if matrix is not None:
            values = np.frombuffer(matrix, dtype=np.int32)[[0, 1, 3, 4]].astype(np.float64)
            signs = np.round(values / max(np.abs(values).max(), 1.0)).astype(int)
            orientation = _ORIENTATIONS.get(tuple(signs.tolist()), 1)
        return cls((picture.width, picture.height), width, height, orientation)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the upright picture."""
        return (self.height, self.width) if self.orientation >= 5 else (self.width, self.height)

    def fits(self, picture: VideoFrame) -> bool:
        """True if a picture is as wide for its height as the first."""
        width, height = self.decoded
        return abs(picture.width * height - picture.height * width) <= max(
            picture.width, picture.height, *self.decoded
        )

    def applied(self, picture: VideoFrame, scaler: Any) -> np.ndarray:
        """(H, W, 3) uint8 RGB of a picture. `scaler`: PyAV's reformatter, which one thread uses."""
        rgb = scaler.reformat(picture, self.width, self.height, "rgb24").to_ndarray()
        return rgb if self.orientation == 1 else np.ascontiguousarray(upright(rgb, self.orientation))


class _Reading:
    """A video that is decoded from its beginning, or from a place in it."""

    def __init__(self, path: Path, max_pixels: int) -> None:
        """Open it. Raises InputError where FFmpeg cannot, and for one without pictures."""
        import av
        from av.video.reformatter import VideoReformatter

        self._path, self.scaler = path, VideoReformatter()
        # FFmpeg gets the open file and never its name, which it might take for an address or a pattern.
        self._file = open(path, "rb")  # noqa: SIM115 (until it is closed)
        try:
            self.container: InputContainer = av.open(
                self._file,
                options={"format_whitelist": _CONTAINERS, "protocol_whitelist": "none"},
                stream_options=None,
            )
            self.stream: VideoStream = self.container.streams.best("video")  # type: ignore[assignment]
            if self.stream is None:
                raise InputError(f"{path}: there are no pictures in it, as in a sound; choose a video")
        except (av.FFmpegError, InputError) as error:
            self._file.close()
            raise error if isinstance(error, InputError) else InputError(not_a_video(path)) from error
        context = self.stream.codec_context
        context.options = {"max_pixels": str(max_pixels)}
        context.thread_type = "AUTO"
        self.start = self.stream.start_time or 0
        rate = float(self.stream.guessed_rate or 0.0)
        self.fps = rate if 0.0 < rate <= MEDIA.max_fps else 0.0
        self._per_frame = 1.0 / ((self.fps or DEFAULT_FPS) * float(self.stream.time_base or 1.0))
        self.out_of_order = 0
        """Pictures that were left out, as their time is before that of one that came before"""

    def close(self) -> None:
        """Release the file."""
        self.container.close()
        self._file.close()

    def _stamp(self, number: int) -> int:
        """The time that frame `number`, counted from 1, stands for, in the stream's units from its start."""
        return math.floor((number - 1) * self._per_frame + 0.5)

    def _number(self, stamp: int) -> int:
        """The first frame on which a picture is shown."""
        number = max(1, math.floor((stamp - self.start - 0.5) / self._per_frame))
        while self._stamp(number) < stamp - self.start:
            number += 1
        return number

    def _decoded(self) -> Iterator[VideoFrame]:
        """Pictures as the decoder gives them; what is damaged is left out."""
        import av

        packets = self.container.demux(self.stream)
        while True:
            try:
                packet = next(packets)
            except (StopIteration, av.FFmpegError):
                return
            try:
                yield from packet.decode()
            except av.FFmpegError:
                continue

    def _ordered(self) -> Iterator[tuple[int, int, VideoFrame]]:
        """(time stamp, count, picture) by time: decoders that begin in the middle give some too early."""
        waiting: list[tuple[int, int, VideoFrame]] = []
        last = self.start - 1
        for count, picture in enumerate(self._decoded()):
            last = picture.pts if picture.pts is not None else last + max(1, round(self._per_frame))
            heapq.heappush(waiting, (last, count, picture))
            if len(waiting) > MEDIA.reordered_frames:
                yield heapq.heappop(waiting)
        while waiting:
            yield heapq.heappop(waiting)

    def pictures(self, first: int = 1) -> Iterator[tuple[int, VideoFrame]]:
        """Frame numbers, increasing, and the pictures that are first shown on them. Ends, with a warning,
        where none follows for long; frame `first` is reached however long that takes."""
        shown: tuple[int, VideoFrame] | None = None
        for stamp, _, picture in self._ordered():
            number = self._number(stamp)
            if shown is not None and number < shown[0]:
                self.out_of_order += 1
                continue
            if shown is not None and number > shown[0]:
                yield shown
            gap = (number - max(first, shown[0] if shown else 0)) / (self.fps or DEFAULT_FPS)
            if gap > MEDIA.max_gap_seconds:
                log.warning(
                    "%s: no picture follows for %.0f seconds after frame %d; the clip is read up to there",
                    self._path,
                    gap,
                    shown[0] if shown else 0,
                )
                return
            shown = number, picture
        if shown is not None:
            yield shown

    def sought(self, number: int) -> Iterator[tuple[int, VideoFrame]]:
        """`pictures` from one on that is shown on a frame or before it, as the container's index has it."""
        import av

        for stamp in (self._stamp(number), 0):
            with contextlib.suppress(av.FFmpegError):
                self.container.seek(self.start + stamp, stream=self.stream)
                following = self.pictures(first=number)
                if (begun := next(following, None)) is not None and begun[0] <= number:
                    yield begun
                    yield from following
                    return


class Video(Media):
    """A video file, read through FFmpeg."""

    def __init__(self, path: Path, wanted: Wanted) -> None:
        self._path, self._range, frames = path, wanted.frames, wanted.frames
        check_video(path, wanted.max_megapixels)
        self._max_pixels = pixel_limit(path, wanted.max_megapixels)
        self._reading: tuple[_Reading, Iterator[tuple[int, VideoFrame]], int] | None = None
        """Where a part was read: the decoder, its pictures, and the number of the one that it gave last"""
        self._warned = False
        """True once it was said that pictures change their size"""
        reading = _Reading(path, self._max_pixels)
        try:
            context = reading.stream.codec_context
            check_frame_size(path, context.width, context.height, wanted.max_megapixels)
            _, first = next(reading.pictures(), (0, None))
            if first is None:
                raise InputError(not_a_video(path))
            self._form = _Form.of(first, reading.stream.sample_aspect_ratio)
            self.width, self.height = self._form.size
            check_frame_size(path, self.width, self.height, wanted.max_megapixels)
            if not reading.fps:
                log.warning("%s: names no frame rate; %g frames per second are assumed", path, DEFAULT_FPS)
            self.fps = reading.fps or DEFAULT_FPS
            count = self._frame_count(reading)
        finally:
            reading.close()
        if frames.first is not None and count > 0 and frames.first > count:
            raise InputError(f"{path}: frames {frames} lie behind its end; it has frames 1-{count}")
        used = frames.within(1, count)
        self.expected_frames = len(used)
        self.first_and_last = (used[0], used[-1]) if used else (1, 1)
        self._count = count
        self.source = Source("video", (str(path.resolve()),), self._form.orientation)

    def _frame_count(self, reading: _Reading) -> int:
        """How many frames the clip has by its header; 0 where it tells no length, or more frames than the
        file has bytes."""
        seconds = float((reading.stream.duration or 0) * (reading.stream.time_base or 0))
        seconds = seconds or (reading.container.duration or 0) / 1e6
        count = round(seconds * self.fps)
        return count if 0 < count <= min(self._path.stat().st_size, MEDIA.max_frame_number) else 0

    def numbers(self, first: int = 0, count: int | None = None) -> range:
        """The numbers of the wanted frames, without an end, since the header's count is not trusted."""
        return self._range.within(1, sys.maxsize)[first:][:count]

    def all_numbers(self) -> range:
        """The numbers from 1 to the header's count, or without an end where it has none."""
        return range(1, self._count + 1 if self._count else sys.maxsize)

    def frames(self, first: int = 0, count: int | None = None, step: int = 1) -> Iterator[Frame]:
        """Yield the frames in order, see `Media`; warns of a video that breaks off.

        A frame on which the picture before is shown again has no picture. Frames behind those that were read
        last are found by reading on, others by reading from the beginning.
        """
        wanted = self.numbers(first, count)[::step]
        if not wanted:
            return
        kept, self._reading = self._reading, None
        if kept is not None and kept[2] >= wanted[0]:
            kept[0].close()
            kept = None
        if kept is None:
            reading = _Reading(self._path, self._max_pixels)
            kept = reading, reading.pictures(), 0
        reading, pictures, number = kept
        at, ended = 0, True
        try:
            for number, picture in pictures:
                while at < len(wanted) and wanted[at] < number:
                    yield Frame(wanted[at], (wanted[at] - 1) / self.fps, None)
                    at += 1
                if at < len(wanted) and wanted[at] == number:
                    yield Frame(number, (number - 1) / self.fps, self._rgb(reading, number, picture))
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

    def _rgb(self, reading: _Reading, number: int, picture: VideoFrame) -> np.ndarray | None:
        """A picture as the take has it, scaled to the size of the first; None for one of another shape."""
        if not self._form.fits(picture):
            if not self._warned:
                log.warning(
                    "%s: its pictures change from %dx%d to %dx%d pixels; frame %d and those like it are left "
                    "empty",
                    *(self._path, *self._form.decoded, picture.width, picture.height, number),
                )
            self._warned = True
            return None
        return self._form.applied(picture, reading.scaler)

    def _warn(self, reading: _Reading, last: int, *, within: bool) -> None:
        """Say what was missing in a video that was read to its end."""
        if within and last + MEDIA.missing_frames < self._count:
            log.warning(
                "%s: the video breaks off after frame %d of %d; the rest is missing",
                self._path,
                last,
                self._count,
            )
        if reading.out_of_order:
            log.warning(
                "%s: the times of %d pictures run back; they are left out", self._path, reading.out_of_order
            )

    def pictures(self, numbers: Sequence[int]) -> Iterator[np.ndarray | None]:
        """The pictures (H, W, 3) uint8 RGB that are shown on single frames, by increasing number; None for
        one that cannot be read. Frames that are far apart are sought."""
        reading = _Reading(self._path, self._max_pixels)
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
                yield self._rgb(reading, *shown) if shown is not None and is_shown else None
        finally:
            reading.close()

    def close(self) -> None:
        """Release the file. A later read opens it again."""
        if self._reading is not None:
            self._reading[0].close()
            self._reading = None
