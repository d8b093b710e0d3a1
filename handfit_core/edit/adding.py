"""Hands that a person lays into a picture in which no hand was detected. Blender uses this module, too."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from handfit_core.common.batch import scatter
from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import NUM_BETAS, NUM_KEYPOINTS
from handfit_core.edit.handles import landmark_points
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model import HandModel
from handfit_core.hand_model.anatomy import relaxed_pose
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import HandTrack, Take

Seen = Literal["back", "palm"]
WRIST, KNUCKLE = 0, 9
"""The two keypoints that say where a hand lies: its wrist, and the middle finger's knuckle"""
USUAL_PALM = 0.12
"""Default length of the palm, as a share of the picture's shorter side"""


def laid(
    model: HandModel, intrinsics: Intrinsics, wrist: np.ndarray, knuckle: np.ndarray, seen: Seen = "back"
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return global_orient (3,) and hand_pose (45,) in radians, and transl (3,) in metres, of a relaxed hand
    of the mean shape, parallel to the picture, with its wrist and the middle finger's knuckle at these pixels
    (2,), so that its back or its palm is `seen`. Raises OptionError where the two are one point."""
    step = (np.asarray(knuckle, dtype=np.float64) - wrist) / (intrinsics.fx, intrinsics.fy)
    length = float(np.linalg.norm(step))
    if not length * intrinsics.fx >= 1.0:
        raise OptionError("a hand needs a size: drag from its wrist to the knuckle of its middle finger")
    # Half a relaxed hand's bends: so the fingertips lie apart from the knuckles, and can be dragged
    betas, still, pose = np.zeros(NUM_BETAS), np.zeros((1, 3)), 0.5 * relaxed_pose(model)
    flat = landmark_points(model, betas, still, pose[None], still)[0]
    palm = flat[KNUCKLE] - flat[WRIST]
    # The model's back is up, the camera looks along z.
    from_axes = _axes(palm, np.array([0.0, 1.0, 0.0]))
    to_axes = _axes(np.append(step, 0.0), np.array([0.0, 0.0, -1.0 if seen == "back" else 1.0]))
    orient = rotmat_to_rotvec(to_axes @ from_axes.T)
    points = landmark_points(model, betas, orient[None], pose[None], still)[0]
    distance = np.linalg.norm(palm) / length
    slope = (np.asarray(wrist) - (intrinsics.cx, intrinsics.cy)) / (intrinsics.fx, intrinsics.fy)
    return orient, pose, distance * np.append(slope, 1.0) - points[WRIST]


def _axes(along: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Return the axes of a hand as columns (3, 3): along the palm, out of its back, and across both."""
    along = along / np.linalg.norm(along)
    back = back - along * (along @ back)
    back /= np.linalg.norm(back)
    return np.stack([along, back, np.cross(along, back)], axis=1)


def with_added(
    take: Take, model: HandModel, row: int, wrist: np.ndarray, knuckle: np.ndarray, seen: Seen = "back"
) -> Take:
    """Return the take with one more hand, of the model's side, which is `laid` into its frame `row` and
    absent in all others. Raises OptionError where wrist and knuckle are one point."""
    laid_pose = laid(model, take.intrinsics, wrist, knuckle, seen)
    pose = (scatter(each[None], [row], len(take.frame_numbers)) for each in laid_pose)
    motion = HandMotion(model.side, np.zeros(NUM_BETAS), *pose)
    placed = np.full((len(take.frame_numbers), NUM_KEYPOINTS, 2), np.nan)
    placed[row, [WRIST, KNUCKLE]] = wrist, knuckle
    track = replace(HandTrack.undetected(motion, model), placed=placed)
    # A hand of that side that an older model was fitted to keeps its own.
    digests = {model.side: model.digest, **take.model_digests}
    return replace(take, hands=(*take.hands, track), model_digests=digests)
