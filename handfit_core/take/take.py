"""The take: everything that one capture found, and its file format.

A take is what passes from the core to Blender, to disk and to other tools. The file is a plain
NumPy `.npz` without pickles; docs/take-format.md describes it for readers of other languages.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from handfit_core.common.arrays import (
    array,
    array_dataclass,
    arrays_of,
    check_arrays,
    kept_arrays,
    reading_arrays,
)
from handfit_core.common.batch import scatter
from handfit_core.common.errors import NoHandFoundError, OptionError, TakeError
from handfit_core.common.files import opened_file, output_path, read_file, shown, why, written_whole
from handfit_core.common.npz import NotNpz, NpzArchive, names_of
from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, Side, can_touch
from handfit_core.common.slices import run_to_completion
from handfit_core.common.values import LARGEST_WHOLE, listed, number, one_of, path, shortly, text, whole
from handfit_core.detect.keypoints import Detections
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import HandMotion
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.source import SOURCE_KINDS, Source
from handfit_core.take.found import FoundRows
from handfit_core.take.views import AGREEMENTS, Cameras, SeenHand, Verdict, View

FORMAT_NAME = "handfit-take"
FORMAT_VERSION = 1


@dataclass(frozen=True)
class TakeLimits:
    """What a take may hold, so that reading a file can fill neither the memory nor a scene."""

    max_file_bytes: int = 1 << 31
    """Most bytes of a take's file; 10 000 frames of two hands have 20 MB"""
    max_memory_bytes: int = 400_000_000
    """Most bytes that the arrays of a small take may have: 200 000 frames of a hand that is hardly ever
    seen"""
    max_packed: int = 50
    """How many times the size of its file the arrays of a larger take may have"""
    max_error: float = 1e30
    """Largest error in pixels: a fit that failed close to the camera may project anywhere that 32 bits can
    hold"""
    min_fps: float = 1e-3
    max_fps: float = 1e6
    max_side: int = 1 << 24
    """Most pixels along a side of a picture"""
    max_hands: int = 200
    """Most hands of a take"""


TAKE_LIMITS: Final = TakeLimits()


