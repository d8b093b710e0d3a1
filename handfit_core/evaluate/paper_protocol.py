"""The published evaluation's error, faults included, so that numbers compare with the paper's table.

What it does (arXiv 2506.11133 and its code; docs/evaluation.md lists the consequences):

* only fingertips are scored, on every picture with a detection and at least one labelled tip;
* a predicted tip is a pixel with a depth in pixels, and one pixel of depth counts as one millimetre;
* the mean depth is moved to the truth's, pixels are unprojected with the data set's own camera, and the
  points' centroid is moved to the truth's: no rotation, no scale;
* so a picture with one labelled tip has an error of exactly zero.
"""

from __future__ import annotations

import numpy as np

from handfit_core.evaluate.metrics import centroid_aligned_distances
from handfit_core.geometry.camera import Intrinsics
from handfit_core.skeleton import NUM_KEYPOINTS, TIP_KEYPOINTS

MM = 1000.0


def published_error(picture_points: np.ndarray, joints_3d: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(21,) mm; NaN but for labelled fingertips.

    picture_points (21, 3): pixels with a relative depth in pixels; joints_3d (21, 3): labels in metres,
    camera frame.
    """
    errors = np.full(NUM_KEYPOINTS, np.nan)
    tips = [tip for tip in TIP_KEYPOINTS if np.isfinite(joints_3d[tip]).all()]
    if not tips:
        return errors
    truth = MM * joints_3d[tips]
    predicted = picture_points[tips]
    depth = predicted[:, 2] - predicted[:, 2].mean() + truth[:, 2].mean()
    unprojected = intrinsics.rays(predicted[:, :2]) * depth[:, None]
    errors[tips] = centroid_aligned_distances(unprojected, truth, min_points=1)
    return errors
