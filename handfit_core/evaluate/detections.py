"""Detections of a data set's pictures, cached by the pictures' content.

All methods of an evaluation see the same detections, and a second evaluation, of other solvers or
after an interruption, does not detect again. A cached detection is found by the bytes of the pictures,
the detector's settings and model, and the detector's code: change one and the hands are detected again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import joblib
import numpy as np

from handfit_core import detect, media
from handfit_core.capturing.detection import detect_frames, open_detector
from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import InputError
from handfit_core.detect.correction.network import FILE as NETWORK_FILE
from handfit_core.detect.detector import DETECTORS, Detector
from handfit_core.detect.keypoints import Detections
from handfit_core.evaluate.cache import cached, code_digest, versions
from handfit_core.evaluate.labels import Entry, Unit
from handfit_core.media.pictures import read_picture
from handfit_core.media.source import Frame, Media, Source

UNREADABLE = (0, 0)


@dataclass(frozen=True, eq=False)
class UnitDetections:
    """The hands that were detected in the T pictures of a unit."""

    hands: Detections
    """The hands that were detected in all T pictures"""
    sizes: np.ndarray
    """(T, 2) int: width and height of each picture in pixels; UNREADABLE where it could not be read"""

    @property
    def readable(self) -> np.ndarray:
        """(T,) bool: True for pictures that could be read"""
        return np.asarray((self.sizes > 0).all(axis=-1))


class UnitDetector:
    """The detector of hands in units, which reads them from the cache where it can. Use it as a context
    manager."""

    def __init__(self, options: CaptureOptions) -> None:
        self._options = options
        self.fingerprint = DETECTORS.get(options.detector).fingerprint(options.detector_settings())
        self._made_with = (
            *(options.detector, self.fingerprint, options.max_hands, options.threshold),
            *(options.plain_detection, options.quality, versions("opencv-python-headless")),
            code_digest(detect, media, NETWORK_FILE),
        )
        self._find = cached(_find, "detections", ignore=("unit", "detector", "on_picture"))
        self._stills: Detector | None = None

    def __enter__(self) -> UnitDetector:
        return self

    def __exit__(self, *_: object) -> None:
        if self._stills is not None:
            self._stills.close()

    def detect(self, unit: Unit, on_picture: Callable[[], None]) -> UnitDetections:
        """Return the hands in a unit's pictures, from the cache if possible; calls `on_picture` for each
        picture."""
        times = [entry.time for entry in unit.entries if unit.is_clip]
        key = joblib.hash((self._made_with, unit.is_clip, times, [_content(e.picture) for e in unit.entries]))
        if self._find.check_call_in_cache(key, unit, self, on_picture):
            for _ in unit.entries:
                on_picture()
        return self._find(key, unit, self, on_picture)

    def found_in(self, unit: Unit, on_picture: Callable[[], None]) -> UnitDetections:
        """Detect the hands in a unit's pictures now, without the cache; calls `on_picture` for each
        picture."""
        if unit.is_clip:
            clip = _UnitMedia(unit, on_picture)
            hands = detect_frames(clip, self._options).hands
            return UnitDetections(hands, np.array(clip.sizes))
        if self._stills is None:
            self._stills = open_detector(self._options)
        (entry,) = unit.entries
        rgb, size = _read(entry)
        hands = Detections.of([self._stills.find(rgb, entry.time)])
        on_picture()
        return UnitDetections(hands, np.array([size]))


def _find(
    key: str,  # noqa: ARG001 (identifies the result in the cache)
    unit: Unit,
    detector: UnitDetector,
    on_picture: Callable[[], None],
) -> UnitDetections:
    return detector.found_in(unit, on_picture)


def _content(picture: Path) -> str:
    try:
        return hashlib.sha256(picture.read_bytes()).hexdigest()
    except OSError:
        return "unreadable"


class _UnitMedia(Media):
    """A unit's pictures as a clip that a detector can read."""

    def __init__(self, unit: Unit, on_picture: Callable[[], None]) -> None:
        self._entries, self._on_picture = unit.entries, on_picture
        self.expected_frames = len(unit.entries)
        self.sizes: list[tuple[int, int]] = []
        self.source = Source("sequence", tuple(str(entry.picture) for entry in unit.entries))

    def numbers(self, first: int = 0, count: int | None = None) -> range:
        """Return the indices of the unit's pictures from `first` on, at most `count` of them, counted from
        0."""
        return range(len(self._entries))[first:][:count]

    def frames(self, first: int = 0, count: int | None = None, step: int = 1) -> Iterator[Frame]:
        """Yield every `step`-th frame of `count` pictures from `first` on; one that cannot be read has None
        as its picture."""
        for row in self.numbers(first, count)[::step]:
            rgb, size = _read(self._entries[row])
            if row == len(self.sizes):  # some are read once more
                self.sizes.append(size)
                self._on_picture()
            yield Frame(row, self._entries[row].time, rgb)


def _read(entry: Entry) -> tuple[np.ndarray | None, tuple[int, int]]:
    """Return a picture, (H, W, 3) uint8 RGB, and its (width, height) in pixels; None for one that cannot be
    read."""
    try:
        rgb, _ = read_picture(entry.picture, as_stored=True)
    except InputError:
        return None, UNREADABLE
    return rgb, (rgb.shape[1], rgb.shape[0])
