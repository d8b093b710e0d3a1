"""Videos: their frames, one after another."""

from __future__ import annotations

import logging
import math
import sys
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.common.errors import InputError
from handfit_core.common.files import shown
from handfit_core.media.recording import is_recording
from handfit_core.media.settings import MEDIA
from handfit_core.media.size_limit import check_frame_size, check_video, not_a_video
from handfit_core.media.source import DEFAULT_FPS, Frame, Media, Source, Wanted

log = logging.getLogger("handfit")


def _frame_count(path: Path, claimed: float) -> int:
    """How many frames a video has by its header; 0 where it claims none, or more than the file has bytes."""
    return int(claimed) if 0 < claimed <= path.stat().st_size else 0


def _times(name: str) -> np.ndarray:
    """(N,) presentation times of a video's packets, milliseconds, ascending, without decoding any; (0,) where
    OpenCV has none."""
    import cv2

    packets, times = cv2.VideoCapture(name, cv2.CAP_FFMPEG), array("d")
    try:
        if packets.set(cv2.CAP_PROP_FORMAT, -1):
            while packets.grab():
                times.append(packets.get(cv2.CAP_PROP_POS_MSEC))
    finally:
        packets.release()
    return np.sort(np.array(times))


class Video(Media):
    """A video file, read through OpenCV. Rotation stored in the file is applied by OpenCV."""

    def __init__(self, path: Path, wanted: Wanted) -> None:
        import cv2

        frames = wanted.frames
        self._path, self._range = path, frames
        check_video(path, wanted.max_megapixels)
        # Absolute, since FFmpeg takes a relative name that begins with "http:" or "tcp:" for an address.
        self._name = str(path.absolute())
        try:
            self._name.encode()
        except UnicodeEncodeError as error:  # OpenCV would end the process
            raise InputError(f"{shown(path)}: its name is no text in UTF-8; rename the file") from error
        capture = cv2.VideoCapture(self._name)
        try:
            # The decoder's size, since the container's may be another one.
            width, height = (capture.get(p) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
            check_frame_size(path, int(width), int(height), wanted.max_megapixels)
            found, first = capture.read() if capture.isOpened() else (False, None)
            if not found or first is None:
                raise InputError(not_a_video(path))
            fps = float(capture.get(cv2.CAP_PROP_FPS))
            count = _frame_count(path, capture.get(cv2.CAP_PROP_FRAME_COUNT))
        finally:
            capture.release()
        if not math.isfinite(fps) or not 0.0 < fps <= MEDIA.max_fps:
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
        self._reading: tuple[Any, int] | None = None
        """Where a part was read: OpenCV's capture, and the number of the frame that it gave last"""
        self.source = Source(kind="video", files=(str(path.resolve()),))

    def check_steady(self) -> None:
        """Raise InputError for a video whose frames are not evenly spaced in time: its n-th frame does not
        lie where the rate says. Reads the whole file, and decodes nothing."""
        times = self.times()
        if times is None:
            return
        even = np.linspace(times[0], times[-1], len(times))
        away = float(np.abs(times - even).max() * (len(times) - 1) / max(times[-1] - times[0], 1e-9))
        if away > MEDIA.max_jitter_frames:
            raise InputError(
                f"{self._path}: its frame rate changes on the way (by {away:.0f} frames), so it cannot be "
                "retimed; convert it to a constant rate, or match the scene to the clip"
            )

    def times(self) -> np.ndarray | None:
        """(N,) seconds from the first frame to each one, as the file tells them; None where it does not, and
        for live recordings of ours, whose takes are even. Reads the whole file, and decodes nothing."""
        times = _times(self._name) / 1000.0
        return None if len(times) < 2 or is_recording(self._path) else times - times[0]

    def recorded_times(self) -> np.ndarray | None:
        """(N,) seconds at which the frames of a live recording of ours came; None for other videos, whose
        frames are evenly spaced."""
        return _times(self._name) / 1000.0 if is_recording(self._path) else None

    def numbers(self, first: int = 0, count: int | None = None) -> range:
        """The numbers of the wanted frames, without an end, since the header's count is not trusted."""
        return self._range.within(1, sys.maxsize)[first:][:count]

    def all_numbers(self) -> range:
        """The numbers from 1 to the header's count, or without an end where it has none."""
        return range(1, self._count + 1 if self._count else sys.maxsize)

    def frames(self, first: int = 0, count: int | None = None, step: int = 1) -> Iterator[Frame]:
        """Yield the frames in order, see `Media`; warns of a video that breaks off.

        Frames behind those that were read last are found by reading on, others by reading from the beginning:
        counting is the only way to a frame's number that can be trusted.
        """
        import cv2

        wanted = self.numbers(first, count)[::step]
        if not wanted:
            return
        capture, number = self._reading or (cv2.VideoCapture(self._name), 0)
        self._reading = None
        if number >= wanted[0]:
            capture.release()
            capture, number = cv2.VideoCapture(self._name), 0
        grabbed = True
        try:
            while number < wanted[-1] and (grabbed := capture.grab()):
                number += 1
                if number not in wanted:
                    continue
                ok, bgr = capture.retrieve()
                rgb = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB) if ok else None
                yield Frame(number, (number - 1) / self.fps, rgb)
        finally:
            if grabbed and count is not None:
                self._reading = capture, number
            else:
                capture.release()
        within = not first or number >= wanted[0] - wanted.step
        if not grabbed and within and number + 1 < self._count:
            log.warning(
                "%s: the video breaks off after frame %d of %d; the rest is missing",
                self._path,
                number,
                self._count,
            )

    def pictures(self, numbers: Sequence[int], count: int) -> Iterator[np.ndarray | None]:
        """The pictures (H, W, 3) uint8 RGB of single frames, by increasing number; None for one that cannot
        be read. `count` is the number of frames that reading to the end has found.

        Long videos are sought in where they have as many packets as frames, since the time of the n-th frame
        is then that of the n-th packet. Others are read from the beginning.
        """
        import cv2

        capture = cv2.VideoCapture(self._name)
        times = _times(self._name) if count > MEDIA.min_seek_frames else np.empty(0)
        number, can_seek = 0, len(times) == count and max(numbers) <= count
        try:
            for wanted in numbers:
                if can_seek and capture.set(cv2.CAP_PROP_POS_FRAMES, wanted - 1):
                    number = wanted - 1
                grabbed = True
                while grabbed and number < wanted:
                    grabbed, number = capture.grab(), number + 1
                if can_seek and capture.get(cv2.CAP_PROP_POS_MSEC) != times[wanted - 1]:
                    capture.release()
                    yield from self.pictures([n for n in numbers if n >= wanted], -1)
                    return
                ok, bgr = capture.retrieve() if grabbed else (False, None)
                yield cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB) if ok and bgr is not None else None
        finally:
            capture.release()

    def close(self) -> None:
        """Release the file. A later read opens it again."""
        if self._reading is not None:
            self._reading[0].release()
            self._reading = None
