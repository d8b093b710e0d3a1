"""What readers give: hands that another program has found, in this project's conventions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from handfit_core.common.arrays import LARGEST, array, array_dataclass, check_arrays, value
from handfit_core.common.batch import Batch
from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, Side
from handfit_core.common.values import one_of
from handfit_core.detect.keypoints import check_crowd
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.landmarks import Landmarks
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.settings import LIMITS
from handfit_core.take import TAKE_LIMITS

VIRTUAL_SIZE: Final = 1920, 1080
"""Pixels of the picture of the camera that is taken for hands that no picture belongs to"""
VIRTUAL_DISTANCE: Final = 0.8
"""Metres from the assumed camera to hands whose file does not say where they lie"""
_APART: Final = 0.35
"""Metres between the origins of a left and a right hand that have no place: their wrists, each 0.1 m towards
the other hand from its origin, are 0.15 m apart"""
UNKNOWN: Final = -1
"""Stands in arrays of sides for a side that the file does not tell"""
LEAST_POINTS: Final = 6
"""The fewest points of a hand from which something can be said of its pose"""


def known(numbers: np.ndarray) -> np.ndarray:
    """Return (...) bool: where all numbers along the last axis are finite."""
    return np.asarray(np.isfinite(numbers).all(axis=-1))


@array_dataclass
class SeenHands(Batch):
    """N hands as another program found them, each in one of a recording's frames. In a recording they are in
    pixels of the upright picture (the middle of its first pixel is (0.5, 0.5)), of known sides, and their
    K = 21 points stand in MediaPipe's order; while a file is read, all that may differ."""

    row: np.ndarray = array("N", kind="i")
    """(N,) the index of each hand's frame among the recording's T; not decreasing"""
    side: np.ndarray = array("N", kind="i")
    """(N,) the index in `SIDES` of each hand's true side, or `UNKNOWN`"""
    hand: np.ndarray = array("N", kind="i")
    """(N,) the number of each hand within its frame, where the file counts hands"""
    score: np.ndarray = array("N")
    """(N,) how sure it is that this is a hand, 0..1"""
    points: np.ndarray = array("N", NUM_KEYPOINTS, 3)
    """(N, 21, 3) pixels: x and y in the picture, and depth away from the camera, relative to the wrist, on
    the scale of x; NaN where not known"""
    confidence: np.ndarray = array("N", NUM_KEYPOINTS)
    """(N, 21) how sure each point is, 0..1; 0 for points that are missing"""
    world: np.ndarray = array("N", NUM_KEYPOINTS, 3)
    """The points in space: metres about the hand's centre, along the camera frame's axes; NaN where not
    known"""
    turns: np.ndarray | None = array("N", NUM_KEYPOINTS, 4, default=None)
    """(N, 21, 4) how joints are turned, as quaternions x, y, z, w; None where the file does not tell"""

    @classmethod
    def of(cls, row: Any, side: Any, hand: Any, score: Any, told: Any, world: Any = np.nan) -> SeenHands:
        """The hands of N that have any point. `score`, NaN: the mean of the points' confidence; `told`
        (N, K, 2), or more columns: x, y, z, confidence and quaternion, NaN: not told. Raises ValueError for
        points that no hand has."""
        row, side, hand = (np.array(each, dtype=int) for each in (row, side, hand))
        told = np.array(told, dtype=np.float64) if len(row) else np.empty((0, NUM_KEYPOINTS, 8))
        told = np.pad(told, ((0, 0), (0, 0), (0, 8 - told.shape[-1])), constant_values=np.nan)
        world = np.broadcast_to(
            np.array(world if len(row) else np.nan, dtype=np.float64), told[..., :3].shape
        )
        if np.any(np.abs(np.delete(told, 3, axis=-1)) > LARGEST) or np.any(np.abs(world) > LARGEST):
            raise ValueError(f"a point lies beyond {LARGEST:g}")
        told, world = (np.where(np.isfinite(each), each, np.nan) for each in (told, world))
        points, sure = told[..., :3], told[..., 3]
        if np.nanmax(sure, initial=0.0) > 10.0:
            sure = sure / 100.0  # percent
        there = known(points[..., :2]) & np.any(points[..., :2] != 0.0, axis=-1)
        sure = np.where(there, np.where(np.isnan(sure), 1.0, sure).clip(0.0, 1.0), 0.0)
        score = np.array(score, dtype=np.float64)
        score = np.where(np.isfinite(score), score, sure.mean(axis=1)).clip(0.0, 1.0)
        found = np.flatnonzero(sure.any(axis=1) | known(world).any(axis=1))
        turns = told[..., 4:] if np.isfinite(told[..., 4:]).any() else None
        order = found[np.argsort(row[found], kind="stable")]
        return cls(row, side, hand, score, points, sure, world, turns).select(order)

    @property
    def keypoints(self) -> np.ndarray:
        """(N, K, 2) x and y of points whose confidence is above 0; NaN for all others."""
        trusted = (self.confidence > 0.0)[..., None]
        return np.where(trusted & np.isfinite(self.points[..., :2]), self.points[..., :2], np.nan)


