"""Posing of added hands, of which nothing was detected, from a few pins.

The pose that such a hand has is turned to 18 sides, each is laid over the pins, and from each the hand is
fitted to the pins and to what hands usually do. The lowest cost decides, with a little more for showing the
other side of the hand. Palm points without a pin stay near where their start has them, so loosely that this
decides only what pins leave open. Fingers without a pin bend as their neighbours do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handfit_core.common.skeleton import JOINTS_BY_FINGER, NUM_KEYPOINTS, PALM_KEYPOINTS
from handfit_core.detect.keypoints import Landmarked
from handfit_core.edit import pins as pinning
from handfit_core.edit.settings import EDITS
from handfit_core.fit.fast import FastFitter
from handfit_core.fit.observation import PoseAnchor, observation_of
from handfit_core.fit.problem import FixedJoints
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model.anatomy import BEND, LAST_BEND, MIDDLE_BEND
from handfit_core.hand_model.chain import State


def is_free(pins: np.ndarray) -> np.ndarray:
    """Tell for each of N frames whether its pins (N, 21, 2), in pixels and NaN where there is none, determine
    how a hand lies, whatever pose it has: (N,) bool."""
    palm = np.isfinite(pins[:, list(PALM_KEYPOINTS)]).all(axis=2)
    return np.asarray(palm.sum(axis=1) >= EDITS.min_palm_pins)


def pose_from_pins(
    fitter: FastFitter,
    intrinsics: Intrinsics,
    pins: np.ndarray,
    own: State,
    locked: np.ndarray,
    max_iterations: int,
) -> State:
    """Fit the pose of one hand (B = 1) to pins (21, 2) in pixels, NaN where there is none, from its present
    pose `own`.

    `locked`: (16,) bool, true for joints that stay as they are.
    """
    at = np.asarray(np.isfinite(pins).all(axis=1))
    start = _starts(fitter, intrinsics, pins, at, own)
    count, fixed = len(start), None
    if locked.any():
        fixed = FixedJoints(np.tile(locked, (count, 1)), own.select(np.zeros(count, dtype=int)))
        start = fixed.put(start)
    points = fitter.chain.points(start)
    loose = pinning.landmarks_of_pose(points, intrinsics)
    loosely = np.where(
        np.isin(np.arange(NUM_KEYPOINTS), PALM_KEYPOINTS), EDITS.palm_sigma, EDITS.unseen_sigma
    )
    sigma = loosely * pinning.hand_sizes(loose.pixels)[:, None]
    seen = Landmarked(
        np.where(at[:, None], pins, loose.pixels),
        np.where(at[:, None], pinning.PINS.pin_sigma, sigma[..., None].repeat(2, axis=2)),
        loose.depth,
        sigma,
        pinned=np.tile(at, (count, 1)),
    )
    away = np.linalg.norm(own.wrist) / np.linalg.norm(start.wrist, axis=1, keepdims=True)
    anchor = PoseAnchor.at(replace(start, wrist=start.wrist * away), EDITS.distance_sigma)
    seen = replace(observation_of(seen, intrinsics), anchor=anchor)
    # Pins that are all but exact are hard to follow from far away, so the best hands come nearer in steps.
    for nearness, left in ((EDITS.first_pin_sigma, 4), (0.2 * EDITS.first_pin_sigma, 2), (0.0, 1)):
        least = nearness * pinning.hand_sizes(seen.pixels)[:, None, None]
        about = replace(seen, pixel_sigma=np.maximum(seen.pixel_sigma, least))
        problem = replace(fitter.problem(about, fixed=fixed), angle_bounds=fitter.angle_bounds)
        solution = fitter.solve_each(problem, start, max_iterations)
        # The axis of the root that points out of the back of the hand
        same_side = solution.state.root[..., 1] @ own.root[0, :, 1]
        cost = np.nan_to_num(solution.cost, nan=np.inf, posinf=np.inf)
        best = (cost + EDITS.turned_over_cost * (1.0 - same_side) / 2.0).argsort(kind="stable")[:left]
        start, seen = solution.state.select(best), seen.select(best)
        fixed = None if fixed is None else fixed.select(best)
    return replace(start, angles=_with_neighbours_bends(fitter, start.angles, own.angles, at, locked))


def _starts(
    fitter: FastFitter, intrinsics: Intrinsics, pins: np.ndarray, at: np.ndarray, own: State
) -> State:
    """Return the 18 states that the search starts from: the one hand `own`, turned to all sides, and each
    laid over its pins by a turn in the picture, a place and a distance."""
    points = fitter.chain.points(own)[0]
    along = points[9] - points[0]  # from the wrist to the middle finger's knuckle
    across = np.cross(points[0], along)
    turns = np.array(
        [
            rotvec_to_rotmat(pitch * across / np.linalg.norm(across))
            @ rotvec_to_rotmat(roll * along / np.linalg.norm(along))
            for roll in EDITS.rolls
            for pitch in EDITS.pitches
        ]
    )
    shapes = (points - points[0]) @ turns.swapaxes(1, 2)
    # Seen from afar, places in the picture are complex numbers: a similarity is a factor and a sum.
    centre, focal = (intrinsics.cx, intrinsics.cy), (intrinsics.fx, intrinsics.fy)
    aim = ((pins[at] - centre) / focal) @ [1.0, 1.0j]
    shown = shapes[:, at, :2] @ [1.0, 1.0j]
    mean = shown.mean(axis=1, keepdims=True)
    over = ((shown - mean).conj() @ (aim - aim.mean())) / np.square(np.abs(shown - mean)).sum(axis=1)
    nearness = np.clip(np.abs(over) * points[0, 2], 1.0 / EDITS.max_resize, EDITS.max_resize)
    distance = points[0, 2] / nearness
    upright = rotvec_to_rotmat(np.angle(over)[:, None] * np.array([0.0, 0.0, 1.0]))
    turns = upright @ turns
    centred = (mean * np.exp(1j * np.angle(over))[:, None])[:, 0]
    place = aim.mean() * distance - centred
    wrist = np.stack([place.real, place.imag, distance], axis=1) + (
        own.wrist[0] - points[0]
    ) @ turns.swapaxes(1, 2)
    start = own.select(np.zeros(len(turns), dtype=int))
    start = replace(start, root=turns @ own.root, wrist=wrist)
    ray = fitter.chain.points(start).mean(axis=1)
    return replace(start, depth_zero=np.linalg.norm(ray, axis=1))


def _with_neighbours_bends(
    fitter: FastFitter, found: np.ndarray, own: np.ndarray, at: np.ndarray, locked: np.ndarray
) -> np.ndarray:
    """Return angles (1, 5, 9), in radians, in which fingers without a pin beyond their knuckle have those of
    their `own` pose, with long fingers bent as far from it as their neighbours with a pin make likely."""
    known = np.asarray(at[1:].reshape(5, 4)[:, 1:].any(axis=1))
    left = np.asarray(~(known | locked[JOINTS_BY_FINGER].any(axis=1)))
    alike = EDITS.neighbour_bend_share ** np.abs(np.arange(5)[:, None] - np.arange(5))
    alike[0], alike[:, 0], alike[0, 0] = 0.0, 0.0, 1.0  # the thumb goes its own way
    share = alike[left][:, known] @ np.linalg.inv(alike[known][:, known])
    followed = own[0, left]
    bends = [BEND, MIDDLE_BEND, LAST_BEND]
    followed[:, bends] += share @ (found - own)[0][known][:, bends]
    least, most = (end[left] for end in fitter.angle_bounds)
    angles = found.copy()
    angles[0, left] = np.clip(followed, np.minimum(least, own[0, left]), np.maximum(most, own[0, left]))
    return angles
