"""Videos: their pictures, upright, on frames of a constant rate.

What a clip shows on a frame is what Blender shows there, so that hands and plate agree: frame n is the last
picture whose time stamp is not behind (n - 1) / fps, at the rate that FFmpeg guesses. Of pictures that come
faster than that the later ones count, and a frame on which the picture before is shown again has none of its
own. Blender's movie_read.cc (`ffmpeg_get_pts_to_search`) is the source of the rule.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import logging
import math
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from handfit_core.common.errors import InputError
from handfit_core.media.exif import upright
from handfit_core.media.headers import read_picture_header
from handfit_core.media.settings import MEDIA
from handfit_core.media.size_limit import check_frame_size, check_video, is_picture, not_a_video, pixel_limit
from handfit_core.media.source import DEFAULT_FPS, Frame, Media, Source, Wanted

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

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

    width: int
    height: int
    """Of the picture with square pixels, before it is turned"""
    orientation: int
    """EXIF orientation that is undone"""

    @classmethod
    def of(cls, picture: VideoFrame, aspect: float) -> _Form:
        """That of a clip's first picture; `aspect` is the width of a pixel by its height."""
        width, height = picture.width, picture.height
        if abs(aspect - 1.0) > MEDIA.square_pixels and 1.0 / MEDIA.max_aspect < aspect < MEDIA.max_aspect:
            width, height = round(width * max(aspect, 1.0)), round(height / min(aspect, 1.0))
        matrix = picture.side_data.get("DISPLAYMATRIX")
        orientation = 1
        if matrix is not None:
            values = np.frombuffer(matrix, dtype=np.int32)[[0, 1, 3, 4]].astype(np.float64)
            signs = np.round(values / max(np.abs(values).max(), 1.0)).astype(int)
            orientation = _ORIENTATIONS.get(tuple(signs.tolist()), 1)
        return cls(width, height, orientation)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the upright picture."""
        return (self.height, self.width) if self.orientation >= 5 else (self.width, self.height)

    def applied(self, picture: VideoFrame, scaler: Any) -> np.ndarray:
        """(H, W, 3) uint8 RGB of a picture. `scaler`: PyAV's reformatter, which one thread uses."""
        rgb = scaler.reformat(picture, self.width, self.height, "rgb24", threads=1).to_ndarray()
        return rgb if self.orientation == 1 else np.ascontiguousarray(upright(rgb, self.orientation))


