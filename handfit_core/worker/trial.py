"""Small things to do that use the heavy parts once: for `warm`, which wants them loaded, and for `check`,
which wants to know that they work."""

from __future__ import annotations

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import load_model
from handfit_core.skeleton import NUM_BETAS, NUM_KEYPOINTS, WRIST_KEYPOINT, Side

_CAMERA = Intrinsics(640.0, 640.0, 320.0, 240.0)
_DISTANCE = 0.5
"""metres"""


def blank_picture_hands() -> int:
    """How many hands the detector sees in a grey picture. Raises LandmarkModelError."""
    from handfit_core.detect.finder import open_finder
    from handfit_core.options import CaptureOptions

    with open_finder(CaptureOptions(plain_detection=True)) as finder:
        return len(finder.find(np.full((240, 320, 3), 128, dtype=np.uint8)))


def synthetic_fit_error_mm(side: Side = "right") -> float:
    """Mean distance in mm of the 21 keypoints that the fast solver finds, from those of the relaxed open hand
    that was projected for it, laid over each other."""
    from handfit_core.edit import landmark_points
    from handfit_core.fit.fast import fit_frames

    model = load_model(None, side)
    orient, transl = np.array([[-np.pi / 2, 0.0, 0.0]]), np.array([[0.0, 0.0, _DISTANCE]])
    pose = model.hands_mean[None]
    seen = landmark_points(model, np.zeros(NUM_BETAS), orient, pose, transl)[0]
    per_pixel = seen[:, 2].mean() / _CAMERA.fx
    depth = (seen[:, 2] - seen[WRIST_KEYPOINT, 2]) / per_pixel
    detection = HandDetection(
        side, 0.9, np.column_stack([_CAMERA.project(seen), depth]), seen - seen.mean(axis=0)
    )
    fits = fit_frames(model, [detection], _CAMERA)
    found = model.keypoints(fits.betas[0], fits.global_orient, fits.hand_pose, fits.transl)[0]
    true = model.keypoints(None, orient, pose, transl)[0]
    laid = align(found, true, with_scale=True).apply(found)
    assert laid.shape == (NUM_KEYPOINTS, 3)
    return float(np.linalg.norm(laid - true, axis=1).mean() * 1e3)
