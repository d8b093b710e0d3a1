"""Detections of a data set's pictures, made once and kept by the pictures' content.

All methods of an evaluation see the same detections, and a second evaluation, of other solvers or
after an interruption, does not detect again. A kept detection is found by the bytes of the pictures,
the detector's settings and model, and the detector's code: change one and it is made anew.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from handfit_core import detect, media
from handfit_core.arrays import declared, kept_arrays
from handfit_core.detect.correction.network import FILE as NETWORK_FILE
from handfit_core.detect.detector import DETECTORS, Detector
from handfit_core.detect.keypoints import Detections, HandDetection
from handfit_core.detect.opening import open_detector, settings_of
from handfit_core.detection import detect_frames
from handfit_core.errors import InputError
from handfit_core.evaluate.kept import code_digest, load_kept, save_kept
from handfit_core.evaluate.labels import Entry, Unit
from handfit_core.files import cache_dir
from handfit_core.media.pictures import read_picture
from handfit_core.media.source import Frame, Media, Source
from handfit_core.options import CaptureOptions

UNREADABLE = (0, 0)


@dataclass(frozen=True, eq=False)
class UnitDetections:
    """What was found in the T pictures of a unit."""

    hands: Detections
    """Of all pictures"""
    sizes: np.ndarray
    """(T, 2) int: width and height in pixels; UNREADABLE where the picture could not be read"""
    milliseconds: np.ndarray
    """(T,) spent in the detector"""

    @property
    def readable(self) -> np.ndarray:
        """(T,) bool"""
        return np.asarray((self.sizes > 0).all(axis=-1))


class UnitDetector:
    """Finds the hands of units. Use as a context manager."""

    def __init__(self, options: CaptureOptions, folder: Path | None = None) -> None:
        self._options = options
        self._folder = folder or cache_dir() / "detections"
        self.fingerprint = DETECTORS.get(options.detector).fingerprint(settings_of(options))
        self._made_with = "|".join(
            (
                options.detector,
                self.fingerprint,
                hashlib.sha256(NETWORK_FILE.read_bytes()).hexdigest(),
                str(options.max_hands),
                repr(options.threshold),
                str(options.plain_detection),
                options.quality,
                version("opencv-python-headless"),
                code_digest(detect, media),
            )
        )
        self._stills: Detector | None = None

    def __enter__(self) -> UnitDetector:
        return self

    def __exit__(self, *_: object) -> None:
        if self._stills is not None:
            self._stills.close()
            self._stills = None

    def detect(self, unit: Unit, on_picture: Callable[[], None]) -> UnitDetections:
        """The hands in a unit's pictures, kept or fresh; calls `on_picture` once for each picture."""
        path = self._folder / f"{self._key(unit)}.npz"
        kept = load_kept(path)
        if kept is None:
            found = self._fresh(unit, on_picture)
            save_kept(path, _to_arrays(found))
            return found
        for _ in unit.entries:
            on_picture()
        return _from_arrays(kept)

    def _key(self, unit: Unit) -> str:
        sha = hashlib.sha256(f"{self._made_with}|{unit.is_clip}".encode())
        for entry in unit.entries:
            try:
                sha.update(hashlib.sha256(entry.picture.read_bytes()).digest())
            except OSError:
                sha.update(b"unreadable")
            if unit.is_clip:
                sha.update(repr(entry.time).encode())
        return sha.hexdigest()[:32]

    def _fresh(self, unit: Unit, on_picture: Callable[[], None]) -> UnitDetections:
        if not unit.is_clip:
            if self._stills is None:
                self._stills = open_detector(self._options)
            return _detected(unit, self._stills, on_picture)
        clip = _Clip(unit, on_picture)
        started = time.perf_counter()
        found = detect_frames(clip, self._options)
        each = 1000 * (time.perf_counter() - started) / len(unit.entries)
        return UnitDetections(found.hands, np.array(clip.sizes), np.full(len(unit.entries), each))


def _detected(unit: Unit, finder: Detector, on_picture: Callable[[], None]) -> UnitDetections:
    frames: list[tuple[HandDetection, ...]] = []
    sizes, spent = [], []
    for entry in unit.entries:
        rgb, size = _read(entry)
        started = time.perf_counter()
        frames.append(finder.find(rgb, entry.time))
        sizes.append(size)
        spent.append(1000 * (time.perf_counter() - started))
        on_picture()
    return UnitDetections(Detections.of(frames), np.array(sizes), np.array(spent))


class _Clip(Media):
    """A unit's pictures as one clip."""

    def __init__(self, unit: Unit, on_picture: Callable[[], None]) -> None:
        self._entries, self._on_picture = unit.entries, on_picture
        self.expected_frames = len(unit.entries)
        self.sizes: list[tuple[int, int]] = []
        self.source = Source("sequence", tuple(str(entry.picture) for entry in unit.entries))

    def numbers(self, first: int = 0, count: int | None = None) -> range:
        """As `Media.numbers`: the pictures are counted."""
        return range(len(self._entries))[first:][:count]

    def frames(self, first: int = 0, count: int | None = None) -> Iterator[Frame]:
        """As `Media.frames`."""
        for row in self.numbers(first, count):
            rgb, size = _read(self._entries[row])
            if row == len(self.sizes):  # some are read once more
                self.sizes.append(size)
                self._on_picture()
            yield Frame(row, self._entries[row].time, rgb)


def _read(entry: Entry) -> tuple[np.ndarray | None, tuple[int, int]]:
    """A picture, (H, W, 3) uint8 RGB, and its size."""
    try:
        rgb, _ = read_picture(entry.picture, as_stored=True)
    except InputError:
        return None, UNREADABLE
    return rgb, (rgb.shape[1], rgb.shape[0])


def _to_arrays(found: UnitDetections) -> dict[str, np.ndarray]:
    return {"sizes": found.sizes, "milliseconds": found.milliseconds, **kept_arrays(found.hands)}


def _from_arrays(arrays: dict[str, np.ndarray]) -> UnitDetections:
    columns = {name: arrays[name] for name in declared(Detections) if name in arrays}
    return UnitDetections(Detections(**columns), arrays["sizes"], arrays["milliseconds"])
