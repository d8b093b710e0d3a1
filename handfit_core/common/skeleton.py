"""Joint names, parents and the maps between MANO's and MediaPipe's orders. They stand only here.

Two orders exist:

* **joints**: MANO's 16 joints: wrist, then three each of index, middle, little, ring, thumb.
* **keypoints**: MediaPipe's 21 points: wrist, then four each of thumb, index, middle, ring, little.

The 21 keypoints of a model are its 16 joints and 5 fingertips, re-ordered by `KEYPOINT_SOURCE`.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

Side = Literal["left", "right"]
SIDES: Final[tuple[Side, Side]] = ("left", "right")
HandChoice = Literal["auto", "left", "right", "both"]
"""Which hands are wanted: whatever is seen, those of one side, or one of each"""

FINGERS: Final = ("thumb", "index", "middle", "ring", "little")
"""The fingers in MediaPipe's order, which is also the order of every array of five fingertips."""

JOINT_NAMES: Final = (
    "wrist",
    "index_proximal",
    "index_middle",
    "index_distal",
    "middle_proximal",
    "middle_middle",
    "middle_distal",
    "little_proximal",
    "little_middle",
    "little_distal",
    "ring_proximal",
    "ring_middle",
    "ring_distal",
    "thumb_metacarpal",
    "thumb_proximal",
    "thumb_distal",
)
"""MANO's 16 joints, each named after the bone that starts there."""

PARENTS: Final = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)
"""Parent of each of the 16 joints; -1 for the wrist."""

FINGER_JOINTS: Final[dict[str, tuple[int, int, int]]] = {
    "thumb": (13, 14, 15),
    "index": (1, 2, 3),
    "middle": (4, 5, 6),
    "ring": (10, 11, 12),
    "little": (7, 8, 9),
}
"""The three joints of each finger, from the palm outwards."""

JOINTS_BY_FINGER: Final = np.array([FINGER_JOINTS[f] for f in FINGERS])
"""(5, 3) numbers of the three joints of each finger, from the palm outwards, the fingers in the order of
FINGERS"""

KEYPOINT_NAMES: Final = ("wrist", *(f"{f}_{i}" for f in FINGERS for i in (1, 2, 3, 4)))
"""MediaPipe's 21 keypoints; `*_4` is the fingertip."""

NUM_JOINTS: Final = 16
NUM_KEYPOINTS: Final = 21
NUM_BETAS: Final = 10

WRIST_KEYPOINT: Final = 0
INDEX_KNUCKLE_KEYPOINT: Final = 5
PALM_KEYPOINTS: Final = (0, 1, 5, 9, 13, 17)
TIP_KEYPOINTS: Final = (4, 8, 12, 16, 20)


def can_touch(point: int, other: int) -> bool:
    """True if a keypoint can be brought to a smaller one, 0 being the whole palm: one of them bends, and they
    are not of one finger. For a negative `other`: if the bone that ends at the keypoint can be brought to the
    one that ends at the smaller keypoint -other."""
    smaller = abs(other)
    same_finger = smaller > 0 and (point - 1) // 4 == (smaller - 1) // 4
    rigid = {point, smaller} & set(PALM_KEYPOINTS)
    apart = not same_finger and len(rigid) < (1 if other < 0 else 2)
    return smaller < point < NUM_KEYPOINTS and apart


KEYPOINT_SOURCE: Final = (
    0,
    *(index for i, finger in enumerate(FINGERS) for index in (*FINGER_JOINTS[finger], NUM_JOINTS + i)),
)
"""keypoints[k] = concatenate(joints (16), fingertips (5))[KEYPOINT_SOURCE[k]]."""

KEYPOINT_PARENTS: Final = (-1, *(0 if i == 0 else 1 + 4 * f + i - 1 for f in range(5) for i in range(4)))
"""Parent of each of the 21 keypoints along its finger; -1 for the wrist. Drawing a hand needs no more."""

MANO_TIP_VERTICES: Final = (745, 317, 444, 556, 673)
"""MANO's fingertip vertices (thumb, index, middle, ring, little), as manotorch has them."""


def keypoints_from_joints(joints: np.ndarray, tips: np.ndarray) -> np.ndarray:
    """Return (..., 21, 3) keypoints in MediaPipe's order, of (..., 16, 3) joints and (..., 5, 3)
    fingertips."""
    return np.concatenate([joints, tips], axis=-2)[..., list(KEYPOINT_SOURCE), :]


def other_side(side: Side) -> Side:
    """Return the opposite hand: left for right, right for left."""
    return "left" if side == "right" else "right"
