"""Hand detections and tracks, as frozen dataclasses and as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, overload

import numpy as np

from handfit_core.batch import Batch
from handfit_core.hand_model.landmarks import Landmarks
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES, Side, other_side

MOST_IN_FRAME: Final = 4000
"""Hands of one picture, as of 2 000 people; pictures with more are refused"""

SURE_SIDE_SCORE: Final = 0.9
"""Score of a detection from which on the correction network does not overrule its side. Of 667 real hands
that network named the wrong side of four, against a detector that was right and had more than this score"""


def check_crowd(frames: np.ndarray) -> None:
    """Raise ValueError where too many hands are in one frame. frames: (N,) the frame's number of each."""
    numbers, counts = np.unique(frames, return_counts=True)
    if counts.max(initial=0) > MOST_IN_FRAME:
        raise ValueError(
            f"there are {counts.max()} hands in frame {numbers[counts.argmax()]}, and at most "
            f"{MOST_IN_FRAME} are read: the frames' numbers may not be told as expected"
        )


@dataclass(frozen=True, eq=False)
class Landmarked(Batch):
    """Corrected landmarks of N hands with their expected errors, in pixels of the picture."""

    pixels: np.ndarray
    """(N, 21, 2)"""
    pixel_sigma: np.ndarray
    """(N, 21, 2) expected errors of `pixels`"""
    depth: np.ndarray
    """(N, 21) along the line of sight, about the hand's mean"""
    depth_sigma: np.ndarray
    """(N, 21) expected errors of `depth`"""
    pinned: np.ndarray | None = None
    """(N, 21) bool: points that a person has put in place. Their cost grows with the square, so that no
    number of other landmarks can outvote them. None: there are none"""

    @classmethod
    def of_table(cls, table: np.ndarray) -> Landmarked:
        """Landmarks of a `table` (N, 21, 6)."""
        pixels, sigma, depth = (np.ascontiguousarray(table[..., i : i + 2]) for i in (0, 2, 4))
        return cls(pixels, sigma, *(np.ascontiguousarray(depth[..., i]) for i in (0, 1)))

    @property
    def table(self) -> np.ndarray:
        """(N, 21, 6) pixels x and y, their expected errors, depth and its expected error; without
        `pinned`."""
        depth = np.stack([self.depth, self.depth_sigma], axis=-1)
        return np.concatenate([self.pixels, self.pixel_sigma, depth], axis=-1)


@dataclass(frozen=True, eq=False)
class HandDetection:
    """One hand in one picture."""

    side: Side
    """The true hand, in a picture that is not mirrored"""
    score: float
    """Confidence in the hand and its side, 0..1"""
    keypoints: np.ndarray
    """(21, 3) image landmarks in pixels of the upright picture: x, y, and depth z towards the scene,
    relative to the wrist and on the scale of x"""
    world: np.ndarray
    """(21, 3) world landmarks: metres about the hand's centre, axes as the camera frame's"""
    keypoints_2020: np.ndarray | None = None
    """(21, 3) pixels, as `keypoints`, of the landmark network of December 2020; None: it was not run"""
    spread: np.ndarray | None = None
    """(21, 3) standard deviation in pixels (x, y, z) of the predictions that `keypoints` averages; None of a
    single prediction"""
    overlapped: np.ndarray | None = None
    """(21,) bool: points that are believed less. They lie on another hand, and may be that one's; or another
    program doubts them, or did not find them, so that they are guessed. None: there are none"""
    shown: bool = False
    """Whether a person has said that it is there"""
    given_side: Side | None = None
    """The side that a person has given"""
    certainty: float | None = None
    """Probability that this is a hand, of whatever side; None: the detector does not tell"""
    right_side: float | None = None
    """Probability that `side` is the true one, by the correction network; None: it was not run"""
    distance: float | None = None
    """Metres along the line of sight to the mean of its points, where these are known in space and
    `corrected` has their depth about that; None: a picture does not tell"""
    corrected: tuple[Side, np.ndarray] | None = None
    """The correction network's landmarks for this detection taken for a hand of that side, as a row (21, 6)
    of `Landmarked.table`. Solvers that want the detector's own take `keypoints`"""

    @property
    def likely_side(self) -> Side:
        """The likelier side, by the detector and the correction network."""
        return self.side if self._side_probability >= 0.5 else other_side(self.side)

    @property
    def _side_probability(self) -> float:
        """Probability that `side` is the true one, 1 where the detector is sure."""
        return 1.0 if self.right_side is None or self.score >= SURE_SIDE_SCORE else self.right_side

    def side_votes(self) -> dict[Side, float]:
        """The score, shared between the sides by their probabilities."""
        named = self._side_probability
        return {self.side: self.score * named, other_side(self.side): self.score * (1.0 - named)}

    @property
    def keypoints_2d(self) -> np.ndarray:
        """(21, 2) pixels."""
        return self.keypoints[:, :2]

    @property
    def extent(self) -> float:
        """Size of the hand in the picture: the longer side of its keypoints' box, pixels."""
        return float(np.max(np.ptp(self.keypoints_2d, axis=0)))


def largest_extent(hands: Iterable[HandDetection]) -> float:
    """95th percentile of the hands' extents, pixels, which leaves out false detections and a hand that
    reaches for the lens; 0 where there is no hand."""
    extents = [hand.extent for hand in hands]
    return float(np.percentile(extents, 95.0)) if extents else 0.0


