"""Recordings of live sources: a Matroska file of JPEGs with the time of each.

Each frame is a cluster of its own, written when it comes: whatever ends the program or fills the disk, the
frames before can be read. When it is closed, times move to the nearest frame of a constant rate, that of
the steps between breaks in whole frames per second: jitter goes, and a break stays as long as it was.
"""

from __future__ import annotations

import contextlib
import logging
import os
import struct
from array import array
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.errors import OutputError
from handfit_core.common.files import shown, why
from handfit_core.media.settings import MEDIA

log = logging.getLogger("handfit")

_MARK: Final = "Manient live recording"
_TICKS: Final = 10_000
"""Time steps of a recording in one second"""
_TO_TIME: Final = 21
"""Bytes from the beginning of a cluster to its time"""
_STEPS: Final = 8
"""Number of frames over which a rate is counted, since pictures may come in bursts"""
_QUALITY: Final = 95
"""Quality of the JPEGs, 0..100"""
_LARGEST_SIDE: Final = 65_535
"""Most pixels along a side of a JPEG"""
_LONGEST_BREAK: Final = 60.0
"""Seconds without a picture after which a recording is over: what comes then is another take"""


def _element(name: str, content: bytes | int | str | float) -> bytes:
    """Return an EBML element: its id in hexadecimal, eight bytes of length, the content."""
    if isinstance(content, float):
        content = struct.pack(">d", content)
    elif isinstance(content, int):
        content = struct.pack(">Q", content)
    elif isinstance(content, str):
        content = content.encode("ascii")
    return bytes.fromhex(name) + struct.pack(">Q", len(content) | 1 << 56) + content


