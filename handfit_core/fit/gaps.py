"""Gaps in a track: which frames without a detection are interpolated, and a first guess for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handfit_core.common.skeleton import PALM_KEYPOINTS
from handfit_core.fit.settings import MOTION
from handfit_core.geometry.rotations import (
    euler_to_rotmat,
    rotmat_to_euler,
    rotmat_to_rotvec,
    rotvec_to_rotmat,
)
from handfit_core.hand_model.chain import State


def detect_cuts(pixels: np.ndarray) -> np.ndarray:
    """Tell between which consecutive detections, of keypoints at (N, 21, 2) pixels, there is a cut: (N - 1,)
    bool."""
    size = np.maximum(np.ptp(pixels, axis=1).max(axis=1), 1e-9)
    # Only the palm, since a fist that opens within a frame is no other shot.
    spread = np.maximum(pixels[:, list(PALM_KEYPOINTS)].std(axis=1).max(axis=1), 1e-9)
    larger = np.maximum(size[1:], size[:-1])
    moved = np.linalg.norm(pixels[1:].mean(axis=1) - pixels[:-1].mean(axis=1), axis=1) / larger
    growth = np.maximum(spread[1:] / spread[:-1], spread[:-1] / spread[1:])
    return (moved > MOTION.max_shift_of_size) | (growth > MOTION.max_growth)


def missing_between(found: np.ndarray, holes: Sequence[int]) -> np.ndarray:
    """Tell between which consecutive detected frames, by their numbers (N,), pictures of the source are
    missing: (N - 1,) bool."""
    before = np.searchsorted(np.sort(np.asarray(holes, dtype=np.int64)), found)
    return np.diff(before) > 0


@dataclass(frozen=True, eq=False)
class Times:
    """The frames and the shots in which the N detections of a track were made."""

    frames: np.ndarray
    """(N,) int: the frame number of each detection, rising"""
    shots: np.ndarray
    """(N,) int: the number of the shot in which each detection lies"""
    fps: float

    @classmethod
    def between(cls, frames: np.ndarray, cuts: np.ndarray, fps: float) -> Times:
        """Make the times of detections from their frame numbers (N,), rising, and `cuts` (N - 1,) bool, which
        are true where a cut lies between two of them."""
        return cls(frames, np.append(0, np.cumsum(cuts)), fps)

    def radius(self, seconds: float) -> int:
        """Return that many seconds as a number of frames, no larger than from the first detection to the
        last."""
        return min(round(seconds * self.fps), int(self.frames[-1] - self.frames[0]))

    def mean(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return weighted means (N, n) of values (N, n) over the neighbouring frames in the same shot.

        `weights` (2 r + 1,) are those of the frames from r before to r after.
        """
        total, weight = np.zeros_like(values), np.zeros((len(values), 1))
        for step, each in enumerate(weights, -(len(weights) // 2)):
            row = np.searchsorted(self.frames, self.frames + step).clip(max=len(self.frames) - 1)
            there = (self.frames[row] == self.frames + step) & (self.shots[row] == self.shots)
            total += np.where(there[:, None], each * values[row], 0.0)
            weight += each * there[:, None]
        return total / weight


def segments(found: np.ndarray, fps: float, cut: np.ndarray | None = None) -> list[np.ndarray]:
    """Split a track into segments, and return the consecutive frame numbers of each. A segment runs from one
    detected frame to another without a cut, and without a gap that is longer than `max_gap_seconds`.

    `found`: (N,) the numbers of detected frames, rising. `cut`: (N - 1,) bool, true where a cut lies between
    two of them; None: there are none.
    """
    longest = int(MOTION.max_gap_seconds * fps)
    broken = np.diff(found) - 1 > longest
    breaks = np.flatnonzero(broken if cut is None else broken | cut) + 1
    return [np.arange(rows[0], rows[-1] + 1) for rows in np.split(found, breaks)]


def interpolate_gaps(state: State, known: np.ndarray) -> State:
    """Return the states of a segment's T frames, with those that `known` (T,) bool does not mark interpolated
    between the others.

    The first and the last frame must be known. Rotations turn evenly from one known frame to the next
    (slerp).
    """
    if known.all():
        return state
    index = np.flatnonzero(known)
    frame = np.arange(len(known))
    after = np.clip(np.searchsorted(index, frame), 1, len(index) - 1)
    left, right = after - 1, after
    share = (frame - index[left]) / (index[right] - index[left])

    def between(values: np.ndarray) -> np.ndarray:
        weight = share.reshape(-1, *[1] * (values.ndim - 1))
        return (1 - weight) * values[left] + weight * values[right]

    def turned(rotations: np.ndarray) -> np.ndarray:
        first = rotations[left]
        turn = rotmat_to_rotvec(np.swapaxes(first, -1, -2) @ rotations[right])
        return first @ rotvec_to_rotmat(share.reshape(-1, *[1] * (turn.ndim - 1)) * turn)

    local = turned(euler_to_rotmat(state.angles.reshape(-1, 5, 3, 3)))
    return State(
        turned(state.root),
        rotmat_to_euler(local).reshape(-1, 5, 9),
        between(state.wrist),
        between(state.betas),
        between(state.depth_zero),
    )
