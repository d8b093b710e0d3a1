"""Pictures of hands, each fitted by itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.detect.keypoints import Detections
from handfit_core.fit import doubt
from handfit_core.fit.fast import fitter_of
from handfit_core.fit.solution import Solution
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import HandModel


@dataclass(frozen=True, eq=False)
class FrameFits:
    """B independent fits, in the camera frame."""

    betas: np.ndarray
    """(B, 10)"""
    global_orient: np.ndarray
    hand_pose: np.ndarray
    transl: np.ndarray
    solution: Solution
    expected_error: np.ndarray
    """(B, 5) metres"""

    @property
    def doubtful(self) -> np.ndarray:
        return doubt.doubtful(self.expected_error)


def fit_frames(
    model: HandModel,
    detections: Detections,
    intrinsics: Intrinsics,
    hand_length: float | None = None,
) -> FrameFits:
    fitter = fitter_of(model, hand_length)
    seen, solution = fitter.solve_pictures(fitter.observe(detections, intrinsics))
    points, logits = fitter.chain.points(solution.state), doubt.side_logits(detections, model.side)
    factor = doubt.crop_spread_factor(detections) * doubt.lifted_thumb_factor(seen)
    error = doubt.expected_error(doubt.evidence(seen, points, logits), factor)
    return FrameFits(*fitter.chain.parameters(solution.state), solution, error)