@array_dataclass
class HandTrack(HandMotion):
    """One hand over a take's T frames: its motion, and what was detected.

    Float arrays but `placed` and `touches` hold NaN in the frames where neither `detected` nor `filled` is
    True; `reprojection_error` and `expected_error` also where only `filled` is.
    """

    joints_3d: np.ndarray = array("T", NUM_KEYPOINTS, 3, finite="present")
    """(T, 21, 3) metres in the camera frame: the fitted model's keypoints in MediaPipe's order"""
    reprojection_error: np.ndarray = array("T", finite="detected", most=TAKE_LIMITS.max_error)
    """(T,) pixels: mean distance from the projected joints_3d to the detected keypoints"""
    detections: Detections
    """What the detector found, at most one in a frame: the columns that `FoundRows` has. Depth and world
    landmarks are NaN in old takes"""
    filled: np.ndarray | None = array("T", kind="b", default=None)
    """(T,) bool: True for frames of short gaps, bridged from their neighbours; None: there are none"""
    placed: np.ndarray | None = array("T", NUM_KEYPOINTS, 2, default=None)
    """(T, 21, 2) pixels where a person has put points; NaN for points that nobody has put; None: there are
    none"""
    touches: np.ndarray | None = array("T", NUM_KEYPOINTS, default=None)
    """(T, 21) the number of the keypoint that each one touches, as a person says, the larger naming the
    smaller; 0 stands for the palm; NaN: it touches none; None: there are no touches"""
    arm: ArmMotion | None = None
    """The arm that the hand hangs on; None: there is none, or nobody looked"""
    no_arm: str = ""
    """Sentence that says why no arm was found; empty: there is one, or nobody looked"""
    seen_by: tuple[SeenHand | None, ...] = ()
    """What each further view of the take saw of the hand; None for a view that saw nothing"""

    def __post_init__(self) -> None:
        if self.arm is not None and not np.any(self.arm.present):
            object.__setattr__(self, "arm", None)  # frozen; an arm without a row is none

    def check(self, count: int) -> None:
        """Raise TakeError unless this is a hand over `count` frames: every array of its shape and kind, and
        finite where there is a hand."""
        check_arrays(self, TakeError, f"the {self.side} hand's ", T=count)
        if self.arm is not None:
            check_arrays(self.arm, TakeError, f"the {self.side} arm's ", T=count)
        for seen in filter(None, self.seen_by):
            check_arrays(seen, TakeError, f"the {self.side} hand in a further view: ")
        rows, judged = self.detections.frame, self.detections.right_side
        if np.any(np.diff(rows) <= 0) or np.any((rows < 0) | (rows >= count)):
            raise TakeError(f"the {self.side} hand must be detected once in a frame, in their order")
        if np.any((judged < 0.0) | (judged > 1.0)):
            raise TakeError(f"the {self.side} hand's right_side must lie between 0 and 1")
        if self.touches is not None:
            for row, point in np.argwhere(~np.isnan(self.touches)).tolist():
                other = float(self.touches[row, point])
                if not (other.is_integer() and can_touch(point, int(other))):
                    raise TakeError(
                        f"the {self.side} hand's touches must name smaller points of other fingers"
                    )

    @classmethod
    def undetected(cls, motion: HandMotion, model: HandModel) -> HandTrack:
        """A hand of which nothing was detected, such as one that a person has added: its frames count as
        filled."""
        present = motion.present
        count = len(present)
        joints = model.keypoints(motion.betas, *(rows[present] for rows in motion.pose))
        return cls(
            **vars(motion),
            joints_3d=scatter(joints, present, count),
            reprojection_error=np.full(count, np.nan),
            detections=Detections.of([[]]),
            filled=present,
        )

    @cached_property
    def rows(self) -> FoundRows:
        """The `detections` as arrays over the T frames."""
        return FoundRows.of(self.detections, self.side, len(self.transl))

    @property
    def detected(self) -> np.ndarray:
        """(T,) bool: True for the frames in which the hand was detected."""
        return self.rows.detected

    @property
    def keypoints_2d(self) -> np.ndarray:
        """(T, 21, 2) pixels of the detected keypoints; NaN in frames without a detection."""
        return self.rows.keypoints_2d

    @property
    def score(self) -> np.ndarray:
        """(T,) the detector's confidence in this hand, 0..1; NaN where it was not detected."""
        return self.rows.score

    @property
    def added(self) -> bool:
        """True if a person laid the hand into the picture: nothing of it was ever detected."""
        return self.placed is not None and not len(self.detections)

    @property
    def refinable(self) -> bool:
        """True if the take holds all that fitting the hand again needs."""
        return self.rows.world_landmarks is not None

    def detections_at(self, rows: np.ndarray) -> Detections:
        """Return what the detector found in the frames `rows` (K,) of the T, which count as 0 to K - 1 in the
        result. Raises TakeError unless `refinable`."""
        if not self.refinable:
            raise TakeError(
                f"the {self.side} hand's take was made before takes held what the detector found; capture it "
                "again"
            )
        return self.detections.at_frames(rows)

    @property
    def present(self) -> np.ndarray:
        """(T,) bool: True for frames with a hand, detected or filled."""
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
    """Width of the upright picture in pixels, as `height` is its height"""
    height: int
    intrinsics: Intrinsics
    solver: str
    model: str
    """`open-hand`, or the absolute path of the user's model file or folder"""
    model_digests: Mapping[str, str]
    """The `HandModel.digest` of the model that was fitted, by side"""
    hands: tuple[HandTrack, ...]
    program: str = ""
    """The program that found the hands, as people call it; empty: a detector of this one"""
    cameras: Cameras | None = None
    """Places of the cameras that filmed several views of the hands; None: there is one view"""
    verdict: Verdict | None = None
    """How well the given views belong together; None: only one was given"""
    distortion: tuple[float, float, float, float, float] | None = None
    """Distortion of the measured lens, as `Lens` has it, which is in the pictures and taken out of all that
    was found in them; None: none is known"""

    def __post_init__(self) -> None:
        numbers = np.asarray(self.frame_numbers)
        if numbers.ndim != 1 or numbers.dtype.kind not in "iu":
            raise TakeError("frame_numbers must be a list of whole numbers")
        count = len(numbers)
        if count == 0 or np.any(numbers[1:] <= numbers[:-1]):
            raise TakeError("a take needs at least one frame, and its frame numbers must increase")
        if not -LARGEST_WHOLE < int(numbers[0]) <= int(numbers[-1]) < LARGEST_WHOLE:
            raise TakeError("frame_numbers lie beyond what any frame is counted by")
        if not self.source.files:
            raise TakeError("a take must name the pictures that it was made from")
        sizes = (self.width, self.height)
        if not (
            TAKE_LIMITS.min_fps <= self.fps <= TAKE_LIMITS.max_fps
            and all(0 < side <= TAKE_LIMITS.max_side for side in sizes)
        ):
            raise TakeError(
                f"frame rate and size must be positive and not absurd; got {self.fps:g} fps, "
                f"{self.width}x{self.height} pixels"
            )
        if len(self.hands) > TAKE_LIMITS.max_hands:
            raise TakeError(f"a take holds at most {TAKE_LIMITS.max_hands} hands, not {len(self.hands)}")
        for track in self.hands:
            track.check(count)
        if self.cameras is not None:
            check_arrays(self.cameras, TakeError, "cameras: ", V=1 + len(self.cameras.views))

    @property
    def lens(self) -> Lens | None:
        """The measured lens of the pictures; None where they count as free of distortion."""
        if self.distortion is None:
            return None
        return Lens(self.intrinsics, self.distortion, self.width, self.height)

    def view(self, number: int) -> Take:
        """The clip of a further view, counted from 1, and its camera, as a take without hands. Its first
        frame lies `cameras.time_offset[number]` seconds after this one's. Raises TakeError where it cannot be
        a clip."""
        assert self.cameras is not None
        view = self.cameras.views[number - 1]
        return replace(
            self,
            source=view.source,
            fps=view.fps,
            frame_numbers=view.frame_numbers,
            width=view.width,
            height=view.height,
            intrinsics=Intrinsics(*self.cameras.intrinsics[number].tolist()),
            hands=(),
            cameras=None,
            verdict=None,
            distortion=None,
        )

    def save(self, path: str | os.PathLike[str], *, compact: bool = False) -> Path:
        """Write the take as `.npz`, whole or not at all, and never over what it was made from; `compact` as
        in `to_bytes`. Raises OutputError."""
        path = output_path(path, self.source.files)
        with written_whole(path, Take.load) as beside, beside.open("wb") as stream:
            self._write(stream, compact)
        return path

    def to_bytes(self, compact: bool = True) -> bytes:
        """Return the take as the bytes of its file. `compact`: numbers of 32 bits, half the size: pixels and
        metres are then rounded in their seventh digit."""
        stream = io.BytesIO()
        self._write(stream, compact)
        return stream.getvalue()

    def _write(self, stream: BinaryIO, compact: bool) -> None:
        header = {
            "format": FORMAT_NAME,
            "version": FORMAT_VERSION,
            "source": _plain_source(self.source),
            "fps": self.fps,
            "width": self.width,
            "height": self.height,
            "intrinsics": vars(self.intrinsics),
            "solver": self.solver,
            "model": self.model,
            "model_digests": dict(self.model_digests),
            "sides": [track.side for track in self.hands],
        }
        if self.distortion is not None:
            header["distortion"] = list(self.distortion)
        if self.program:
            header["program"] = self.program
        if self.verdict is not None:
            header["verdict"] = vars(self.verdict)
        if self.cameras is not None:
            header["views"] = [
                {
                    "source": _plain_source(view.source),
                    **{name: getattr(view, name) for name in ("fps", "width", "height", "mirrored")},
                }
                for view in self.cameras.views
            ]
        asked = [i for i, track in enumerate(self.hands) if track.arm is not None or track.no_arm]
        if asked:
            header["arms"] = {str(i): self.hands[i].no_arm for i in asked}
        arrays: dict[str, Any] = {
            "header": np.array(json.dumps(header, ensure_ascii=False)),
            "frame_numbers": np.asarray(self.frame_numbers, dtype=np.int64),
        }
        floats = np.float32 if compact else np.float64
        if self.cameras is not None:
            arrays |= kept_arrays(self.cameras, "cameras/", floats)
            for v, view in enumerate(self.cameras.views, start=1):
                arrays[f"cameras/view{v}_frame_numbers"] = np.asarray(view.frame_numbers, dtype=np.int64)
                if view.times is not None:
                    arrays[f"cameras/view{v}_times"] = np.asarray(view.times, dtype=np.float64)
        for i, track in enumerate(self.hands):
            arrays |= kept_arrays(track, f"hand{i}_", floats) | kept_arrays(track.rows, f"hand{i}_", floats)
            if track.arm is not None:
                arrays |= kept_arrays(track.arm, f"arms/hand{i}_", floats)
            for v, seen in enumerate(track.seen_by, start=1):
                if seen is not None:
                    prefix = f"cameras/view{v}_hand{i}_"
                    arrays |= kept_arrays(seen, prefix, floats) | kept_arrays(seen.rows, prefix, floats)
        np.savez_compressed(stream, **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Take:
        """Read a take. Raises TakeError for anything that is not a take this version understands."""
        path = Path(path)
        try:
            data = read_file(path, TAKE_LIMITS.max_file_bytes)
        except FileNotFoundError as error:
            raise TakeError(f"{shown(path)}: there is no such take file") from error
        except (OSError, ValueError) as error:
            raise TakeError(f"{shown(path)}: the take file cannot be read ({why(error)})") from error
        return cls.from_bytes(data, where=str(path))

    @classmethod
    def from_bytes(cls, data: bytes, where: str = "the take") -> Take:
        """Read a take from the bytes of `to_bytes`, compact or not: numbers come back with 64 bits. `where`
        begins the messages. Raises TakeError for anything that is not a take this version understands."""
        return run_to_completion(cls.reading(data, where))

    @classmethod
    def reading(cls, data: bytes, where: str = "the take") -> Generator[None, None, Take]:
        """`from_bytes` array by array, for programs that must not stand still: each step takes some
        milliseconds, even in takes of ten thousand frames. Returns the take."""
        try:
            archive = NpzArchive(data, max(TAKE_LIMITS.max_memory_bytes, TAKE_LIMITS.max_packed * len(data)))
            header = archive.header()
            if header.get("format") != FORMAT_NAME:
                raise NotNpz("is of another format")
            version = whole("version", header.get("version"), 1)
        except (NotNpz, KeyError, ValueError) as error:
            raise TakeError(
                f"{where}: not a take file, or a damaged one; capture it again, or pick the .npz that a "
                "capture wrote"
            ) from error
        if version > FORMAT_VERSION:
            raise TakeError(
                f"{where}: this take has format version {version}, this program reads up to "
                f"{FORMAT_VERSION}; update the add-on"
            )
        yield
        try:
            fields = _of_header(header)
            hands = []
            no_arms, views = fields.pop("arms"), fields.pop("views")
            fields["cameras"] = yield from _reading_cameras(archive, views)
            for i, side in enumerate(fields.pop("sides")):
                arrays = yield from reading_arrays(HandTrack, archive, f"hand{i}_")
                detections = yield from _reading_found(archive, f"hand{i}_", side)
                arm, why = None, no_arms.get(str(i))
                if why == "":
                    of_arm = yield from reading_arrays(ArmMotion, archive, f"arms/hand{i}_")
                    arm = ArmMotion(**of_arm)
                seen_by = yield from _reading_seen(archive, i, side, len(views))
                rest = {"arm": arm, "no_arm": why or "", "seen_by": seen_by}
                hands.append(HandTrack(side=side, detections=detections, **arrays, **rest))
            return cls(frame_numbers=archive.array("frame_numbers", "iu"), hands=tuple(hands), **fields)
        except KeyError as error:
            raise TakeError(
                f"{where}: the take file is incomplete (it lacks {error}); capture it again"
            ) from error
        except (NotNpz, ValueError, OptionError, TakeError) as error:
            reason = f"it {error}" if isinstance(error, NotNpz) else error
            raise TakeError(f"{where}: the take file is damaged ({reason}); capture it again") from error


def _reading_cameras(
    archive: NpzArchive, views: Sequence[dict[str, Any]]
) -> Generator[None, None, Cameras | None]:
    if not views:
        return None
    arrays = yield from reading_arrays(Cameras, archive, "cameras/")
    further = []
    for v, view in enumerate(views, start=1):
        numbers, times = archive.array(f"cameras/view{v}_frame_numbers", "iu"), f"cameras/view{v}_times"
        told = archive.array(times, "f") if times in archive else None
        if told is not None and (told.shape != numbers.shape or not np.all(np.diff(told) > 0.0)):
            raise TakeError(f"{times} must have a time for each frame of the view, and increase")
        further.append(View(frame_numbers=numbers, times=told, **view))
    return Cameras(**arrays, views=tuple(further))


def _reading_found(archive: NpzArchive, prefix: str, side: Side) -> Generator[None, None, Detections]:
    arrays = yield from reading_arrays(FoundRows, archive, prefix)
    rows = FoundRows(**arrays)
    check_arrays(rows, TakeError, f"the {side} hand's ")
    return rows.detections(side)


def _reading_seen(
    archive: NpzArchive, hand: int, side: Side, views: int
) -> Generator[None, None, tuple[SeenHand | None, ...]]:
    found: list[SeenHand | None] = []
    for v in range(1, 1 + views):
        prefix = f"cameras/view{v}_hand{hand}_"
        if f"{prefix}detected" not in archive:
            found.append(None)
            continue
        arrays = yield from reading_arrays(SeenHand, archive, prefix)
        detections = yield from _reading_found(archive, prefix, side)
        found.append(SeenHand(detections=detections, **arrays))
    return tuple(found)


def chosen(take: Take, hands: str, frames: FrameRange | None, max_hands: int | None) -> Take:
    """Return a take with its hands of one side ('left' or 'right'; else of both) in frames of these numbers,
    as many hands as are wanted, the surest first: those that were seen in most frames, and there with most
    certainty. Raises OptionError where it has no such frame, NoHandFoundError where no hand is left of those
    that it has."""
    numbers = np.asarray(take.frame_numbers)
    rows = np.flatnonzero([frames is None or int(number) in frames for number in numbers])
    if not len(rows):
        raise OptionError(f"none of the take's frames lies in {frames}; it has {numbers[0]} to {numbers[-1]}")
    kept = [at_rows(hand, rows) for hand in take.hands if hands not in SIDES or hand.side == hands]
    kept = [hand for hand in kept if hand.present.any()]
    if take.hands and not kept:
        raise NoHandFoundError(
            f"the take has no {f'{hands} ' if hands in SIDES else ''}hand in these frames; it has a "
            f"{', a '.join(hand.side for hand in take.hands)} one in frames {numbers[0]} to {numbers[-1]}"
        )
    surest = sorted(kept, key=lambda hand: -float(np.nansum(hand.score)))[:max_hands]
    source = take.source
    if source.kind == "sequence" and len(source.files) == len(numbers):
        source = replace(source, files=tuple(source.files[row] for row in rows))
    kept = [hand for hand in kept if any(hand is each for each in surest)]
    cameras = take.cameras
    if cameras is not None:
        # Offsets count from the first frame, which may be another one now.
        later = np.where(
            np.arange(len(cameras.time_offset)) > 0, (numbers[rows[0]] - numbers[0]) / take.fps, 0.0
        )
        cameras = replace(cameras, time_offset=cameras.time_offset - later)
    return replace(take, source=source, frame_numbers=numbers[rows], hands=tuple(kept), cameras=cameras)


def at_rows(hand: HandTrack, rows: np.ndarray) -> HandTrack:
    """Return a hand over some of its frames, in any order, by their rows."""
    arm = None if hand.arm is None else replace(hand.arm, **_at_rows(hand.arm, rows))
    return replace(hand, arm=arm, detections=hand.detections.at_frames(rows), **_at_rows(hand, rows))


def _at_rows(of: HandTrack | ArmMotion, rows: np.ndarray) -> dict[str, np.ndarray]:
    return {name: np.asarray(array)[rows] for name, array in arrays_of(of, "T").items()}


def _plain_source(source: Source) -> dict[str, Any]:
    return {"kind": source.kind, "files": list(source.files), "orientation": source.orientation}


def _source_of(source: Mapping[str, Any]) -> Source:
    if source.get("kind") not in SOURCE_KINDS:
        raise ValueError(f"kind must be one of {', '.join(SOURCE_KINDS)}, not {shortly(source.get('kind'))}")
    return Source(
        kind=source["kind"],
        files=listed("files", source.get("files"), path),
        orientation=whole("orientation", source.get("orientation", 1), 1, 8),
    )


def _view_of(name: str, view: Any) -> dict[str, Any]:
    """Read a further view from a take's header, without its frame numbers."""
    if not isinstance(view, dict):
        raise ValueError(f"{name} must be objects, not {shortly(view)}")
    return {
        "source": _source_of(_object(view, "source")),
        "fps": number("fps", view.get("fps")),
        "width": whole("width", view.get("width"), 1, TAKE_LIMITS.max_side),
        "height": whole("height", view.get("height"), 1, TAKE_LIMITS.max_side),
        "mirrored": view.get("mirrored") is True,
    }


def _verdict_of(verdict: Mapping[str, Any]) -> Verdict:
    return Verdict(
        one_of(*AGREEMENTS)("agreement", verdict.get("agreement")), text("text", verdict.get("text"), 2000)
    )


def _of_header(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a take that its header holds, and `sides`. Raises ValueError for values that no
    take has, and OptionError for a camera that cannot be."""
    source, camera, digests = (_object(header, name) for name in ("source", "intrinsics", "model_digests"))
    arms = _object(header, "arms") if "arms" in header else {}
    sides = listed("sides", header.get("sides"), lambda _, side: side)
    if len(sides) > TAKE_LIMITS.max_hands or not all(side in SIDES for side in sides):
        raise ValueError(f"sides must be at most {TAKE_LIMITS.max_hands}, each left or right")
    if set(camera) != {"fx", "fy", "cx", "cy"}:
        raise ValueError("intrinsics must be fx, fy, cx and cy")
    distortion = listed("distortion", header["distortion"], number) if "distortion" in header else None
    if distortion is not None and len(distortion) != 5:
        raise ValueError(f"distortion must be five numbers, not {len(distortion)}")
    return {
        "source": _source_of(source),
        "fps": number("fps", header.get("fps")),
        "width": whole("width", header.get("width")),
        "height": whole("height", header.get("height")),
        "intrinsics": Intrinsics(**{name: number(name, value) for name, value in camera.items()}),
        "solver": text("solver", header.get("solver"), 100),
        "program": text("program", header.get("program", ""), 100),
        "model": path("model", header.get("model")),
        "model_digests": {
            side: text("model_digests", digest, 64) for side, digest in digests.items() if side in SIDES
        },
        "sides": sides,
        "views": listed("views", header.get("views", []), _view_of),
        "verdict": _verdict_of(_object(header, "verdict")) if "verdict" in header else None,
        "distortion": distortion,
        "arms": {hand: text("arms", why, 200) for hand, why in arms.items()},
    }


def is_take(path: str | os.PathLike[str]) -> bool:
    """True if a file looks like a take, and not like another program's .npz. Raises nothing."""
    try:
        with opened_file(path, TAKE_LIMITS.max_file_bytes) as stream:
            return {"header", "frame_numbers"} <= names_of(stream)
    except (OSError, ValueError, NotNpz):
        return False


def _object(header: Mapping[str, Any], name: str) -> dict[str, Any]:
    value = header.get(name)
    if not isinstance(value, dict):
        raise ValueError(f"{name} must be an object, not {shortly(value)}")
    return value
