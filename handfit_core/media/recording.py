"""Recordings of live sources: a Matroska file of JPEGs with the time of each.

Each frame is a cluster of its own, written when it comes: whatever ends the program or fills the disk, the
frames before can be read. When it is closed, times move to the nearest frame of a constant rate, that of
the steps between breaks in whole frames per second: jitter goes, and a break stays as long as it was.
"""

from __future__ import annotations

import contextlib
import os
import struct
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.errors import OutputError
from handfit_core.common.files import shown, why

_MARK: Final = "Manient live recording"
_TICKS: Final = 10_000
"""a second"""
_TO_TIME: Final = 9
"""bytes from the beginning of a cluster to its time"""
_QUALITY: Final = 95
"""JPEG's"""


def _element(name: str, content: bytes | int | str | float) -> bytes:
    """An EBML element: its id in hexadecimal, eight bytes of length, the content."""
    if isinstance(content, float):
        content = struct.pack(">d", content)
    elif isinstance(content, int):
        content = struct.pack(">Q", content)
    elif isinstance(content, str):
        content = content.encode("ascii")
    return bytes.fromhex(name) + struct.pack(">Q", len(content) | 1 << 56) + content


def _head(width: int, height: int, frame_seconds: float, frames: int) -> bytes:
    """All that stands before the first frame; of one length, whatever the numbers are."""
    # The name of the kind first: FFmpeg is given only what has it near its beginning.
    kind = [("4282", "matroska"), ("4286", 1), ("42F7", 1), ("42F2", 4)]
    kind += [("42F3", 8), ("4287", 4), ("4285", 2)]
    length = float(frames * frame_seconds * _TICKS)
    info = [("2AD7B1", 1_000_000_000 // _TICKS), ("4D80", _MARK), ("5741", _MARK), ("4489", length)]
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
        """Begin a file that does not exist yet. `fps`: the rate that it names while it is not closed. Raises
        OutputError."""
        self.path = Path(path)
        self.frames = 0
        self.seconds = 0.0
        """From its first to its last frame"""
        self.failed = False
        """Whether a frame could not be written"""
        self._fps = fps
        self._size: tuple[int, int] | None = None
        self._began = 0.0
        self._times: list[tuple[int, float]] = []
        """Where in the file the time of each frame stands, and the time"""
        try:
            self._file = open(self.path, "xb", buffering=0)  # noqa: SIM115 (until it is closed)
        except OSError as error:
            raise OutputError(
                f"{shown(str(self.path))}: cannot be recorded to ({why(error)}); choose another file"
            ) from error

    def write(self, rgb: np.ndarray, time: float) -> None:
        """Add a frame (H, W, 3) uint8 RGB, in seconds of any clock; one of another size than the first is
        scaled to it. Nothing happens once it is closed. Raises OutputError where it cannot be written, and
        closes the file: what was written before is kept."""
        import cv2

        if self._file.closed:
            return
        if self._size is None:
            self._size, self._began = (rgb.shape[1], rgb.shape[0]), time
        if rgb.shape[1::-1] != self._size:
            rgb = cv2.resize(rgb, self._size, interpolation=cv2.INTER_AREA)
        bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
        jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
        since = time - self._began
        head = b"" if self.frames else _head(*self._size, 1.0 / self._fps, 0)
        cluster = _element("E7", round(since * _TICKS)) + _element("A3", b"\x81\0\0\x80" + jpeg)
        whole = head + _element("1F43B675", cluster)
        end = self._file.tell()
        try:
            self._put(whole)
        except OSError as error:
            self.failed = True
            with contextlib.suppress(OSError):
                self._file.truncate(end)
            self.close()
            raise OutputError(
                f"{shown(str(self.path))}: the recording ended after {self.frames} frames, which are kept "
                f"({why(error)}); free some space, or record elsewhere"
            ) from error
        self._times.append((end + len(whole) - len(cluster) + _TO_TIME, since))
        self.frames, self.seconds = self.frames + 1, since

    def _put(self, data: bytes) -> None:
        """Write all of it, which a full disk takes in parts."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]

    @property
    def fps(self) -> float:
        """The usual rate of its frames, in whole frames per second."""
        steps = np.diff([since for _, since in self._times])
        usual = (
            float(steps[steps < 2.0 * np.median(steps)].mean()) if len(steps) and np.all(steps > 0) else 0.0
        )
        return max(1.0, round(1.0 / usual)) if usual > 0.0 else self._fps

    def close(self) -> None:
        """Write the rate, the length and even times, and close it; an empty file is removed. Where the disk
        is gone, the rate that was named first stays."""
        if self._file.closed:
            return
        with contextlib.suppress(OSError), self._file:
            if self.frames and self._size is not None:
                self._file.seek(0)
                fps = self.fps
                self._put(_head(*self._size, 1.0 / fps, 1 + round(self.seconds * fps)))
                for place, since in self._times:
                    self._file.seek(place)
                    self._put(struct.pack(">Q", round(round(since * fps) / fps * _TICKS)))
        if not self.frames:
            self.path.unlink(missing_ok=True)