def _head(width: int, height: int, frame_seconds: float, seconds: float) -> bytes:
    """Return all that stands before the first frame, in bytes of one length, whatever the numbers are."""
    # The name of the kind first: FFmpeg is given only what has it near its beginning.
    kind = [("4282", "matroska"), ("4286", 1), ("42F7", 1), ("42F2", 4)]
    kind += [("42F3", 8), ("4287", 4), ("4285", 2)]
    info = [("2AD7B1", 1_000_000_000 // _TICKS), ("4D80", _MARK), ("5741", _MARK)]
    info += [("4489", float(seconds * _TICKS))]
    video = _element("B0", width) + _element("BA", height)
    track = [("D7", 1), ("73C5", 1), ("83", 1), ("9C", 0), ("86", "V_MJPEG")]
    track += [("23E383", round(1e9 * frame_seconds)), ("E0", video)]

    def holding(name: str, parts: list) -> bytes:
        return _element(name, b"".join(_element(*part) for part in parts))

    endless = bytes.fromhex("18538067") + b"\x01" + b"\xff" * 7
    return (
        holding("1A45DFA3", kind)
        + endless
        + holding("1549A966", info)
        + _element("1654AE6B", holding("AE", track))
    )


class ClipWriter:
    """Writes the frames of one recording."""

    def __init__(self, path: str | os.PathLike[str], fps: float) -> None:
        """Begin a file that does not exist yet. `fps`: the frames per second that it names while it is not
        closed. Raises OutputError where that fails."""
        self.path = Path(path)
        self.frames = 0
        """Number of the frames written so far that can be read again"""
        self.failed = False
        """True once a frame could not be written"""
        self._fps = fps
        self._size: tuple[int, int] | None = None
        self._times = array("d")
        """Seconds at which each frame was taken, by the clock of its source"""
        self._places = array("q")
        """Place in the file, in bytes, at which the time of each frame stands"""
        self._other_shape = False
        """True once the user was told of a frame of another shape than the first one's"""
        try:
            self._file = open(self.path, "xb", buffering=0)  # noqa: SIM115 (until it is closed)
        except OSError as error:
            raise OutputError(
                f"{shown(str(self.path))}: cannot be recorded to ({why(error)}); choose another file"
            ) from error

    def write(self, rgb: np.ndarray, time: float) -> None:
        """Add a frame (H, W, 3) uint8 RGB, taken at `time` in seconds of any clock; one of another size than
        the first is scaled to fit into it. Nothing happens once the file is closed. Raises OutputError where
        the frame cannot be written, or the last one was long ago, and closes the file: what was written
        before is kept."""
        import cv2

        if self._file.closed:
            return
        width, height = rgb.shape[1::-1]
        if self._size is None:
            self._size = width, height
        began, last = (self._times[0], self._times[-1]) if self._times else (time, time)
        if time - last > _LONGEST_BREAK:
            raise self._ended(f"no picture came for {time - last:.0f} seconds", "record what follows anew")
        if max(*self._size) > _LARGEST_SIDE:
            reason = f"pictures of {width}x{height} pixels are larger than a JPEG may be"
            raise self._ended(reason, f"have at most {_LARGEST_SIDE} pixels a side")
        if (width, height) != self._size:
            rgb = self._fitted(rgb)
        bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
        jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
        head = b"" if self.frames else _head(*self._size, 1.0 / self._fps, 0.0)
        cluster = _element("E7", round((time - began) * _TICKS)) + _element("A3", b"\x81\0\0\x80" + jpeg)
        end = self._file.tell()
        try:
            self._put(head + _element("1F43B675", cluster))
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.truncate(end)
            raise self._ended(why(error), "free some space, or record elsewhere") from error
        self.frames += 1
        self._times.append(time)
        self._places.append(end + len(head) + _TO_TIME)
        if not self.path.exists():  # Linux and macOS write on into a file that is in no folder any more
            self.frames = 0
            raise self._ended("the file was deleted or moved meanwhile", "leave its folder, and record anew")

    def _ended(self, reason: str, remedy: str) -> OutputError:
        """Close the file, since no frame can be written any more; return the error to raise."""
        self.failed = True
        self.close()
        kept = f" after {self.frames} frames, which are kept" if self.frames else ""
        return OutputError(f"{shown(str(self.path))}: the recording ended{kept} ({reason}); {remedy}")

    def _fitted(self, rgb: np.ndarray) -> np.ndarray:
        """Return a frame (H, W, 3) in the middle of a black one of the first frame's size, as large as
        fits."""
        import cv2

        assert self._size is not None
        (width, height), (has, high) = self._size, rgb.shape[1::-1]
        scale = min(width / has, height / high)
        size = max(1, round(has * scale)), max(1, round(high * scale))
        left, top = (width - size[0]) // 2, (height - size[1]) // 2
        if max(width - size[0], height - size[1]) > 1 and not self._other_shape:
            self._other_shape = True
            log.warning(
                "%s: pictures of %dx%d follow those of %dx%d; they are recorded smaller, within black edges, "
                "and their hands lie farther away",
                *(shown(str(self.path)), has, high, width, height),
            )
        whole = np.zeros((height, width, 3), dtype=np.uint8)
        inside = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
        whole[top : top + size[1], left : left + size[0]] = inside
        return whole

    def _put(self, data: bytes) -> None:
        """Write all bytes, which a full disk takes in parts."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]

    @property
    def seconds(self) -> float:
        """Seconds from the recording's first to its last frame."""
        return self._times[-1] - self._times[0] if self._times else 0.0

    @property
    def fps(self) -> float:
        """Whole frames per second of the recording where nothing breaks it."""
        steps = np.diff(self._times)
        times = np.cumsum(steps[steps < MEDIA.break_seconds])
        apart = min(_STEPS, len(times) // 2)
        usual = float(np.median(times[apart:] - times[:-apart])) / apart if apart else 0.0
        return max(1.0, round(1.0 / usual)) if usual > 0.0 else self._fps

    def close(self) -> None:
        """Write the rate, the length and even times, and close the file; an empty one is removed. Where the
        disk is gone, the rate that was named first stays."""
        if self._file.closed:
            return
        with contextlib.suppress(OSError), self._file:
            if self._times and self._size is not None:
                self._file.seek(0)
                fps = self.fps
                self._put(_head(*self._size, 1.0 / fps, self.seconds + 1.0 / fps))
                for place, time in zip(self._places, self._times, strict=True):
                    self._file.seek(place)
                    number = round((time - self._times[0]) * fps)
                    self._put(struct.pack(">Q", round(number / fps * _TICKS)))
        if not self.frames:
            self.path.unlink(missing_ok=True)
