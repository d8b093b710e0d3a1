"""The take: everything that one capture found, and its file format.

A take is what passes from the core to Blender, to disk and to other tools. The file is a plain
NumPy `.npz` without pickles; docs/take-format.md describes it for readers of other languages.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from handfit_core.camera import Intrinsics
from handfit_core.errors import OptionError, OutputError, TakeError
from handfit_core.files import written_whole
from handfit_core.keypoints import HandDetection
from handfit_core.skeleton import SIDES, Side, other_side

FORMAT_NAME = "handfit-take"
FORMAT_VERSION = 1

SourceKind = Literal["photo", "sequence", "video"]

_TRACK_ARRAYS: dict[str, tuple[int, ...]] = {
    "global_orient": (3,),
    "hand_pose": (45,),
    "transl": (3,),
    "joints_3d": (21, 3),
    "keypoints_2d": (21, 2),
    "reprojection_error": (),
    "score": (),
}
"""Per-frame float arrays of a track and their shapes behind T."""

_OF_MODEL = ("global_orient", "hand_pose", "transl", "joints_3d")
"""Those that filled frames have too"""

_TRACK_FLAGS = ("filled", "doubtful", "other_side")
"""Per-frame bool arrays that a take may lack"""

_OF_DETECTOR: dict[str, tuple[int, ...]] = {
    "keypoints_depth": (21,),
    "world_landmarks": (21, 3),
    "right_side": (),
}
"""Per-frame float arrays that a take may lack: what is needed to fit again without the pictures"""


@dataclass(frozen=True)
class Source:
    """Where the pictures came from."""

    kind: SourceKind
    files: tuple[str, ...]
    """Absolute paths: the photo, the video, or every picture of the sequence that was read"""
    orientation: int = 1
    """EXIF orientation (1-8) that was undone on reading; pixels in a take are of the upright picture"""

    @property
    def name(self) -> str:
        """A short name for people: the file's stem, or for a sequence the part before the number."""
        stem = Path(self.files[0]).stem
        if self.kind != "sequence":
            return stem
        return stem.rstrip("0123456789").rstrip("._- ") or Path(self.files[0]).parent.name


@dataclass(frozen=True, eq=False)
class HandTrack:
    """One hand over a take's T frames.

    Float arrays hold NaN in the frames where neither `detected` nor `filled` is True; what the detector found
    (`keypoints_2d`, `reprojection_error`, `score`, `keypoints_depth`, `world_landmarks`, `right_side`) also
    where only `filled` is.

    Model parameters are MANO's: axis-angle in radians relative to the flat hand (hands_mean is not
    added), root rotation about the wrist joint, camera frame (x right, y down, z forward), metres.
    """

    side: Side
    betas: np.ndarray
    """(10,) one shape for the whole take"""
    global_orient: np.ndarray
    """(T, 3) radians"""
    hand_pose: np.ndarray
    """(T, 45) radians"""
    transl: np.ndarray
    """(T, 3) metres; the wrist lies at the shaped model's wrist + transl"""
    joints_3d: np.ndarray
    """(T, 21, 3) metres, the fitted model's keypoints in MediaPipe's order"""
    keypoints_2d: np.ndarray
    """(T, 21, 2) pixels, as detected"""
    reprojection_error: np.ndarray
    """(T,) pixels: mean distance from the projected joints_3d to keypoints_2d"""
    detected: np.ndarray
    """(T,) bool"""
    score: np.ndarray
    """(T,) the detector's confidence in this hand, 0..1"""
    filled: np.ndarray | None = None
    """(T,) bool: frames of short gaps, bridged from their neighbours; None: there are none"""
    doubtful: np.ndarray | None = None
    """(T,) bool: frames whose pose may well be wrong; None: nobody looked"""
    keypoints_depth: np.ndarray | None = None
    """(T, 21) pixels: depth of keypoints_2d towards the scene, relative to the wrist, as detected; None: not
    kept"""
    world_landmarks: np.ndarray | None = None
    """(T, 21, 3) metres about the hand's centre, axes as the camera frame's, as detected; None: not kept"""
    right_side: np.ndarray | None = None
    """(T,) probability that the detector named the true side; NaN where it was not judged; None: nowhere"""
    other_side: np.ndarray | None = None
    """(T,) bool: frames in which the detector named the other side; None: in none"""

    @property
    def refinable(self) -> bool:
        """Whether the take holds what fitting again needs."""
        return self.keypoints_depth is not None and self.world_landmarks is not None

    def detection(self, row: int) -> HandDetection | None:
        """What the detector found in frame `row` of the T; None where it found nothing. Without the spread of
        its looks, which a take does not hold. Raises TakeError unless `refinable`."""
        if self.keypoints_depth is None or self.world_landmarks is None:
            raise TakeError(
                f"the {self.side} hand's take was made before takes held what the detector found; capture it "
                "again"
            )
        if not self.detected[row]:
            return None
        named = self.side
        if self.other_side is not None and self.other_side[row]:
            named = other_side(self.side)
        judged = np.nan if self.right_side is None else float(self.right_side[row])
        return HandDetection(
            side=named,
            score=float(self.score[row]),
            keypoints=np.column_stack([self.keypoints_2d[row], self.keypoints_depth[row]]),
            world=np.array(self.world_landmarks[row]),
            right_side=None if np.isnan(judged) else judged,
        )

    @property
    def present(self) -> np.ndarray:
        """(T,) bool: frames with a hand, detected or filled."""
        seen = np.asarray(self.detected, dtype=bool)
        return seen if self.filled is None else seen | np.asarray(self.filled, dtype=bool)


