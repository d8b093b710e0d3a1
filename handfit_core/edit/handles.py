"""The points that an artist drags, a model's 21 landmarks, and those that touch; for Blender too."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import FINGERS, NUM_KEYPOINTS, can_touch
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
"""The 21 keypoints as artists read them, where they touch: the wrist's stands for the whole palm"""


def touching_pair(one: int, other: int) -> tuple[int, int]:
    """Which keypoint touches which, as `RefineHand.touches` has it. Raises OptionError for points that cannot
    be brought together."""
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
    points: tuple[int, int],
) -> np.ndarray:
    """(T,) metres between the skins at two points, as `touching_pair` gives them, of hands with betas (10,)
    and hand_pose (T, 45); negative where they stand in each other."""
    surface, count = surface_of(model), len(hand_pose)
    capsules = surface.of(
        np.broadcast_to(np.asarray(betas, dtype=np.float64), (count, len(betas))), hand_pose
    )
    return surface.gaps_at(capsules, np.arange(count), np.tile(points, (count, 1))).gap


def landmark_points(
    model: HandModel, betas: np.ndarray, global_orient: np.ndarray, hand_pose: np.ndarray, transl: np.ndarray
) -> np.ndarray:
    """(T, 21, 3) where the detector sees its points on a posed hand, metres, camera frame.

    betas (10,), global_orient (T, 3), hand_pose (T, 45), transl (T, 3). These are the points that the solver
    fits, each fixed to one bone. They are not `model.keypoints`: the detector's fingertips lie 2 to 9 mm
    short of the mesh's.
    """
    chain, count = _chain(model), len(global_orient)
    shape = np.broadcast_to(np.asarray(betas, dtype=np.float64), (count, len(betas)))
    return chain.points(chain.state(shape, global_orient, hand_pose, transl, np.zeros(count)))


@lru_cache(maxsize=8)
def _chain(model: HandModel) -> Chain:
    return Chain(model, detector_landmarks())
