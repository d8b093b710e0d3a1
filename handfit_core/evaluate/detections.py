"""Detections of a data set's pictures, made once and kept by the pictures' content.

All methods of an evaluation see the same detections, and a second evaluation, of other solvers or
after an interruption, does not detect again. A kept detection is found by the bytes of the pictures,
the detector's settings and model, and the detector's code: change one and it is made anew.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core import detect, media
from handfit_core.detect.correction.network import FILE as NETWORK_FILE
from handfit_core.detect.detector import DETECTORS, Detector
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.opening import open_detector, settings_of
from handfit_core.errors import InputError
from handfit_core.evaluate.kept import code_digest, load_kept, save_kept
from handfit_core.evaluate.labels import Unit
from handfit_core.files import cache_dir
from handfit_core.media.pictures import read_picture
from handfit_core.options import CaptureOptions
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES

UNREADABLE = (0, 0)


@dataclass(frozen=True, eq=False)
class UnitDetections:
    """What was found in the T pictures of a unit."""

    frames: tuple[tuple[HandDetection, ...], ...]
    """(T)"""
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
        with open_detector(self._options, video=True) as of_this_clip:
            return _detected(unit, of_this_clip, on_picture)


def _detected(unit: Unit, finder: Detector, on_picture: Callable[[], None]) -> UnitDetections:
    frames: list[tuple[HandDetection, ...]] = []
    sizes, spent = [], []
    for entry in unit.entries:
        rgb, size = None, UNREADABLE
        try:
            rgb, _ = read_picture(entry.picture, as_stored=True)
            size = (rgb.shape[1], rgb.shape[0])
        except InputError:
            pass
        started = time.perf_counter()
        frames.append(finder.find(rgb, entry.time))
        sizes.append(size)
        spent.append(1000 * (time.perf_counter() - started))
        on_picture()
    if unit.is_clip:  # stills share a finder, which nothing completes
        frames = finder.completed(frames)
    return UnitDetections(tuple(frames), np.array(sizes), np.array(spent))


_ARRAYS = {
    "scores": ("score", ()),
    "right_side": ("right_side", ()),
    "keypoints": ("keypoints", (NUM_KEYPOINTS, 3)),
    "world": ("world", (NUM_KEYPOINTS, 3)),
    "spread": ("spread", (NUM_KEYPOINTS, 3)),
}
"""In the file -> field of `HandDetection` and its shape; NaN in the file is None"""


def _to_arrays(found: UnitDetections) -> dict[str, np.ndarray]:
    hands = [hand for frame in found.frames for hand in frame]

    def column(field: str, shape: tuple[int, ...]) -> np.ndarray:
        values = [getattr(hand, field) for hand in hands]
        nothing = np.full(shape, np.nan)
        return np.array([nothing if v is None else v for v in values], dtype=float).reshape(-1, *shape)

    return {
        "sizes": found.sizes,
        "milliseconds": found.milliseconds,
        "counts": np.array([len(frame) for frame in found.frames]),
        "sides": np.array([SIDES.index(hand.side) for hand in hands], dtype=np.int64),
        **{name: column(*what) for name, what in _ARRAYS.items()},
    }


def _from_arrays(arrays: dict[str, np.ndarray]) -> UnitDetections:
    hands = []
    for i, side in enumerate(arrays["sides"]):
        known: dict[str, Any] = {}
        for name, (field, shape) in _ARRAYS.items():
            if np.isfinite(value := arrays[name][i]).all():
                known[field] = value if shape else float(value)
        hands.append(HandDetection(SIDES[side], **known))
    ends = np.cumsum(arrays["counts"])
    frames = tuple(tuple(hands[end - n : end]) for n, end in zip(arrays["counts"], ends, strict=True))
    return UnitDetections(frames, arrays["sizes"], arrays["milliseconds"])
