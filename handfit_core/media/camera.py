"""Live sources: cameras, network cameras and phones by address, and files played at their own speed.

A thread reads; one slot keeps the newest frame, which is decoded once somebody takes it, so that whoever is
slower than the source loses frames and never lags behind. A recording has a thread of its own, and gets all.
"""

from __future__ import annotations

import contextlib
import io
import ipaddress
import math
import os
import queue
import re
import sys
import threading
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final, Self
from urllib.parse import urlsplit

import numpy as np

from handfit_core.common.errors import InputError, OptionError
from handfit_core.common.files import shown
from handfit_core.media.camera_names import SYSTEM_CAMERAS, cameras
from handfit_core.media.headers import Header, read_picture_header
from handfit_core.media.opening import open_media
from handfit_core.media.recording import ClipWriter
from handfit_core.media.source import Frame


@dataclass(frozen=True)
class CameraSettings:
    """Time-outs of live sources, in seconds, and what cameras are asked for."""

    answer_seconds: float = 2.0
    """Seconds within which an address must answer, and send its next picture; after them somebody is told"""
    retry_seconds: float = 0.5
    """Seconds between two attempts to open a source that was lost"""
    close_seconds: float = 5.0
    """Seconds that the reading thread gets to end: as long as a system may wait for a picture, and some
    more"""
    max_pixels: int = 4096 * 2304
    """Most pixels of one picture; larger ones are refused, since no hand could be followed in them in time"""


CAMERA: Final = CameraSettings()
_SCHEMES: Final = ("http", "https", "rtsp")
_WAITING: Final = 32
"""Most pictures that may wait to be written; at 1080 lines they have 200 MB at most"""

Say = Callable[[str], None]
"""Function that takes a sentence about what is wrong with a source at the moment; an empty one where nothing
is"""


@dataclass(frozen=True)
class LiveSource:
    """What somebody named as a live source; exactly one of the fields is set."""

    camera: int | None = None
    address: str | None = None
    """Address of a network camera: http, https (MJPEG) or rtsp"""
    file: str | None = None

    @classmethod
    def parse(cls, text: str, *, online: bool = False, names: Path = SYSTEM_CAMERAS) -> Self:
        """Read a camera's number or name, an address, or `file:CLIP`.

        `online`: addresses of other machines may be opened. `names`: the folder where Linux lists its
        cameras. Raises OptionError for a text that is none of these, and for an address of another machine.
        """
        text = text.strip()
        if text.startswith("file:"):
            return cls(file=text.removeprefix("file:"))
        if text.isdecimal() and len(text) < 4:
            return cls(camera=int(text))
        if re.match(r"[\w+.-]+://", text):
            return cls(address=_checked(text, online=online))
        known = cameras(names)
        exact = [number for number, name in known if name.casefold() == text.casefold()]
        found = exact or [number for number, name in known if text and text.casefold() in name.casefold()]
        if found:
            return cls(camera=found[0])
        listed = ", ".join(f"{number} ({name})" for number, name in known) or "by number, as in 0"
        raise OptionError(
            f"{shown(text)!r} is no live source: name a camera ({listed}), an address such as "
            "http://192.168.0.7:8080/video, or file:CLIP to play a file"
        )

    def __str__(self) -> str:
        if self.camera is not None:
            return f"camera {self.camera}"
        return shown(self.address or self.file or "")


def _checked(address: str, *, online: bool) -> str:
    """Return an address that may be opened. Raises OptionError for any other."""
    try:
        parts = urlsplit(address)
        host, _ = parts.hostname, parts.port
    except ValueError:
        host = parts = None
    if parts is None or not host or parts.scheme not in _SCHEMES or not address.isascii():
        raise OptionError(
            f"{shown(address)}: addresses of cameras begin with http://, https:// or rtsp:// and the name of "
            "a machine, as in http://192.168.0.7:8080/video"
        )
    if not online and not _is_here(host):
        raise OptionError(
            f"{shown(address)}: {host} is another machine, and nothing may be opened over the network: allow "
            "it (--online; in Blender Preferences > System > Allow Online Access)"
        )
    return parts.scheme + address[len(parts.scheme) :]  # FFmpeg knows schemes in small letters only


def _is_here(host: str) -> bool:
    """Return True if a host's name is this machine's, without asking a network."""
    if host.casefold() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


Decode = Callable[[], np.ndarray | None]
"""Function that decodes a picture to (H, W, 3) uint8 RGB; it returns None where the picture is damaged"""


@dataclass(eq=False)
class LivePicture:
    """A picture of a live source that is decoded only once it is wanted."""

    number: int
    """Number of the picture, counted from 1 over all that came"""
    time: float
    """Time in seconds of `time.perf_counter` when the picture came"""
    decode: Decode

    @cached_property
    def rgb(self) -> np.ndarray | None:
        """The picture (H, W, 3) uint8 RGB; None for a damaged one."""
        return self.decode()


