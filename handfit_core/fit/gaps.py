"""Frames of a track without a detection: which of them are bridged, and a first guess for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handfit_core.geometry.rotations import (
    euler_to_rotmat,
    rotmat_to_euler,
    rotmat_to_rotvec,
    rotvec_to_rotmat,
)
from handfit_core.hand_model.chain import State
from handfit_core.skeleton import PALM_KEYPOINTS

LONGEST_GAP = 0.5
"""seconds; what a hand did for longer nobody can tell"""


LONGEST_JUMP = 1.0
"""Of the hand's size, from one detection to the next: farther is a cut to another shot"""
MOST_GROWTH = 1.6
"""Of the palm's size in the picture, from one detection to the next: more is a cut, too"""


def jumps(pixels: np.ndarray) -> np.ndarray:
    """(N - 1,) bool: whether the hand jumps between consecutive detections (N, 21, 2), as at a cut."""
    size = np.maximum(np.ptp(pixels, axis=1).max(axis=1), 1e-9)
    # Of the palm alone, since a fist that opens within a frame is no other shot.
    spread = np.maximum(pixels[:, list(PALM_KEYPOINTS)].std(axis=1).max(axis=1), 1e-9)
    larger = np.maximum(size[1:], size[:-1])
    moved = np.linalg.norm(pixels[1:].mean(axis=1) - pixels[:-1].mean(axis=1), axis=1) / larger
    growth = np.maximum(spread[1:] / spread[:-1], spread[:-1] / spread[1:])
    return (moved > LONGEST_JUMP) | (growth > MOST_GROWTH)


def missing_between(found: np.ndarray, holes: Sequence[int]) -> np.ndarray:
    """(N - 1,) bool: whether pictures are missing between consecutive detected frames (N,)."""
    before = np.searchsorted(np.sort(np.asarray(holes, dtype=np.int64)), found)
    return np.diff(before) > 0


@dataclass(frozen=True, eq=False)
class Times:
    """When the N detections of a track were made."""

    frames: np.ndarray
    """(N,) int, rising"""
    shots: np.ndarray
    """(N,) int: those of one shot have one number"""
    fps: float

    @classmethod
    def between(cls, frames: np.ndarray, cuts: np.ndarray, fps: float) -> Times:
        """With `cuts` (N - 1,) bool between detections."""
        return cls(frames, np.append(0, np.cumsum(cuts)), fps)

    def reach(self, seconds: float) -> int:
        """How many frames that is, but no more than there are from the first to the last."""
        return min(round(seconds * self.fps), int(self.frames[-1] - self.frames[0]))

    def mean(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """(N, n) means of values over the frames around in the same shot: weights (2 r + 1,) of those from r
        frames before to r after."""
        total, weight = np.zeros_like(values), np.zeros((len(values), 1))
        for step, each in enumerate(weights, -(len(weights) // 2)):
            row = np.searchsorted(self.frames, self.frames + step).clip(max=len(self.frames) - 1)
            there = (self.frames[row] == self.frames + step) & (self.shots[row] == self.shots)
            total += np.where(there[:, None], each * values[row], 0.0)
            weight += each * there[:, None]
        return total / weight


def spans(found: np.ndarray, fps: float, jump: np.ndarray | None = None) -> list[np.ndarray]:
    """Frame numbers, stretch by stretch: each runs from one detected frame to another without a gap that is
    longer than LONGEST_GAP, and without a jump. `found` (N,) the detected frames, rising; `jump`
    (N - 1,) bool between them."""
    longest = int(LONGEST_GAP * fps)
    broken = np.diff(found) - 1 > longest
    breaks = np.flatnonzero(broken if jump is None else broken | jump) + 1
    return [np.arange(part[0], part[-1] + 1) for part in np.split(found, breaks)]


def bridged(state: State, known: np.ndarray) -> State:
    """States of a stretch of T frames from those of its known ones (T,) bool, first and last among them:
    rotations turn evenly from one known frame to the next."""
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
