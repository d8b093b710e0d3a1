"""Videos: their frames, one after another."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from handfit_core.errors import InputError
from handfit_core.files import shown
from handfit_core.media.size_limit import check_frame_size, check_video, not_a_video
from handfit_core.media.source import DEFAULT_FPS, Frame, Media, Source, Wanted

log = logging.getLogger("handfit")

MAX_FPS: Final = 1000.0


def _frame_count(path: Path, claimed: float) -> int:
    """How many frames a video has by its header; 0 where that does not tell, or tells of more than the file
    has bytes."""
    return int(claimed) if 0 < claimed <= path.stat().st_size else 0


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
            # What the decoder says: the container may have told another size.
            width, height = (capture.get(p) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
            check_frame_size(path, int(width), int(height), wanted.max_megapixels)
            found, first = capture.read() if capture.isOpened() else (False, None)
            if not found or first is None:
                raise InputError(not_a_video(path))
            fps = float(capture.get(cv2.CAP_PROP_FPS))
            count = _frame_count(path, capture.get(cv2.CAP_PROP_FRAME_COUNT))
        finally:
            capture.release()
        if not math.isfinite(fps) or not 0.0 < fps <= MAX_FPS:
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
        self.source = Source(kind="video", files=(str(path.resolve()),))

    def frames(self) -> Iterator[Frame]:
        """Yield the frames in order; a video that breaks off is told in a warning."""
        import cv2

        capture = cv2.VideoCapture(self._name)
        number = 0
        try:
            while not self._range.is_past(number + 1) and capture.grab():
                number += 1
                if number not in self._range:
                    continue
                ok, bgr = capture.retrieve()
                rgb = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB) if ok else None
                yield Frame(number, (number - 1) / self.fps, rgb)
        finally:
            capture.release()
        stopped_early = number + 1 < self._count and not self._range.is_past(number + 1)
        if stopped_early:
            log.warning(
                "%s: the video breaks off after frame %d of %d; the rest is missing",
                self._path,
                number,
                self._count,
            )
