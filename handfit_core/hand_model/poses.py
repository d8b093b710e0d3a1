"""Poses of fingers that belong to no rig: those that come with the add-on, and those that artists save."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import NUM_JOINTS, SIDES, Side
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.axes import REST_FROM_MODEL, mirrored_pose

FILE: Final = Path(__file__).parent / "data" / "poses.npz"
"""The file of the ready poses, which `scripts/ready_poses.py` at commit 2ca2c99 made"""
_ANGLES: Final = 3 * (NUM_JOINTS - 1)


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose of a hand's fingers, which fits any hand of either side."""

    side: Side
    hand_pose: np.ndarray
    """(45,) axis-angle in radians, as in a take"""

    def on(self, side: Side) -> np.ndarray:
        """Return the hand_pose (45,), in radians, of a hand of that side: mirrored for the other one."""
        if side == self.side:
            return self.hand_pose
        return mirrored_pose(np.zeros(3), self.hand_pose)[1]

    def turns(self, side: Side) -> np.ndarray:
        """Return each joint's rotation in rest space (16, 3, 3) on a hand of that side; the wrist does not
        turn."""
        fingers = rotvec_to_rotmat(self.on(side).reshape(-1, 3))
        return np.concatenate([np.eye(3)[None], REST_FROM_MODEL @ fingers @ REST_FROM_MODEL.T])

    @classmethod
    def of_turns(cls, side: Side, turns: np.ndarray) -> Pose:
        """Make a pose from the joints' rotations (16, 3, 3) on a hand of that side: the inverse of
        `turns`."""
        fingers = REST_FROM_MODEL.T @ turns[1:] @ REST_FROM_MODEL
        return cls(side, rotmat_to_rotvec(fingers).reshape(_ANGLES))

    def values(self) -> dict[str, Any]:
        """Return the pose as a dict of plain values, which a custom property of Blender's can hold."""
        return {"side": self.side, "hand_pose": self.hand_pose.tolist()}

    @classmethod
    def of_values(cls, values: Any) -> Pose:
        """Read the dict that `values` made. Raises HandModelError for whatever else a file may hold."""
        if not isinstance(values, Mapping) or values.get("side") not in SIDES:
            raise HandModelError("this is no pose of a hand, which names its side, left or right")
        numbers = values.get("hand_pose")
        try:
            pose = np.array(numbers, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            pose = np.empty(0)
        # Beyond a whole turn the same rotations are written otherwise, or numbers are no angles at all.
        if pose.shape != (_ANGLES,) or not np.all(np.abs(pose) <= 2.0 * np.pi):
            raise HandModelError(f"a pose of a hand is {_ANGLES} angles in radians, and this one is not")
        return cls(values["side"], pose)


@dataclass(frozen=True, eq=False)
class ReadyPose:
    """A pose that comes with the add-on."""

    name: str
    pose: Pose
    drawn: np.ndarray
    """(S, S, 2) uint8 light and alpha: the pose's picture, as `drawing.drawn_pose` gives it"""


@lru_cache(maxsize=1)
def ready_poses() -> dict[str, ReadyPose]:
    """Load the ready poses of a right hand by name, in the order in which they are shown."""
    with np.load(FILE, allow_pickle=False) as arrays:
        parts = [arrays[name] for name in ("names", "hand_poses", "drawn")]
    return {
        str(name): ReadyPose(str(name), Pose("right", pose.astype(np.float64)), drawn)
        for name, pose, drawn in zip(*parts, strict=True)
    }