_COLUMNS: Final[dict[str, tuple[int, ...]]] = {
    "score": (),
    "right_side": (),
    "certainty": (),
    "shown": (),
    "keypoints": (NUM_KEYPOINTS, 3),
    "world": (NUM_KEYPOINTS, 3),
    "keypoints_2020": (NUM_KEYPOINTS, 3),
    "spread": (NUM_KEYPOINTS, 3),
}
"""Fields of a detection that become arrays, and their shapes; NaN stands for None"""


def hands_to_arrays(frames: Sequence[Sequence[HandDetection]]) -> dict[str, np.ndarray]:
    """The H hands of T frames as arrays: `counts` (T,) hands of each frame, all others (H, ...)."""
    hands = [hand for frame in frames for hand in frame]

    def column(name: str, shape: tuple[int, ...]) -> np.ndarray:
        values = [getattr(hand, name) for hand in hands]
        nothing = np.full(shape, np.nan)
        return np.array([nothing if v is None else v for v in values], dtype=np.float64)

    return {
        "counts": np.array([len(frame) for frame in frames], dtype=np.int64),
        "sides": np.array([SIDES.index(hand.side) for hand in hands], dtype=np.int64),
        "given": np.array([SIDES.index(h.given_side) if h.given_side else -1 for h in hands], dtype=np.int64),
        **{name: column(name, shape).reshape(-1, *shape) for name, shape in _COLUMNS.items()},
    }


def hands_from_arrays(arrays: Mapping[str, np.ndarray]) -> list[tuple[HandDetection, ...]]:
    """The inverse of `hands_to_arrays`. Raises KeyError, IndexError, TypeError and ValueError where the
    arrays do not fit together."""
    hands = []
    for name, shape in _COLUMNS.items():
        if arrays[name].shape != (len(arrays["sides"]), *shape):
            raise ValueError(f"{name} has the shape {arrays[name].shape}")
    for i, side in enumerate(arrays["sides"]):
        known: dict[str, Any] = {}
        for name, shape in _COLUMNS.items():
            if np.isfinite(value := arrays[name][i]).all():
                known[name] = value if shape else float(value)
        known |= {"shown": known["shown"] > 0.0, "given_side": (*SIDES, None)[arrays["given"][i]]}
        hands.append(HandDetection(SIDES[side], **known))
    counts = arrays["counts"]
    # Each count is checked first, so that their sum does not overflow.
    if np.any((counts < 0) | (counts > len(hands))) or counts.sum() != len(hands):
        raise ValueError(f"{len(hands)} hands are not as many as its frames count")
    check_crowd(np.repeat(np.arange(len(counts)), counts))
    return [tuple(hands[end - n : end]) for n, end in zip(counts, np.cumsum(counts), strict=True)]


class SideBySide(Sequence[HandDetection | None]):
    """The detections of one hand in T frames, stored column-wise to save memory: a detection is put together
    when it is asked for."""

    def __init__(self, detections: Sequence[HandDetection | None]) -> None:
        found = [d for d in detections if d is not None]
        nothing, no_table = np.zeros(0), np.zeros((NUM_KEYPOINTS, 6))
        no_points = np.full((NUM_KEYPOINTS, 3), np.nan)
        self._keypoints = np.array([d.keypoints for d in found])
        self._world = np.array([d.world for d in found])
        keypoints_2020 = [no_points if d.keypoints_2020 is None else d.keypoints_2020 for d in found]
        has_2020 = any(d.keypoints_2020 is not None for d in found)
        self._keypoints_2020 = np.array(keypoints_2020) if has_2020 else None
        self._corrected: np.ndarray | None = np.array(
            [d.corrected[1] if d.corrected else no_table for d in found]
        )
        self._others = [
            replace(
                d,
                keypoints=nothing,
                world=nothing,
                keypoints_2020=None if d.keypoints_2020 is None else nothing,
                corrected=d.corrected and (d.corrected[0], nothing),
            )
            for d in found
        ]
        self._rows = np.full(len(detections), -1)
        self._rows[[d is not None for d in detections]] = np.arange(len(found))

    def __len__(self) -> int:
        return len(self._rows)

    def forget_corrections(self) -> None:
        """Free half of the memory by dropping `corrected`, for which the correction network has to run
        again."""
        self._corrected = None

    @overload
    def __getitem__(self, index: int) -> HandDetection | None: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[HandDetection | None, ...]: ...

    def __getitem__(self, index: int | slice) -> HandDetection | tuple[HandDetection | None, ...] | None:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        if (row := self._rows[index]) < 0:
            return None
        other = self._others[row]
        corrected = None
        if other.corrected is not None and self._corrected is not None:
            corrected = other.corrected[0], self._corrected[row]
        second = None
        if other.keypoints_2020 is not None and self._keypoints_2020 is not None:
            second = self._keypoints_2020[row]
        return replace(
            other,
            keypoints=self._keypoints[row],
            world=self._world[row],
            keypoints_2020=second,
            corrected=corrected,
        )


@dataclass(frozen=True, eq=False)
class DetectedTrack:
    """One hand tracked over a clip's T frames; None where it was not found."""

    side: Side
    detections: Sequence[HandDetection | None]
    fps: float = 25.0
    """Frames per second: how far apart in time they are"""
    holes: tuple[int, ...] = ()
    """Rows after which pictures of the clip are missing, so that the next row is no neighbour in time"""
    landmarks: Landmarks | None = None
    """Where on a hand its keypoints lie; None: where the detector sees them"""
    calibrated: bool = True
    """Whether `fit.doubt` can tell how far off a fit to them is likely to be (`Backend.calibrated`)"""

    @property
    def detected(self) -> np.ndarray:
        """(T,) bool"""
        return np.array([d is not None for d in self.detections], dtype=bool)