class Recorder:
    """Writes one recording in a thread of its own, since encoding takes longer than some sources have."""

    def __init__(self, path: str | os.PathLike[str], fps: float, say: Callable[[str], None]) -> None:
        """Begin a recording at `path`; `say` is told, in a sentence, why nothing can be written any more.
        Raises OutputError where the file cannot be begun."""
        self.writer = ClipWriter(path, fps)
        self._say = say
        self._waiting: queue.Queue[LivePicture | None] = queue.Queue(_WAITING)
        self._thread = threading.Thread(target=self._write, name="handfit-record", daemon=True)
        self._thread.start()

    def put(self, picture: LivePicture) -> None:
        """Write a picture soon; where too many wait, it is left out."""
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(picture)

    def close(self) -> ClipWriter:
        """Write the pictures that still wait, and close the file."""
        self._waiting.put(None)
        self._thread.join()
        self.writer.close()
        return self.writer

    def _write(self) -> None:
        while (picture := self._waiting.get()) is not None:
            try:
                if picture.rgb is not None:
                    self.writer.write(picture.rgb, picture.time)
            except Exception as error:  # whoever closes it waits for this thread
                self._say(str(error))


class LiveReader:
    """Reads a live source in a thread of its own, from entering the context to leaving it.

    A camera that cannot be opened at first ends it; one that is lost later, and an address that does not
    answer, are tried again until it is closed.
    """

    def __init__(
        self,
        source: LiveSource,
        size: tuple[int, int] = (640, 480),
        fps: float = 30.0,
        *,
        loop: bool = False,
    ) -> None:
        """Prepare to read a source. `size` in pixels and `fps` (frames per second) are what a camera is asked
        for; with `loop` a file begins again at its end."""
        self._source, self._size, self._fps, self._loop = source, size, fps, loop
        self._changed = threading.Condition()
        self._stop = threading.Event()
        self._newest: LivePicture | None = None
        self._recorder: Recorder | None = None
        self._error: Exception | None = None
        self._ended = False
        self.received = 0
        """Number of pictures that came"""
        self.dropped = 0
        """Number of pictures that nobody took before the next one came"""
        self.problem = ""
        """What is wrong with the source at the moment, as a sentence; empty where nothing is"""
        self._thread = threading.Thread(target=self._read, name="handfit-live", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(CAMERA.close_seconds)
        self.stop_recording()

    def newest(self, wait: float = 0.0) -> Frame | None:
        """Take the newest frame: its number counts the pictures that came, its time is in seconds of
        `time.perf_counter`. Waits up to `wait` seconds for a frame; returns None where none came, or a
        damaged one. Raises the HandfitError that ended the source."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._ended, wait)
            picture, self._newest = self._newest, None
        if picture is None:
            if self._error is not None:
                raise self._error
            return None
        return None if picture.rgb is None else Frame(picture.number, picture.time, picture.rgb)

    @property
    def ended(self) -> bool:
        """True if no frame will come any more, and the last one was taken; where an error is the reason,
        `newest` raises it."""
        return self._ended and self._newest is None and self._error is None

    @property
    def recording(self) -> ClipWriter | None:
        """The recording to which the frames are written; None where there is none."""
        return self._recorder.writer if self._recorder is not None else None

    def record(self, path: str | os.PathLike[str]) -> None:
        """Write every frame that comes from now on to a file. Raises OutputError where it cannot be begun."""
        recorder = Recorder(path, self._fps, self._say)
        self.stop_recording()
        self._recorder = recorder

    def stop_recording(self) -> ClipWriter | None:
        """Close the recording's file; return what was written to it, None where there is no recording."""
        recorder, self._recorder = self._recorder, None
        return recorder.close() if recorder is not None else None

    def _read(self) -> None:
        source, stop = self._source, self._stop
        try:
            with contextlib.closing(
                _captured(source, self._size, self._fps, stop, self._say)
                if source.file is None
                else _played(source.file, stop, loop=self._loop)
            ) as pictures:
                for decode in pictures:
                    self._put(decode)
        except Exception as error:  # whoever takes the next frame gets it
            self._error = error
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _say(self, problem: str) -> None:
        self.problem = problem

    def _put(self, decode: Decode) -> None:
        with self._changed:
            self.received += 1
            self.dropped += self._newest is not None
            self._newest = picture = LivePicture(self.received, time.perf_counter(), decode)
            self._changed.notify_all()
        if (recorder := self._recorder) is not None:
            recorder.put(picture)


def _played(file: str, stop: threading.Event, *, loop: bool) -> Generator[Decode, None, None]:
    """Yield a function that decodes each picture of a file, at the picture's time, until `stop`; with `loop`
    again and again. Raises InputError where the file cannot be read."""
    with contextlib.closing(open_media(file)) as media:
        while not stop.is_set():
            began: float | None = None
            for frame in media.frames():
                now = time.perf_counter()
                began = now if began is None else began
                if stop.wait(max(0.0, began + frame.time - now)):
                    return
                yield partial(getattr, frame, "rgb")
            if not loop or began is None or stop.wait(1.0 / media.fps):
                return


def _captured(
    source: LiveSource, size: tuple[int, int], fps: float, stop: threading.Event, say: Say
) -> Generator[Decode, None, None]:
    """Yield a function that decodes each picture of a camera or an address, until `stop`. Raises InputError
    for a camera that cannot be opened at first."""
    first = True
    while not stop.is_set():
        with contextlib.closing(_opened(source, size, fps, stop)) as pictures:
            found = False
            for decode in pictures:
                if not found:
                    say("")
                found, first = True, False
                yield decode
        if stop.is_set():
            return
        if source.camera is not None and first:
            raise InputError(_why_no_camera(source.camera))
        say(
            f"{source} sends no pictures any more; trying again until it is stopped"
            if not first
            else f"{source} does not answer within {CAMERA.answer_seconds:g} seconds, or sends no pictures "
            "that can be read; trying again until it is stopped"
        )
        stop.wait(CAMERA.retry_seconds)


def _opened(
    source: LiveSource, size: tuple[int, int], fps: float, stop: threading.Event
) -> Generator[Decode, None, None]:
    """Yield functions that decode the pictures of a source from opening it until it ends, fails or is to
    stop; none where it cannot be opened."""
    # OpenCV reads it when it loads; its own value is 10 seconds.
    os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", f"{math.ceil(CAMERA.answer_seconds)}")
    # Or OpenCV on macOS, which asks for permission on the main thread alone, opens nothing; the system asks.
    os.environ.setdefault("OPENCV_AVFOUNDATION_SKIP_AUTH", "1")
    import cv2

    if source.camera is not None:
        capture = _opened_camera(cv2, source.camera, size, fps)
    else:
        capture = _opened_address(cv2, source.address or "")
    good = time.monotonic()
    try:
        while capture.isOpened() and not stop.is_set():
            found, bgr = capture.read()
            if not found or bgr is None:
                return
            encoded = len(bgr) == 1
            header = read_picture_header(io.BytesIO(bgr.tobytes())) if encoded else Header(*bgr.shape[1::-1])
            if header is not None:
                if header.width * header.height > CAMERA.max_pixels:
                    raise InputError(
                        f"{source}: gives pictures of {header.width}x{header.height} pixels, which are too "
                        "large to follow hands in as they come; choose a smaller size"
                    )
                good = time.monotonic()
                yield partial(_decoded, bgr, encoded=encoded)
            elif time.monotonic() > good + CAMERA.answer_seconds:
                return  # it sends something else
    finally:
        capture.release()


def _opened_camera(cv2: Any, number: int, size: tuple[int, int], fps: float) -> Any:
    capture = cv2.VideoCapture(number)
    if capture.isOpened():
        # Uncompressed, most cameras give 30 pictures a second at their smallest sizes only.
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        capture.set(cv2.CAP_PROP_FPS, fps)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    return capture


def _decoded(data: np.ndarray, *, encoded: bool) -> np.ndarray | None:
    """Return the picture (H, W, 3) uint8 RGB of an encoded JPEG (1, N) or of BGR pixels; None for a damaged
    one."""
    import cv2

    try:
        bgr = cv2.imdecode(data, cv2.IMREAD_COLOR) if encoded else data
    except cv2.error:
        return None
    return None if bgr is None else cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


def _opened_address(cv2: Any, address: str) -> Any:
    over_http = address.startswith("http")
    # Over HTTP nothing but MJPEG is read: FFmpeg would follow a playlist to other addresses.
    special = {"input_format": "mpjpeg"} if over_http else {"rtsp_transport": "tcp"}
    options = {**special, "fflags": "nobuffer"}
    name, milliseconds = "OPENCV_FFMPEG_CAPTURE_OPTIONS", round(1000.0 * CAMERA.answer_seconds)
    before = os.environ.get(name)
    os.environ[name] = "|".join(f"{key};{value}" for key, value in options.items())
    try:
        limits = [
            *(cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, milliseconds, cv2.CAP_PROP_READ_TIMEOUT_MSEC, milliseconds),
            *(cv2.CAP_PROP_N_THREADS, 1),  # several would each hold a picture back
        ]
        if over_http:
            # Pictures as they come, since OpenCV 4.11 decodes one of another size wrongly.
            limits += [cv2.CAP_PROP_FORMAT, -1]
        return cv2.VideoCapture(address, cv2.CAP_FFMPEG, limits)
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def _why_no_camera(number: int) -> str:
    """Return what keeps the camera of that number from being opened, and what to do, as text for people."""
    listed = ", ".join(f"{n} ({name})" for n, name in cameras())
    if sys.platform == "darwin":
        return (
            f"camera {number} cannot be opened: if there is one, allow Blender, or the terminal, to use it "
            "in System Settings > Privacy & Security > Camera"
        )
    device = Path(f"/dev/video{number}")
    if sys.platform.startswith("linux"):
        if not device.exists():
            return f"there is no camera {number}: " + (f"choose from {listed}" if listed else "plug one in")
        if not os.access(device, os.R_OK | os.W_OK):
            return f"{device} may not be used: add yourself to the group 'video', and log in again"
    return f"camera {number} gives no pictures: close other programs that use it, or choose another one"
