"""Hands as detectors see them: the detections of pictures and clips, a row each, and the track of one hand
over a clip."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, Final, Self

import numpy as np

from handfit_core.common.arrays import Array, array, array_dataclass, arrays_of, declared
from handfit_core.common.batch import Batch
from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, Side
from handfit_core.hand_model.landmarks import Landmarks

MOST_IN_FRAME: Final = 4000
"""Most hands in one picture, as of 2 000 people; pictures with more are refused"""

SURE_SIDE_SCORE: Final = 0.9
"""Score of a detection from which on the correction network does not overrule its side. Of 667 real hands
that network named the wrong side of four, against a detector that was right and had more than this score"""


def check_crowd(frames: np.ndarray) -> None:
    """Raise ValueError where too many hands are in one frame. `frames` (N,) has the frame number of each
    hand."""
    numbers, counts = np.unique(frames, return_counts=True)
    if counts.max(initial=0) > MOST_IN_FRAME:
        raise ValueError(
            f"there are {counts.max()} hands in frame {numbers[counts.argmax()]}, and at most "
            f"{MOST_IN_FRAME} are read: the frames' numbers may not be told as expected"
        )


@dataclass(frozen=True, eq=False)
class Landmarked(Batch):
    """Corrected landmarks of N hands with their expected errors, all in pixels of the picture."""

    pixels: np.ndarray
    """(N, 21, 2) x and y in the picture"""
    pixel_sigma: np.ndarray
    """(N, 21, 2) expected errors of `pixels`, one standard deviation each"""
    depth: np.ndarray
    """(N, 21) depth along the line of sight, about the hand's mean"""
    depth_sigma: np.ndarray
    """(N, 21) expected errors of `depth`, one standard deviation each"""
    pinned: np.ndarray | None = None
    """(N, 21) bool: True for points that a person has put in place. Their cost grows with the square, so that
    no number of other landmarks can outvote them. None: there are none"""

    @classmethod
    def of_table(cls, table: np.ndarray) -> Landmarked:
        """Make landmarks, with none pinned, of a `table` (N, 21, 6) as `Landmarked.table` returns it."""
        pixels, sigma, depth = (np.ascontiguousarray(table[..., i : i + 2]) for i in (0, 2, 4))
        return cls(pixels, sigma, *(np.ascontiguousarray(depth[..., i]) for i in (0, 1)))

    @property
    def table(self) -> np.ndarray:
        """(N, 21, 6) pixels: x and y, their expected errors, depth and its expected error; `pinned` is left
        out."""
        depth = np.stack([self.depth, self.depth_sigma], axis=-1)
        return np.concatenate([self.pixels, self.pixel_sigma, depth], axis=-1)


