"""The take: everything that one capture found, and its file format.

A take is what passes from the core to Blender, to disk and to other tools. The file is a plain
NumPy `.npz` without pickles; docs/take-format.md describes it for readers of other languages.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from handfit_core.camera import Intrinsics
from handfit_core.errors import OptionError, OutputError, TakeError
from handfit_core.files import written_whole
from handfit_core.skeleton import SIDES, Side

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

_TRACK_FLAGS = ("filled", "doubtful")
"""Per-frame bool arrays that a take may lack"""


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

    Float arrays hold NaN in the frames where neither `detected` nor `filled` is True; `keypoints_2d`,
    `reprojection_error` and `score` also where only `filled` is.

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
            for name, shape in _TRACK_ARRAYS.items():
                found = np.shape(getattr(track, name))
                if found != (count, *shape):
                    raise TakeError(
                        f"the {track.side} hand's {name} has shape {found}, expected {(count, *shape)}"
                    )
                frames = track.present if name in _OF_MODEL else np.asarray(track.detected, dtype=bool)
                seen = np.asarray(getattr(track, name))[frames]
                if not np.all(np.isfinite(seen)):
                    raise TakeError(f"the {track.side} hand's {name} is not finite in a frame with a hand")

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the take as `.npz`, whole or not at all. Raises OutputError."""
        path = Path(path)
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
            arrays[f"hand{i}_betas"] = np.asarray(track.betas, dtype=np.float64)
            arrays[f"hand{i}_detected"] = np.asarray(track.detected, dtype=bool)
            for name in _TRACK_FLAGS:
                flags = getattr(track, name)
                if flags is not None:
                    arrays[f"hand{i}_{name}"] = np.asarray(flags, dtype=bool)
            for name in _TRACK_ARRAYS:
                arrays[f"hand{i}_{name}"] = np.asarray(getattr(track, name), dtype=np.float64)
        with written_whole(path) as beside, open(beside, "wb") as stream:
            np.savez_compressed(stream, **arrays)
        return path

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Take:
        """Read a take. Raises TakeError for anything that is not a take this version understands."""
        path = Path(path)
        if not path.is_file():
            raise TakeError(f"{path}: there is no such take file")
        try:
            # Opened here, because NumPy leaves a damaged file open.
            with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            header = json.loads(str(arrays["header"][()]))
            if header["format"] != FORMAT_NAME:
                raise KeyError("format")
            version = int(header["version"])
        except Exception as error:  # a damaged zip can fail in any way
            raise TakeError(
                f"{path}: not a take file, or a damaged one; capture it again, or pick the .npz that a "
                "capture wrote"
            ) from error
        if version > FORMAT_VERSION:
            raise TakeError(
                f"{path}: this take has format version {version}, this program reads up to "
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
                    HandTrack(
                        side=side,
                        betas=arrays[f"hand{i}_betas"],
                        detected=arrays[f"hand{i}_detected"],
                        **{name: arrays[f"hand{i}_{name}"] for name in _TRACK_ARRAYS},
                        filled=arrays.get(f"hand{i}_filled"),
                        doubtful=arrays.get(f"hand{i}_doubtful"),
                    )
                    for i, side in enumerate(header["sides"])
                ),
            )
        except (KeyError, TypeError, ValueError, AttributeError, OptionError, TakeError) as error:
            raise TakeError(f"{path}: the take file is incomplete ({error}); capture it again") from error


__all__ = ["FORMAT_VERSION", "HandTrack", "OutputError", "Source", "SourceKind", "Take"]