@dataclass(frozen=True, eq=False)
class Take:
    """What one capture found: T frames and the hands in them."""

    source: Source
    fps: float
    """Frames per second of the source; 24 for photos and sequences, which have none of their own"""
    frame_numbers: np.ndarray
    """(T,) int, increasing. Videos and photos count from 1; sequences use the numbers in their names"""
    width: int
    """pixels, of the upright picture"""
    height: int
    intrinsics: Intrinsics
    solver: str
    model: str
    """`open-hand`, or the absolute path of the user's model file or folder"""
    model_digests: Mapping[str, str]
    """side -> HandModel.digest of the model that was fitted"""
    hands: tuple[HandTrack, ...]

    def __post_init__(self) -> None:
        if np.ndim(self.frame_numbers) != 1:
            raise TakeError("frame_numbers must be a list of numbers")
        count = len(self.frame_numbers)
        if count == 0 or np.any(np.diff(self.frame_numbers) <= 0):
            raise TakeError("a take needs at least one frame, and its frame numbers must increase")
        if not self.source.files:
            raise TakeError("a take must name the pictures that it was made from")
        if not (np.isfinite(self.fps) and self.fps > 0 and self.width > 0 and self.height > 0):
            raise TakeError(
                f"frame rate and size must be positive; got {self.fps} fps, {self.width}x{self.height} pixels"
            )
        for track in self.hands:
            if track.side not in SIDES:
                raise TakeError(f"a hand's side must be left or right, not {track.side!r}")
            if np.shape(track.betas) != (10,) or np.shape(track.detected) != (count,):
                raise TakeError(f"the {track.side} hand's betas or detected have the wrong shape")
            for name in _TRACK_FLAGS:
                flags = getattr(track, name)
                if flags is not None and np.shape(flags) != (count,):
                    raise TakeError(f"the {track.side} hand's {name} has the wrong shape")
            for name, shape in (_TRACK_ARRAYS | _OF_DETECTOR).items():
                if getattr(track, name) is None and name in _OF_DETECTOR:
                    continue
                found = np.shape(getattr(track, name))
                if found != (count, *shape):
                    raise TakeError(
                        f"the {track.side} hand's {name} has shape {found}, expected {(count, *shape)}"
                    )
                frames = track.present if name in _OF_MODEL else np.asarray(track.detected, dtype=bool)
                seen = np.asarray(getattr(track, name))[frames]
                if name == "right_side":
                    if np.any((seen < 0.0) | (seen > 1.0)):
                        raise TakeError(f"the {track.side} hand's right_side must lie between 0 and 1")
                elif not np.all(np.isfinite(seen)):
                    raise TakeError(f"the {track.side} hand's {name} is not finite in a frame with a hand")

    def save(self, path: str | os.PathLike[str], *, compact: bool = False) -> Path:
        """Write the take as `.npz`, whole or not at all; `compact` as in `to_bytes`. Raises OutputError."""
        path = Path(path)
        data = self.to_bytes(compact=compact)
        with written_whole(path) as beside:
            beside.write_bytes(data)
        return path

    def to_bytes(self, compact: bool = True) -> bytes:
        """The take as the bytes of its file. `compact`: numbers of 32 bits, half the size: pixels and
        metres are then rounded in their seventh digit."""
        number = np.float32 if compact else np.float64
        header = {
            "format": FORMAT_NAME,
            "version": FORMAT_VERSION,
            "source": {
                "kind": self.source.kind,
                "files": list(self.source.files),
                "orientation": self.source.orientation,
            },
            "fps": self.fps,
            "width": self.width,
            "height": self.height,
            "intrinsics": vars(self.intrinsics),
            "solver": self.solver,
            "model": self.model,
            "model_digests": dict(self.model_digests),
            "sides": [track.side for track in self.hands],
        }
        arrays: dict[str, Any] = {
            "header": np.array(json.dumps(header, ensure_ascii=False)),
            "frame_numbers": np.asarray(self.frame_numbers, dtype=np.int64),
        }
        for i, track in enumerate(self.hands):
            arrays[f"hand{i}_betas"] = np.asarray(track.betas, dtype=number)
            arrays[f"hand{i}_detected"] = np.asarray(track.detected, dtype=bool)
            for name in _TRACK_FLAGS:
                flags = getattr(track, name)
                if flags is not None:
                    arrays[f"hand{i}_{name}"] = np.asarray(flags, dtype=bool)
            for name in _TRACK_ARRAYS | _OF_DETECTOR:
                array = getattr(track, name)
                if array is not None:
                    arrays[f"hand{i}_{name}"] = np.asarray(array, dtype=number)
        stream = io.BytesIO()
        np.savez_compressed(stream, **arrays)
        return stream.getvalue()

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Take:
        """Read a take. Raises TakeError for anything that is not a take this version understands."""
        path = Path(path)
        if not path.is_file():
            raise TakeError(f"{path}: there is no such take file")
        try:
            data = path.read_bytes()
        except OSError as error:
            raise TakeError(f"{path}: the take file cannot be read ({error.strerror})") from error
        return cls.from_bytes(data, where=str(path))

    @classmethod
    def from_bytes(cls, data: bytes, where: str = "the take") -> Take:
        """The inverse of `to_bytes`, compact or not: numbers come back with 64 bits. `where` begins the
        messages. Raises TakeError for anything that is not a take this version understands."""
        steps = cls.reading(data, where)
        while True:
            try:
                next(steps)
            except StopIteration as stop:
                return stop.value

    @classmethod
    def reading(cls, data: bytes, where: str = "the take") -> Generator[None, None, Take]:
        """`from_bytes` array by array, for programs that must not stand still: each step takes some
        milliseconds, even in takes of ten thousand frames. Returns the take."""
        arrays: dict[str, np.ndarray] = {}
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as archive:
                for name in archive.files:
                    arrays[name] = _wide(archive[name])
                    yield
            header = json.loads(str(arrays["header"][()]))
            if header["format"] != FORMAT_NAME:
                raise KeyError("format")
            version = int(header["version"])
        except Exception as error:  # a damaged zip can fail in any way
            raise TakeError(
                f"{where}: not a take file, or a damaged one; capture it again, or pick the .npz that a "
                "capture wrote"
            ) from error
        if version > FORMAT_VERSION:
            raise TakeError(
                f"{where}: this take has format version {version}, this program reads up to "
                f"{FORMAT_VERSION}; update the add-on"
            )
        try:
            return cls(
                source=Source(
                    kind=header["source"]["kind"],
                    files=tuple(header["source"]["files"]),
                    orientation=int(header["source"]["orientation"]),
                ),
                fps=float(header["fps"]),
                frame_numbers=arrays["frame_numbers"],
                width=int(header["width"]),
                height=int(header["height"]),
                intrinsics=Intrinsics(**header["intrinsics"]),
                solver=header["solver"],
                model=header["model"],
                model_digests=header["model_digests"],
                hands=tuple(
                    HandTrack(side=side, **_fields(arrays, f"hand{i}_"))
                    for i, side in enumerate(header["sides"])
                ),
            )
        except (KeyError, TypeError, ValueError, AttributeError, OptionError, TakeError) as error:
            raise TakeError(f"{where}: the take file is incomplete ({error}); capture it again") from error


def _fields(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, Any]:
    """A hand's arrays by the names of HandTrack's fields. Raises KeyError for one that must be there."""
    needed = ("betas", "detected", *_TRACK_ARRAYS)
    return {name: arrays[prefix + name] for name in needed} | {
        name: arrays.get(prefix + name) for name in (*_TRACK_FLAGS, *_OF_DETECTOR)
    }


def _wide(array: np.ndarray) -> np.ndarray:
    """Floats of any size as float64; anything else as it is."""
    return array.astype(np.float64, copy=False) if array.dtype.kind == "f" else array


__all__ = ["FORMAT_VERSION", "HandTrack", "OutputError", "Source", "SourceKind", "Take"]