class _Reading:
    """A video that is decoded from its beginning, or from a place in it."""

    def __init__(self, path: Path, max_pixels: int) -> None:
        """Open it. Raises InputError where FFmpeg cannot, and for one without pictures."""
        import av
        from av.error import FFmpegError
        from av.video.reformatter import VideoReformatter
        from av.video.stream import VideoStream

        self._path, self.scaler = path, VideoReformatter()
        # FFmpeg gets the open file and never its name, which it might take for an address or a pattern.
        self._file = open(path, "rb")  # noqa: SIM115 (until it is closed)
        try:
            self._container = av.open(
                self._file,
                "r",
                options={"format_whitelist": _CONTAINERS, "protocol_whitelist": "none"},
                metadata_errors="replace",
            )
        except FFmpegError as error:
            self._file.close()
            raise InputError(not_a_video(path)) from error
        stream = self._container.streams.best("video")
        if not isinstance(stream, VideoStream):
            self.close()
            raise InputError(f"{path}: there are no pictures in it, as in a sound; choose a video")
        if stream.codec_context is None:  # FFmpeg does not know how they are stored
            self.close()
            raise InputError(not_a_video(path))
        self._stream, context = stream, stream.codec_context
        context.options = {"max_pixels": str(max_pixels)}
        context.thread_type = "AUTO"
        self.size = context.width, context.height
        """Width and height that the container claims, in pixels"""
        self.aspect = float(stream.sample_aspect_ratio or 1.0)
        """The width of a pixel by its height"""
        self.start = stream.start_time or 0
        unit, rate = float(stream.time_base or 1.0), float(stream.guessed_rate or 0.0)
        self.fps = rate if 0.0 < rate <= MEDIA.max_fps else 0.0
        """The rate that the file tells; 0 where it tells none"""
        self.seconds = (stream.duration or 0) * unit or (self._container.duration or 0) / 1e6
        """Its length, as the container claims; 0 where it does not"""
        self._per_frame = 1.0 / ((self.fps or DEFAULT_FPS) * unit)
        self._size: tuple[int, int] | None = None
        """Width and height of its first picture"""
        self.ended = ""
        """Why reading ended before its end"""
        self.out_of_order = 0
        """Pictures that were left out, as their time is before that of one that came before"""
        self.broken = 0.0
        """Seconds of breaks between pictures"""

    def close(self) -> None:
        """Release the file."""
        self._container.close()
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
        from av.error import FFmpegError

        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets)
            except (StopIteration, FFmpegError):
                return
            try:
                yield from packet.decode()
            except FFmpegError:
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
        """Frame numbers, increasing, and the pictures that are first shown on them. Ends where none follows
        for long, frame `first` excepted, and where their size changes, as Blender shows nothing more."""
        shown: tuple[int, VideoFrame] | None = None
        for stamp, _, picture in self._ordered():
            number = self._number(stamp)
            if shown is not None and number < shown[0]:
                self.out_of_order += 1
                continue
            if shown is not None and number > shown[0]:
                yield shown
            last, size = shown[0] if shown else 0, (picture.width, picture.height)
            gap = (number - max(first, last)) / (self.fps or DEFAULT_FPS)
            self._size = self._size or size
            if gap > MEDIA.max_gap_seconds:
                self.ended = f"no picture follows for {gap:.0f} seconds after frame {last}"
            elif size != self._size:
                self.ended = "its pictures change from {}x{} to {}x{} pixels after frame {}".format(
                    *self._size, *size, last
                )
            if self.ended:
                return
            self.broken += gap if gap > MEDIA.break_seconds else 0.0
            shown = number, picture
        if shown is not None:
            yield shown

    def sought(self, number: int) -> Iterator[tuple[int, VideoFrame]]:
        """`pictures` from one on that is shown on a frame or before it, as the container's index has it."""
        from av.error import FFmpegError

        for stamp in (self._stamp(number), 0):
            with contextlib.suppress(FFmpegError):
                self._container.seek(self.start + stamp, stream=self._stream)
                following = self.pictures(first=number)
                if (begun := next(following, None)) is not None and begun[0] <= number:
                    yield begun
                    yield from following
                    return


class _Animation(_Reading):
    """A WebP with several pictures, which FFmpeg does not decode."""

    def __init__(self, path: Path, width: int, height: int) -> None:
        """Decode it. Raises InputError for a damaged one, and for more than is held in memory."""
        import cv2
        from av.video.reformatter import VideoReformatter

        data = path.read_bytes()
        pixels = data.count(b"ANMF") * width * height
        if pixels > MEDIA.max_animation_pixels:
            raise InputError(f"{path}: its pictures have {pixels / 1e6:.0f} megapixels; convert it to .mp4")
        with (
            tempfile.TemporaryDirectory() as folder
        ):  # since OpenCV reads it by its name, in ASCII on Windows
            shutil.copy(path, copy := Path(folder) / "a.webp")
            found, animation = cv2.imreadanimation(str(copy))
        if not found:
            raise InputError(f"{path}: a damaged animation; open it in a viewer and save it again")
        self._path, self.scaler = path, VideoReformatter()
        self._frames = animation.frames
        self._times = np.concatenate([[0], np.cumsum(np.maximum(animation.durations, 1))]).tolist()
        self.size, self.aspect, self.start = (width, height), 1.0, 0
        self._size, self.ended = None, ""
        self.out_of_order, self.broken = 0, 0.0
        self.seconds = self._times[-1] / 1000.0
        self.fps = min(1000.0 / float(np.median(np.diff(self._times))), MEDIA.max_fps)
        self._per_frame = 1000.0 / self.fps

    def close(self) -> None:
        """Free the pictures."""
        self._frames = []

    def _decoded(self) -> Iterator[VideoFrame]:
        from av.video.frame import VideoFrame

        for time, bgr in zip(self._times, self._frames, strict=False):
            picture = VideoFrame.from_ndarray(
                np.ascontiguousarray(bgr[..., :3], dtype=np.uint8), format="bgr24"
            )
            picture.pts = time
            yield picture

    def sought(self, number: int) -> Iterator[tuple[int, VideoFrame]]:  # noqa: ARG002
        """All pictures, as they are in memory."""
        return self.pictures()


