"""The points that an artist drags, which are a model's 21 landmarks, and which of them touch. Blender uses
this module, too."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import FINGERS, NUM_KEYPOINTS, PALM_KEYPOINTS, TIP_KEYPOINTS, can_touch
from handfit_core.geometry.crossing import CROSSING_STARTS, Crossing
from handfit_core.hand_model.chain import Chain
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import detector_landmarks
from handfit_core.hand_model.surface import surface_of

POINT_NAMES: Final = (
    "Palm",
    *(f"Thumb {name}" for name in ("Root", "Knuckle", "Joint", "Tip")),
    *(
        f"{finger.capitalize()} {name}"
        for finger in FINGERS[1:]
        for name in ("Knuckle", "Middle Joint", "Last Joint", "Tip")
    ),
)
"""Names of the 21 keypoints as artists read them in touches, where the wrist's stands for the whole palm"""

_MAX_FIRST_GAP: Final = 0.03
"""metres between the skins of the thumb and the finger next to it up to which they count as pressed
together"""
_MAX_GAP: Final = 0.008
"""metres between the skins of other parts up to which they count as touching: they may well pass the same
line of sight apart"""


def touching_pair(one: int, other: int) -> tuple[int, int]:
    """Return which keypoint touches which, as (larger, smaller) in the way of `RefineHand.touches`. Raises
    OptionError for points that cannot be brought together."""
    if not all(0 <= point < NUM_KEYPOINTS for point in (one, other)):
        raise OptionError(f"points that touch are 0 to {NUM_KEYPOINTS - 1}, not {one} and {other}")
    first, second = max(one, other), min(one, other)
    if not can_touch(first, second):
        raise OptionError(
            f"{POINT_NAMES[first]} and {POINT_NAMES[second]} cannot be brought together: choose points of "
            "two fingers, or of a finger and the palm"
        )
    return first, second


def gaps_between(
    model: HandModel,
    betas: np.ndarray,
    hand_pose: np.ndarray,
    points: tuple[int, int] | np.ndarray,
) -> np.ndarray:
    """Return the metres (T,) between the skins at two points, a pair or (T, 2) as in `RefineHand.touches`, of
    hands with betas (10,) and hand_pose (T, 45) in radians; negative where the skins overlap."""
    surface, count = surface_of(model), len(hand_pose)
    capsules = surface.of(
        np.broadcast_to(np.asarray(betas, dtype=np.float64), (count, len(betas))), hand_pose
    )
    return surface.gaps_at(capsules, np.arange(count), np.broadcast_to(points, (count, 2))).gap


def lying_over(
    model: HandModel, betas: np.ndarray, hand_pose: np.ndarray, pixels: np.ndarray
) -> list[dict[int, int]]:
    """The touches, as in `RefineHand.touches`, of what lies over each other in the pictures of T hands with
    betas (10,), hand_pose (T, 45) and keypoints at pixels (T, 21, 2): of each finger the bone that crosses
    the thumb, and fingertips on the palm. Where several bones of a finger cross the thumb, those that are
    nearest to each other in space; what is far apart there is left out."""
    hand, pair = np.nonzero(Crossing.of(pixels).crossed)
    crossing = (CROSSING_STARTS[pair][:, ::-1] + 1) * [1, -1]
    over_palm, tip = np.nonzero(_inside(pixels[:, TIP_KEYPOINTS], pixels[:, PALM_KEYPOINTS]))
    on_palm = np.stack([np.array(TIP_KEYPOINTS)[tip], np.zeros_like(tip)], axis=1)
    rows, points = np.concatenate([hand, over_palm]), np.concatenate([crossing, on_palm])
    found: list[dict[int, int]] = [{} for _ in pixels]
    if not len(rows):
        return found
    gaps = gaps_between(model, betas, hand_pose[rows], points)
    taken: set[tuple[int, int, bool]] = set()
    for at in np.argsort(gaps):
        row, (point, other) = int(rows[at]), points[at].tolist()
        part = row, (point - 1) // 4, other == 0
        first = other < 0 and not any(found[row].values())
        near = gaps[at] < (_MAX_FIRST_GAP if first else _MAX_GAP)
        if near and part not in taken and (other or point not in found[row]):
            taken.add(part)
            found[row][point] = other
    return found


def _inside(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Tell which points (T, P, 2) lie in the polygons with these corners (T, C, 2): (T, P) bool."""
    x, y = points[:, :, None, 0], points[:, :, None, 1]
    start, end = corners[:, None], np.roll(corners, -1, axis=1)[:, None]
    across = (start[..., 1] > y) != (end[..., 1] > y)
    with np.errstate(all="ignore"):
        share = (y - start[..., 1]) / (end[..., 1] - start[..., 1])
    left = x < start[..., 0] + share * (end[..., 0] - start[..., 0])
    return np.asarray((across & left).sum(axis=-1) % 2 == 1)


def landmark_points(
    model: HandModel, betas: np.ndarray, global_orient: np.ndarray, hand_pose: np.ndarray, transl: np.ndarray
) -> np.ndarray:
    """Return where the detector sees its points on posed hands: (T, 21, 3) metres in the camera frame.

    betas (10,); global_orient (T, 3) and hand_pose (T, 45) in radians; transl (T, 3) in metres. These are the
    points that the solver fits, each fixed to one bone. They are not `model.keypoints`: the detector's
    fingertips lie 2 to 9 mm short of the mesh's.
    """
    chain, count = _chain(model), len(global_orient)
    shape = np.broadcast_to(np.asarray(betas, dtype=np.float64), (count, len(betas)))
    return chain.points(chain.state(shape, global_orient, hand_pose, transl, np.zeros(count)))


@lru_cache(maxsize=8)
def _chain(model: HandModel) -> Chain:
    return Chain(model, detector_landmarks())
