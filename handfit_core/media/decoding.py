"""Videos as their decoders give them: pictures on frames of a constant rate. The worker alone loads this.

What a clip shows on a frame is what Blender shows there, so that hands and plate agree: frame n is the last
picture whose time stamp is not behind (n - 1) / fps, at the rate that FFmpeg guesses. Of pictures that come
faster than that the later ones count, and a frame on which the picture before is shown again has none of its
own. Blender's movie_read.cc (`ffmpeg_get_pts_to_search`) is the source of the rule.
"""

from __future__ import annotations

import contextlib
import heapq
import io
import math
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import av
import cv2
import numpy as np
from av.error import FFmpegError
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from av.video.stream import VideoStream

from handfit_core.common.errors import InputError
from handfit_core.media.headers import PICTURES, Header, begins, read_picture_header
from handfit_core.media.kinds import unreadable
from handfit_core.media.settings import MEDIA
from handfit_core.media.source import DEFAULT_FPS

_CONTAINERS: Final = "mov,matroska,avi,gif,apng,asf,mpeg,mpegts,mpegvideo,ogg,flv,mxf,dv"
"""FFmpeg's names of the containers that hold their frames themselves. Others, such as playlists, name files
and addresses that it would open."""


def opened(path: Path, max_pixels: int, threads: int = 0) -> Reading:
    """Open a video, to be read from its beginning by so many threads (0: one a core), with frames of at most
    so many pixels. Raises InputError where it is no video that can be read, and OSError where the file cannot
    be."""
    return _Animation(path) if begins(path, PICTURES["WebP"]) else _File(path, max_pixels, threads)


@dataclass(eq=False)
class Reading:
    """A video that is decoded from its beginning, or from a place in it."""

    size: tuple[int, int]
    """Width and height that the container claims, in pixels"""
    fps: float
    """Frames per second that the file tells; 0 where it tells none"""
    seconds: float
    """Length in seconds that the container claims; 0 where it claims none"""
    unit: float
    """Seconds of one step of the stream's time stamps"""
    start: int = 0
    """Time stamp at which the stream begins"""
    aspect: float = 1.0
    """Ratio of a pixel's width to its height"""
    ended: str = ""
    """The reason why reading ended before the video's end; empty where it did not"""
    out_of_order: int = 0
    """Number of pictures that were left out, as their time is before that of one that came before"""
    broken: float = 0.0
    """Seconds of all breaks between pictures together"""

    def __post_init__(self) -> None:
        self.scaler = VideoReformatter()
        """Converts the video's pictures; one thread uses it"""
        self.fps = self.fps if 0.0 < self.fps <= MEDIA.max_fps else 0.0
        self._per_frame = 1.0 / ((self.fps or DEFAULT_FPS) * self.unit)
        self._size: tuple[int, int] | None = None
        """Width and height of the video's first picture, in pixels; None before it was read"""

    def _decoded(self) -> Iterator[VideoFrame]:
        """Yield the pictures as the decoder gives them; damaged ones are left out."""
        raise NotImplementedError

    def _seek(self, stamp: int) -> bool:
        """Move so that the next picture to be decoded is one at that time stamp or before it; return True if
        that was done."""
        raise NotImplementedError

    def _beginnings(self) -> list[int]:
        """Return the time stamps of the pictures that can be decoded without others, as far as the container
        has an index."""
        return []

    def close(self) -> None:
        """Release the file."""
        raise NotImplementedError

    def begins_between(self, after: int, number: int) -> bool:
        """Return True if the container's index has a place behind frame `after` from which frame `number` can
        be decoded."""
        low, high = self._stamp(after), self._stamp(number - MEDIA.reordered_frames)
        return any(low < stamp - self.start <= high for stamp in self._beginnings())

    def _stamp(self, number: int) -> int:
        """Return the time stamp that frame `number`, counted from 1, stands for, in the stream's units from
        its start."""
        return math.floor((number - 1) * self._per_frame + 0.5)

    def _number(self, stamp: int) -> int:
        """Return the number of the first frame on which a picture with that time stamp is shown."""
        number = max(1, math.floor((stamp - self.start - 0.5) / self._per_frame))
        while self._stamp(number) < stamp - self.start:
            number += 1
        return number

    def _ordered(self) -> Iterator[tuple[int, int, VideoFrame]]:
        """Yield (time stamp, count, picture) by rising time: decoders that begin in the middle give some
        pictures too early."""
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
        """Yield increasing frame numbers, and the pictures that are first shown on them. Ends where no
        picture follows for long, frame `first` excepted, and where the size changes, as Blender shows nothing
        more."""
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
        """Yield what `pictures` does, from a picture on that is shown on frame `number` or before it, as the
        container's index has it."""
        # An index has the times of decoding, which are earlier than those of showing.
        for stamp in (self._stamp(max(1, number - MEDIA.reordered_frames)), 0):
            if self._seek(self.start + stamp):
                following = self.pictures(first=number)
                if (begun := next(following, None)) is not None and begun[0] <= number:
                    yield begun
                    yield from following
                    return