@array_dataclass
class PointsHand:
    """One hand's keypoints in space over a recording's T frames."""

    side: Side = value(one_of(*SIDES))
    points: np.ndarray = array("T", NUM_KEYPOINTS, 3)
    """(T, 21, 3) metres in the camera frame (x right, y down, z forward), MediaPipe's order; NaN where
    unknown"""
    on_joints: bool = True
    """True if the points are a skeleton's joints (a fingertip's lies on the skin), rather than where
    annotators click, as MediaPipe's do"""
    landmarks: Landmarks | None = None
    """The places on our hand of a skeleton's points that are not its joints; None where `on_joints` says it
    all"""
    sigma: float | None = None
    """Metres that points are expected to be off; None where the change of the bones' lengths tells it"""

    @property
    def present(self) -> np.ndarray:
        """(T,) bool: frames in which enough of the hand is known to place it."""
        return np.asarray(known(self.points).sum(axis=1) >= LEAST_POINTS)


def usual_place(side: Side) -> np.ndarray:
    """(3,) metres: the `transl` given to a hand of that side whose file does not say where it lies: in front
    of an assumed camera, left and right hands apart."""
    return np.array([_APART / 2.0 if side == "left" else -_APART / 2.0, 0.0, VIRTUAL_DISTANCE])


@dataclass(frozen=True)
class ReadOptions:
    """The user's options for what a file may not tell; each has the name of its option."""

    reader: str | None = None
    order: str | None = None
    person: int | None = None
    fps: float | None = None
    picture_size: tuple[int, int] | None = None
    hand_mean: Literal["auto", "flat", "mean"] = "auto"
    model: str | None = None
    hands: Literal["auto", "left", "right", "both"] = "auto"

    @property
    def rate(self) -> float:
        """Frames per second that the user tells for a file that does not; 0 where unknown."""
        return self.fps or 0.0


@dataclass(frozen=True, eq=False)
class Recording:
    """The content of a file: T frames, and the hands in them, as they were seen in pictures or in space."""

    format: str
    """The name of the reader that has read the file"""
    files: tuple[str, ...]
    """Absolute paths of the files that were read"""
    fps: float
    """Frames per second; 0 where the file does not tell, as long as nobody needs them"""
    frame_numbers: np.ndarray
    """(T,) int, increasing: the numbers of the frames"""
    seen: SeenHands | None = None
    """The hands in pictures; None where they are in space"""
    points: tuple[PointsHand, ...] = ()
    posed: tuple[HandMotion, ...] = ()
    """Hands with their poses; those whose place is not known lie where `usual_place` has them"""
    size: tuple[int, int] | None = None
    """(width, height) of the upright pictures, pixels; None: not known"""
    intrinsics: Intrinsics | None = None
    """The camera that the hands were seen with; None: not known"""
    assumed: tuple[str, ...] = ()
    """Phrases for people, each beginning with a small letter, about what the file does not say and was
    assumed"""

    def check(self) -> None:
        """Raise ValueError for numbers that no take can hold, or arrays that do not belong together."""
        numbers = np.asarray(self.frame_numbers)
        if numbers.ndim != 1 or numbers.dtype.kind not in "iu" or not len(numbers):
            raise ValueError("it has no frames")
        if np.any(np.diff(numbers) <= 0):
            raise ValueError("its frames' numbers do not increase")
        if not TAKE_LIMITS.min_fps <= self.fps <= TAKE_LIMITS.max_fps:
            raise ValueError(f"its frame rate is {self.fps:g}")
        if self.size is not None and not all(0 < side < 1 << 24 for side in self.size):
            raise ValueError(f"its pictures have {self.size[0]}x{self.size[1]} pixels")
        if self.seen is None and not self.points and not self.posed:
            raise ValueError("it has no hand")
        count = len(numbers)
        hands = (*self.points, *self.posed)
        LIMITS.check(self.files[0], count, len(hands))
        if self.seen is not None:
            check_arrays(self.seen, ValueError, "its array ")
            if np.any(np.abs(self.seen.keypoints) > LIMITS.coordinate):
                raise ValueError(f"a point lies beyond {LIMITS.coordinate:g} pixels")
            if np.any(np.diff(self.seen.row) < 0) or np.any((self.seen.row < 0) | (self.seen.row >= count)):
                raise ValueError("its hands are in frames that it does not have")
            check_crowd(numbers[self.seen.row])
        for hand in hands:
            check_arrays(hand, ValueError, "its array ", T=count)
            place = hand.transl if isinstance(hand, HandMotion) else hand.points
            if np.any(np.abs(place) > LIMITS.away):
                raise ValueError(f"a hand lies more than {LIMITS.away:g} m away: are its numbers metres?")

    @property
    def summary(self) -> str:
        """A phrase for people about the recording's frames and hands."""
        if self.seen is not None:
            what = "keypoints in pictures" + (" with depth" if np.isfinite(self.seen.world).all() else "")
            counts = zip(SIDES, np.bincount(self.seen.side, minlength=2), strict=True)
            return f"{what}: " + ", ".join(f"{n} {side} hands" for side, n in counts if n)
        kind = "poses" if self.posed else "points in space"
        hands = (*self.posed, *self.points)
        return f"{kind}: " + ", ".join(f"{h.side} hand in {int(h.present.sum())} frames" for h in hands)
