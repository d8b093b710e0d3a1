"""Stationary detection over a clip: how far away the wrist is, and where the palm holds still.

One hand does not change its size, so its size in the picture gives its distance. But the observed size errs
with the pose (closed hands seem up to a quarter too far away), so that a hand whose arm rests would swim to
and fro as its fingers move. Over all frames t, with y_t the logarithm of the distance of a frame that was
fitted by itself,

    y_t = l_t + b_t + w . f_t + noise

is solved for the distance l, for the error w . f_t that depends on the fingers' bends f alike in every frame,
and for the rest b of the pose's error, which can only change while fingers bend or the palm turns. The
distance is expected to change as fast as in the frames around, as the wrist moves across the picture, or at
the speed of a wrist at rest. That speed is estimated together with it, in a few rounds, so that resting
wrists are held and moving ones are not held back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.common.skeleton import PALM_KEYPOINTS
from handfit_core.fit.banded import solve_bordered
from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import MOTION, TERMS
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model.chain import State


@dataclass(frozen=True)
class DistanceModel:
    """Standard deviations of the module's model of the wrist's distance. "Relative" values are parts of that
    distance."""

    noise: float = 0.003
    """relative: the noise of each frame on its own"""
    pose_error: float = 0.03
    """relative: the pose's error b for an open hand"""
    pose_error_per_bend: float = 0.02
    """relative: how much larger the pose's error b is for each radian that a finger is bent on average"""
    bend_weight: float = 0.004
    """relative: the weight w for each radian that one finger bends"""
    change_per_bend: float = 0.03
    """relative: a change of the pose's error b for each radian that all fingers bend"""
    change_per_turn: float = 0.04
    """relative: a change of the pose's error b for each radian that the palm turns"""
    drift: float = 0.0075
    """relative, per second: a change of the pose's error b while nothing moves"""
    still_angles: float = 0.4
    """radians per second at which the fingers of a still hand seem to bend, and its palm to turn"""
    still_wrist: float = 0.075
    """relative, per second: the speed at which a still wrist seems to move across the picture"""
    rest_speed: float = 0.0175
    """metres per second: the speed of a wrist at rest"""
    rest_acceleration: float = 0.4
    """metres per second squared: the acceleration of a wrist at rest"""
    max_speed: float = 2.0
    """metres per second that are expected of a hand at most"""
    max_acceleration: float = 10.0
    """metres per second squared that are expected of a hand at most"""
    steady_seconds: float = 0.12
    """seconds: standard deviation of the window in which speeds and accelerations hardly change"""
    smoothing_seconds: float = 0.04
    """seconds: standard deviation of the window over which detections are averaged before they are
    differentiated"""
    known_distance: float = 1e-4
    """relative: the error of the distance where the wrist's place is known"""
    rounds: int = 8


MODEL: Final = DistanceModel()


def palm_motion_scale(seen: Observation, known: np.ndarray, fps: float) -> np.ndarray:
    """Return factors (T,) of the palm's expected rotational acceleration in T consecutive frames.

    They are `min_scale` where the palm holds still in the picture, 1 where it moves, and 1 where `known` (T,)
    bool is false, as nothing was seen there.
    """
    fps = min(fps, MOTION.max_fps)
    size = max(float(np.median(np.ptp(seen.pixels, axis=1).max(axis=1))), 1.0)
    palm = seen.pixels[:, list(PALM_KEYPOINTS)] / size
    palm -= palm.mean(axis=0)
    mean, square = (_smooth(p, 2.0 * MODEL.smoothing_seconds * fps) for p in (palm, palm**2))
    strayed = (square - mean**2).sum(axis=2).mean(axis=1)
    return np.where(known, np.clip(strayed / MOTION.palm_motion**2, MOTION.min_scale, 1.0), 1.0)


