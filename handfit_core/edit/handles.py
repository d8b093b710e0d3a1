"""The points that an artist drags: a model's 21 landmarks, for Blender too."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from handfit_core.hand_model.chain import Chain
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import detector_landmarks


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