@array_dataclass
class Detections(Batch):
    """N hands that a detector found, each in one of a clip's T frames, in the order of frames; a picture is a
    clip of one frame. Iterating gives one hand after the other, each as `Detections` of one row.

    The large columns that nobody filled are None, which saves their memory.
    """

    frame: np.ndarray = array("N", kind="i")
    """(N,) row of the clip's frame that each hand is in, counted from 0; not decreasing"""
    side: np.ndarray = array("N", kind="i")
    """(N,) index in `SIDES` of the side of the true hand, in a picture that is not mirrored"""
    score: np.ndarray = array("N")
    """(N,) confidence in the hand and its side, 0..1"""
    keypoints: np.ndarray = array("N", NUM_KEYPOINTS, 3, finite="all")
    """(N, 21, 3) image landmarks in pixels of the upright picture: x, y, and depth z towards the scene,
    relative to the wrist and on the scale of x"""
    world: np.ndarray = array("N", NUM_KEYPOINTS, 3, finite="all")
    """(N, 21, 3) world landmarks: metres about the hand's centre, along the camera frame's axes"""
    keypoints_2020: np.ndarray | None = array("N", NUM_KEYPOINTS, 3, default=None)
    """(N, 21, 3) pixels: image landmarks by the landmark network of December 2020, with the meaning of
    `keypoints`; NaN where that network was not run"""
    spread: np.ndarray | None = array("N", NUM_KEYPOINTS, 3, default=None)
    """(N, 21, 3) standard deviation in pixels (x, y, z) of the predictions that `keypoints` averages; NaN
    where there is a single one"""
    overlapped: np.ndarray | None = array("N", NUM_KEYPOINTS, kind="b", default=None)
    """(N, 21) bool: True for points that are believed less. They lie on another hand, and may be that one's;
    or another program doubts them, or did not find them, so that they are guessed"""
    shown: np.ndarray = array("N", kind="b", default=None)
    """(N,) bool: True if a person has said that a hand is there"""
    given_side: np.ndarray = array("N", kind="i", default=None)
    """(N,) index in `SIDES` of the side that a person has given, else -1"""
    certainty: np.ndarray = array("N", default=None)
    """(N,) probability that this is a hand, of whatever side; NaN where the detector does not say"""
    right_side: np.ndarray = array("N", default=None)
    """(N,) probability that `side` is the true one, by the correction network; NaN where it was not run"""
    distance: np.ndarray = array("N", default=None)
    """(N,) metres along the line of sight to the mean of the hand's points, where these are known in space
    and `corrected` has their depth about that mean; NaN where the distance is not known, as in a plain
    picture"""
    corrected_side: np.ndarray = array("N", kind="i", default=None)
    """(N,) index in `SIDES` of the side that `corrected` takes each hand for, -1 where it is not known"""
    corrected: np.ndarray | None = array("N", NUM_KEYPOINTS, 6, default=None)
    """(N, 21, 6) pixels: the correction network's landmarks, laid out as `Landmarked.table`. Solvers that
    want the detector's own landmarks take `keypoints`"""

    def __post_init__(self) -> None:
        for name, nothing in _UNKNOWN.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(len(self.frame), nothing))

    def __iter__(self) -> Iterator[Self]:
        return (self.select(slice(row, row + 1)) for row in range(len(self)))

    @classmethod
    def hand(cls, side: Side, score: float, keypoints: Any, world: Any, **columns: Any) -> Self:
        """Make one hand of one picture, of its `keypoints` (21, 3), pixels, `world` landmarks (21, 3),
        metres, and values of further columns. Raises ValueError for arrays of another shape."""
        row = {"frame": 0, "side": SIDES.index(side), "score": score, "keypoints": keypoints, "world": world}
        specs = declared(cls)
        given = {name: value for name, value in columns.items() if value is not None}
        hand = cls(**{name: np.asarray([value]) for name, value in (row | given).items()})
        for name, column in arrays_of(hand).items():
            specs[name].check_form(name, column, {"N": 1})
        return hand

    @classmethod
    def of(cls, frames: Sequence[Iterable[Self]]) -> Self:
        """Join the hands of T frames; each frame is given as one `Detections`, or as several."""
        parts = [(row, part) for row, frame in enumerate(frames) for part in _parts(frame)]
        if not parts:
            return _none(cls)
        rows, hands = np.array([row for row, _ in parts], dtype=np.int64), [hands for _, hands in parts]
        columns: dict[str, Any] = {name: _joined(name, spec, hands) for name, spec in declared(cls).items()}
        return cls(**columns | {"frame": np.repeat(rows, np.array([len(each) for each in hands], dtype=int))})

    def at_frames(self, frames: np.ndarray) -> Self:
        """Return a hand's detections in the `frames` (K,) of its clip, which may be in any order and count as
        0 to K - 1 in the result."""
        rows = np.minimum(np.searchsorted(self.frame, frames), max(len(self) - 1, 0))
        there = np.flatnonzero(self.frame[rows] == frames) if len(self) else rows[:0]
        return replace(self.select(rows[there]), frame=there)

    def shown_by_person(self, side: Side | None) -> Self:
        """Return these hands marked as seen by a person, who says that they are of that side (None: says
        nothing of it)."""
        given = -1 if side is None else SIDES.index(side)
        return replace(self, shown=np.ones(len(self), bool), given_side=np.full(len(self), given))

    def moved(self, change: Callable[[np.ndarray], np.ndarray]) -> Self:
        """Return these hands with all their points in the picture changed by a function from (..., 2) pixels
        to (..., 2) pixels; depths and expected errors stay."""
        columns = {name: getattr(self, name) for name in ("keypoints", "keypoints_2020", "corrected")}
        changed = {
            name: np.concatenate([change(column[..., :2]), column[..., 2:]], axis=-1)
            for name, column in columns.items()
            if column is not None
        }
        return replace(self, **changed)

    @property
    def keypoints_2d(self) -> np.ndarray:
        """(N, 21, 2) pixels: x and y of the keypoints."""
        return self.keypoints[..., :2]

    @cached_property
    def box_min(self) -> np.ndarray:
        """(N, 2) upper left corners of the keypoints' boxes, pixels."""
        return self.keypoints_2d.min(axis=1)

    @cached_property
    def box_max(self) -> np.ndarray:
        """(N, 2) lower right corners of the keypoints' boxes, pixels."""
        return self.keypoints_2d.max(axis=1)

    @cached_property
    def centroid(self) -> np.ndarray:
        """(N, 2) means of the keypoints, pixels."""
        return self.keypoints_2d.mean(axis=1)

    @cached_property
    def extent(self) -> np.ndarray:
        """(N,) sizes of the hands in the picture: the longer sides of their keypoints' boxes, pixels."""
        return np.asarray((self.box_max - self.box_min).max(axis=1))

    @property
    def side_probability(self) -> np.ndarray:
        """(N,) probabilities that `side` is the true one, 1 where the detector is sure."""
        judged = np.isfinite(self.right_side) & (self.score < SURE_SIDE_SCORE)
        return np.where(judged, self.right_side, 1.0)

    @cached_property
    def likely_side(self) -> np.ndarray:
        """(N,) indices in `SIDES` of the likelier sides, by the detector and the correction network."""
        return np.where(self.side_probability >= 0.5, self.side, 1 - self.side)

    @cached_property
    def side_votes(self) -> np.ndarray:
        """(N, 2) the scores, shared between the sides of `SIDES` by their probabilities."""
        named = self.side_probability
        votes = np.stack([self.score * named, self.score * (1.0 - named)], axis=1)
        return np.where(self.side[:, None] == 0, votes, votes[:, ::-1])

    @property
    def asked_2020(self) -> np.ndarray:
        """(N,) bool: True for hands that the landmark network of December 2020 has seen."""
        if self.keypoints_2020 is None:
            return np.zeros(len(self), dtype=bool)
        return np.asarray(np.isfinite(self.keypoints_2020).all(axis=(1, 2)))

    @property
    def rows_by_frame(self) -> list[np.ndarray]:
        """The indices of the hands of each frame that has any, one array a frame."""
        rows = np.split(np.arange(len(self)), np.flatnonzero(np.diff(self.frame)) + 1)
        return rows if len(self) else []