def wrist_distance_factors(
    state: State, known: np.ndarray, certain: np.ndarray, fps: float, smoothing: float
) -> np.ndarray:
    """Return the factors (T,) by which the wrists' distances from the camera are to be multiplied in T
    consecutive frames.

    `state`: the frames, each fitted by itself. `known` (T,) bool: frames with a detection. `certain` (T,)
    bool: frames whose wrist is in its true place. `smoothing`: the strength, 0 for none. `fps`: frames per
    second.
    """
    fps = min(fps, MOTION.max_fps)
    known = known & ~certain & (state.wrist[:, 2] > TERMS.nearest)
    if not known.any():
        return np.ones(len(known))
    state = replace(state, wrist=np.nan_to_num(state.wrist, nan=1.0))
    y = np.log(np.maximum(state.wrist[:, 2], TERMS.nearest))
    bends = _smooth(state.angles.reshape(len(y), 5, 3, 3)[..., 2].sum(axis=-1), MODEL.smoothing_seconds * fps)
    error_changes, across = _changes(state, bends, fps)
    anchor = MODEL.pose_error + MODEL.pose_error_per_bend * np.maximum(bends.mean(axis=1), 0.0)
    # From here on, speeds are per frame and relative to the distance.
    per_frame = 1.0 / (float(np.exp(np.median(y))) * fps)
    max_step, max_change = np.array([MODEL.max_speed, MODEL.max_acceleration]) * per_frame / [1.0, fps]
    rest_step, rest_change = (
        MODEL.rest_speed * per_frame / smoothing,
        MODEL.rest_acceleration * per_frame / fps / smoothing,
    )
    speed, acceleration = np.full(len(y) - 1, rest_step), np.full(len(y) - 2, 5.0 * rest_change)
    features = MODEL.bend_weight * bends
    trust = known / MODEL.noise**2
    distance = y
    for _ in range(MODEL.rounds):
        band = np.zeros((5, 2 * len(y)))  # LAPACK's lower form; l and b of each frame in turn
        band[1, ::2] = trust
        for first, steps, weight in (
            (0, (1.0,), trust + certain / MODEL.known_distance**2),
            (0, (-1.0, 1.0), speed**-2),
            (0, (1.0, -2.0, 1.0), acceleration**-2),
            (1, (1.0,), trust + anchor**-2),
            (1, (-1.0, 1.0), error_changes**-2),
        ):
            for i, ci in enumerate(steps):
                for j, cj in enumerate(steps[: i + 1]):
                    band[2 * (i - j), first + 2 * j :: 2][: len(weight)] += ci * cj * weight
        right = (trust * y).repeat(2)
        right[::2] += certain * y / MODEL.known_distance**2
        # w couples all frames.
        weighted = trust[:, None] * features
        border, corner = weighted.repeat(2, axis=0), np.eye(5) + features.T @ weighted
        try:
            found, w = solve_bordered(band, right, border, corner, weighted.T @ y)
        except np.linalg.LinAlgError:
            # The numbers are no hand's: leave each frame where it is.
            return np.ones(len(known))
        distance = found[::2]
        # Huber's kernel: outliers count less.
        off = np.abs(y - distance - found[1::2] - features @ w) / MODEL.noise
        trust = known / (MODEL.noise**2 * np.maximum(off, 1.0))
        velocity = np.diff(distance)
        around = _smooth(np.clip(velocity, -max_step, max_step) ** 2, MODEL.steady_seconds * fps)
        speed = np.sqrt(rest_step**2 + across**2 + around)
        around = _smooth(np.clip(np.diff(velocity), -max_change, max_change) ** 2, MODEL.steady_seconds * fps)
        acceleration = np.sqrt(rest_change**2 + around)
    return np.exp(distance - y)


def _changes(state: State, bends: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays (T - 1,) of changes from frame to frame, relative to the distance: the expected
    change of b, and how far the wrist moves across the picture. `bends` (T, 5): radians that each finger is
    bent."""
    from scipy.ndimage import maximum_filter1d  # slow to load

    def beyond(change: np.ndarray, still: float) -> np.ndarray:
        return change**2 / (change + still / fps)

    turned = rotmat_to_rotvec(np.swapaxes(state.root[:-1], -1, -2) @ state.root[1:])
    both = np.stack([np.abs(np.diff(bends, axis=0)).mean(axis=1), np.linalg.norm(turned, axis=1)], axis=1)
    # The error may change a little before and after.
    both = maximum_filter1d(both, 2 * round(2.0 * MODEL.smoothing_seconds * fps) + 1, axis=0, mode="nearest")
    of_bends, of_turns = beyond(_smooth(both, MODEL.smoothing_seconds * fps), MODEL.still_angles).T
    error = np.sqrt(
        (MODEL.change_per_bend * of_bends) ** 2
        + (MODEL.change_per_turn * of_turns) ** 2
        + (MODEL.drift / fps) ** 2
    )
    slope = _smooth(
        state.wrist[:, :2] / np.maximum(state.wrist[:, 2:], TERMS.nearest), MODEL.smoothing_seconds * fps
    )
    return error, beyond(np.linalg.norm(np.diff(slope, axis=0), axis=1), MODEL.still_wrist)


def _smooth(values: np.ndarray, frames: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter1d  # slow to load

    return gaussian_filter1d(values, frames, axis=0, mode="nearest")