class _File(Reading):
    """A video that FFmpeg reads."""

    def __init__(self, path: Path, max_pixels: int, threads: int) -> None:
        """Open a video file. Raises InputError where FFmpeg cannot, and for a file without pictures."""
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
            raise unreadable(path) from error
        stream = self._container.streams.best("video")
        if not isinstance(stream, VideoStream):
            self.close()
            raise InputError(f"{path}: there are no pictures in it, as in a sound; choose a video")
        if stream.codec_context is None:  # FFmpeg does not know how they are stored
            self.close()
            raise unreadable(path)
        self._stream, context = stream, stream.codec_context
        context.options = {"max_pixels": str(max_pixels)}
        context.thread_type, context.thread_count = "AUTO", threads
        unit = float(stream.time_base or 1.0)
        super().__init__(
            (context.width, context.height),
            float(stream.guessed_rate or 0.0),
            (stream.duration or 0) * unit or (self._container.duration or 0) / 1e6,
            unit=unit,
            start=stream.start_time or 0,
            aspect=float(stream.sample_aspect_ratio or 1.0),
        )

    def _decoded(self) -> Iterator[VideoFrame]:
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets)
            except (StopIteration, FFmpegError):
                return
            with contextlib.suppress(FFmpegError):
                yield from packet.decode()

    def _beginnings(self) -> list[int]:
        if (
            self._container.format.name == "mpeg"
        ):  # its index is of packets, and pictures begin anywhere in them
            return []
        return [entry.timestamp for entry in self._stream.index_entries if entry.is_keyframe]

    def _seek(self, stamp: int) -> bool:
        try:
            self._container.seek(stamp, stream=self._stream)
        except FFmpegError:
            return False
        return True

    def close(self) -> None:
        self._container.close()
        self._file.close()


class _Animation(Reading):
    """A WebP with several pictures, which FFmpeg does not decode."""

    def __init__(self, path: Path) -> None:
        """Decode a WebP file. Raises InputError for a damaged one, and for one with more pixels than are held
        in memory."""
        data = path.read_bytes()
        header = read_picture_header(io.BytesIO(data)) or Header()
        pixels = data.count(b"ANMF") * header.width * header.height
        if pixels > MEDIA.max_animation_pixels:
            raise InputError(f"{path}: its pictures have {pixels / 1e6:.0f} megapixels; convert it to .mp4")
        # OpenCV reads it by its name, in ASCII on Windows.
        with tempfile.TemporaryDirectory() as folder:
            shutil.copy(path, copy := Path(folder) / "a.webp")
            found, animation = cv2.imreadanimation(str(copy))
        if not found:
            raise InputError(f"{path}: a damaged animation; open it in a viewer and save it again")
        times = np.cumsum([0, *np.maximum(animation.durations, 1)]).tolist()
        self._pictures = list(zip(times, animation.frames, strict=False))
        fps = min(1000.0 / float(np.median(np.diff(times))), MEDIA.max_fps)
        super().__init__((header.width, header.height), fps, times[-1] / 1000.0, unit=0.001)

    def _decoded(self) -> Iterator[VideoFrame]:
        for time, bgr in self._pictures:
            bgr = np.ascontiguousarray(bgr[..., :3], dtype=np.uint8)
            picture = VideoFrame.from_ndarray(bgr, format="bgr24")
            picture.pts = time
            yield picture

    def _seek(self, stamp: int) -> bool:
        return stamp == 0

    def close(self) -> None:
        self._pictures = []
