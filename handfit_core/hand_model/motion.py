"""A hand's shape and poses over time, as solvers, readers of other programs' poses and re-fitting give it."""

from __future__ import annotations

from dataclasses import KW_ONLY, replace
from typing import Final, Self

import numpy as np

from handfit_core.common.arrays import array, array_dataclass, value
from handfit_core.common.skeleton import FINGERS, NUM_BETAS, SIDES, Side
from handfit_core.common.values import one_of

POSE_ARRAYS: Final = ("global_orient", "hand_pose", "transl")
_LARGEST_BETA: Final = 1e3


@array_dataclass
class HandMotion:
    """One hand over T frames, in MANO's parameters; NaN in frames without it.

    Axis-angle in radians relative to the flat hand (hands_mean is not added), root rotation about the wrist
    joint, camera frame (x right, y down, z forward), metres.
    """

    side: Side = value(one_of(*SIDES))
    betas: np.ndarray = array(NUM_BETAS, finite="all", most=_LARGEST_BETA)
    """(10,) shape coefficients, which are equal in all frames"""
    global_orient: np.ndarray = array("T", 3, finite="present")
    """(T, 3) radians, axis-angle: the root's rotation about the wrist joint"""
    hand_pose: np.ndarray = array("T", 45, finite="present")
    """(T, 45) radians, axis-angle: the rotations of the 15 finger joints"""
    transl: np.ndarray = array("T", 3, finite="present")
    """(T, 3) metres; the wrist lies at the shaped model's wrist + transl"""
    _: KW_ONLY
    doubtful: np.ndarray | None = array("T", kind="b", default=None)
    """(T,) bool: true for frames whose pose may well be wrong; None where nobody looked"""
    expected_error: np.ndarray | None = array("T", len(FINGERS), default=None)
    """(T, 5) metres that each finger, thumb first, is likely to be off once the hand is laid over the true
    one; NaN where nobody can tell, as where a person has corrected the pose, or in all frames, where the
    keypoints are of a source for which that is not known; None: nobody looked"""

    @property
    def pose(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The pose in all frames: `global_orient`, `hand_pose` and `transl`."""
        return self.global_orient, self.hand_pose, self.transl

    @property
    def present(self) -> np.ndarray:
        """(T,) bool: true in frames with a hand."""
        return np.logical_and.reduce([np.isfinite(rows).all(axis=1) for rows in self.pose])

    def posed_at(self, there: np.ndarray) -> Self:
        """Return the hand with its pose only in the frames that `there` (T,) bool marks, and absent in all
        others."""
        return self.with_pose(*(np.where(there[:, None], rows, np.nan) for rows in self.pose))

    def with_pose(self, *pose: np.ndarray) -> Self:
        """Return the hand with another pose: `global_orient`, `hand_pose` and `transl`."""
        return replace(self, **dict(zip(POSE_ARRAYS, pose, strict=True)))