_UNKNOWN: Final = {
    "shown": False,
    "given_side": -1,
    "certainty": np.nan,
    "right_side": np.nan,
    "distance": np.nan,
    "corrected_side": -1,
}
"""Values of the small columns in rows for which nobody gave any"""


@cache
def _none(cls: type[Detections]) -> Any:
    """Detections of no hand."""
    columns: dict[str, Any] = {name: _joined(name, spec, []) for name, spec in declared(cls).items()}
    return cls(**columns)


def _parts(frame: Iterable[Detections]) -> Iterable[Detections]:
    return [frame] if isinstance(frame, Detections) else frame


def _joined(name: str, spec: Array, parts: Sequence[Detections]) -> np.ndarray | None:
    """Join one column of several detections; None where all of them lack it. The rows of those that lack it
    get NaN, or False in a column of truth values."""
    columns = [getattr(part, name) for part in parts]
    if spec.optional and all(column is None for column in columns) and name not in _UNKNOWN:
        return None
    shape = [size for size in spec.shape if isinstance(size, int)]
    if len(columns) == 1 and columns[0] is not None and [*columns[0].shape[1:]] == shape:
        return columns[0].astype(spec.dtype(np.float64), copy=False)
    nothing = False if spec.kind == "b" else np.nan
    filled = [
        np.full((len(part), *shape), nothing) if column is None else column
        for part, column in zip(parts, columns, strict=True)
    ]
    return np.concatenate([np.empty((0, *shape), spec.dtype(np.float64)), *filled])


def largest_extent(extents: np.ndarray) -> float:
    """Return the 95th percentile of hands' extents (N,), pixels, which leaves out false detections and a hand
    that reaches for the lens; 0 where there is no hand."""
    return float(np.percentile(extents, 95.0)) if len(extents) else 0.0


@dataclass(frozen=True, eq=False)
class Track:
    """One hand over a clip's T frames."""

    side: Side
    detections: Detections
    """The hand's N detections, at most one in each of the T frames, in their order"""
    frame_count: int
    """The number T of frames in the clip"""
    fps: float = 25.0
    """Frames per second, which tells how far apart in time neighbouring rows are"""
    holes: tuple[int, ...] = ()
    """Rows after which pictures of the clip are missing, so that the next row is no neighbour in time"""
    landmarks: Landmarks | None = None
    """Where on a hand its keypoints lie; None: where MediaPipe's networks see them"""
    calibrated: bool = True
    """True if `fit.doubt` can tell how far off a fit to these keypoints is likely to be
    (`Backend.calibrated`)"""

    @property
    def detected(self) -> np.ndarray:
        """(T,) bool: True for the frames in which the hand was detected."""
        detected = np.zeros(self.frame_count, dtype=bool)
        detected[self.detections.frame] = True
        return detected