def _opened(path: Path, max_megapixels: float | None) -> _Reading:
    """A clip, to be read from its beginning."""
    with open(path, "rb") as stream:
        header = read_picture_header(stream) if stream.read(4) == b"RIFF" else None
    if header is not None:
        return _Animation(path, header.width, header.height)
    return _Reading(path, pixel_limit(path, max_megapixels))


class Video(Media):
    """A video file, read through FFmpeg."""

    _reading: tuple[_Reading, Iterator[tuple[int, VideoFrame]], int] | None = None
    """What was read in part: the decoder, its pictures, and the number of the one that it gave last"""

    def __init__(self, path: Path, wanted: Wanted) -> None:
        self._path, self._range, frames = path, wanted.frames, wanted.frames
        if not is_picture(path):  # an animation
            check_video(path, wanted.max_megapixels)
        self._max_megapixels = wanted.max_megapixels
        # Until it has seen a large piece freed, glibc gives the memory of each picture back to the system; to
        # get it again page by page for the next one takes as long as to decode that.
        np.empty(MEDIA.kept_bytes, dtype=np.uint8)
        reading = _opened(path, wanted.max_megapixels)
        pictures = reading.pictures()
        self._reading = reading, pictures, 0
        try:
            check_frame_size(path, *reading.size, wanted.max_megapixels)
            first = next(pictures, None)
            if first is None:
                raise InputError(not_a_video(path))
            self._reading = reading, itertools.chain([first], pictures), 0
            self._form = _Form.of(first[1], reading.aspect)
            self.width, self.height = self._form.size
            check_frame_size(path, self.width, self.height, wanted.max_megapixels)
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

    def _frame_count(self, reading: _Reading) -> int:
        """How many frames the clip has by its header; 0 where it tells no length, or more frames than the
        file has bytes."""
        count = round(reading.seconds * self.fps)
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
            reading = _opened(self._path, self._max_megapixels)
            kept = reading, reading.pictures(), 0
        reading, pictures, number = kept
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

    def _warn(self, reading: _Reading, last: int, *, within: bool) -> None:
        """Say what was missing in a video that was read to its end."""
        if reading.ended:
            log.warning("%s: %s; the clip is read up to there", self._path, reading.ended)
        elif within and last + MEDIA.missing_frames < self._count:
            log.warning(
                "%s: the video breaks off after frame %d of %d; the rest is missing",
                self._path,
                last,
                self._count,
            )
        if reading.broken:
            log.warning(
                "%s: no pictures came for %.1f seconds; no hand is there meanwhile",
                self._path,
                reading.broken,
            )
        if reading.out_of_order:
            log.warning(
                "%s: the times of %d pictures run back; they are left out", self._path, reading.out_of_order
            )

    def pictures(self, numbers: Sequence[int]) -> Iterator[np.ndarray | None]:
        """The pictures (H, W, 3) uint8 RGB that are shown on single frames, by increasing number; None for
        one that cannot be read. Frames that are far apart are sought."""
        reading = _opened(self._path, self._max_megapixels)
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
