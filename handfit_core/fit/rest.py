"""Rest told from motion over a clip: how far away the wrist is, and where the palm holds still.

One hand does not change its size, so that its size in the picture tells its distance. But the size that is
seen errs with the pose (closed hands seem up to a quarter too far away), and a hand whose arm rests would
swim to and fro as its fingers move. Over all frames t, with y_t the logarithm of the distance of a frame that
was fitted by itself,

    y_t = l_t + b_t + w . f_t + noise

is solved for the distance, l; for what the fingers' bends f say in every frame alike, w; and for what is left
of the pose's error, b, which can only change while fingers bend or the palm turns. The distance changes about
as fast as it does in the frames around, as the wrist does across the picture, or hardly: how fast is found
together with it, in a few rounds, so that what rests is held and what moves is not held back.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from handfit_core.fit.observation import Observation
from handfit_core.fit.terms.reprojection import NEAREST
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model.chain import State
from handfit_core.skeleton import PALM_KEYPOINTS

NOISE: Final = 0.003
"""of the distance, of every frame by itself"""
ERROR: Final = 0.03
"""of the distance: the pose's error of an open hand"""
ERROR_OF_BENDS: Final = 0.02
"""more of it for each radian that a finger is bent on average"""
OF_A_FINGER: Final = 0.004
"""of the distance: what w may be for a radian that one finger bends"""
BY_BENDS: Final = 0.03
"""of the distance, by how much the pose's error may change for a radian that each finger bends"""
BY_TURNS: Final = 0.04
"""the same for a radian that the palm turns"""
WANDER: Final = 0.0075
"""of the distance, per second, by how much the pose's error changes without any motion"""
STILL: Final = 0.4
"""radians per second that fingers seem to bend, and the palm to turn, when they do not"""
STILL_WRIST: Final = 0.075
"""of the distance, per second, that the wrist seems to move across when it does not"""
SPEED: Final = 0.0175
"""metres per second, of a wrist at rest"""
ACCELERATION: Final = 0.4
"""metres per second squared, of the same"""
FASTEST: Final = (2.0, 10.0)
"""metres per second, and per second squared: no more is expected of hands"""
AROUND: Final = 0.12
"""seconds (standard deviation) over which speeds and accelerations are much the same"""
BRIEF: Final = 0.04
"""seconds (standard deviation) over which what is detected is averaged before its changes count"""
CERTAIN: Final = 1e-4
"""of the distance, where the wrist is at its place"""
ROUNDS: Final = 8
MOST_FPS: Final = 1000.0
"""of clips that say more: what changes from frame to frame would be less than numbers can tell"""
MOVING: Final = 0.01
"""of the hand's size in the picture: a palm whose points stray as far within a quarter of a second moves"""
STILLEST: Final = 0.05
"""of the acceleration of palms that move: what those that hold still are expected to have at the least"""


def palm_motion(seen: Observation, known: np.ndarray, fps: float) -> np.ndarray:
    """(T,) of consecutive frames, `STILLEST` where the palm holds still in the picture, and 1 where it moves
    or where nothing was seen, which `known` (T,) bool says."""
    fps = min(fps, MOST_FPS)
    size = max(float(np.median(np.ptp(seen.pixels, axis=1).max(axis=1))), 1.0)
    palm = seen.pixels[:, list(PALM_KEYPOINTS)] / size
    palm -= palm.mean(axis=0)
    mean, square = (_smooth(p, 2.0 * BRIEF * fps) for p in (palm, palm**2))
    strayed = (square - mean**2).sum(axis=2).mean(axis=1)
    return np.where(known, np.clip(strayed / MOVING**2, STILLEST, 1.0), 1.0)


def wrist_distances(
    state: State, known: np.ndarray, certain: np.ndarray, fps: float, smoothing: float
) -> np.ndarray:
    """(T,) by how much to multiply the wrists' distances from the camera in T consecutive frames.

    `state`: the frames as they were fitted each by itself, in which `known` (T,) bool says where something
    was seen, and `certain` (T,) bool where the wrist is at its place. `smoothing` is the strength.
    """
    from scipy.linalg import solveh_banded

    fps = min(fps, MOST_FPS)
    known = known & ~certain & (state.wrist[:, 2] > NEAREST)
    if not known.any():
        return np.ones(len(known))
    state = replace(state, wrist=np.nan_to_num(state.wrist, nan=1.0))
    y = np.log(np.maximum(state.wrist[:, 2], NEAREST))
    bends = _smooth(state.angles.reshape(len(y), 5, 3, 3)[..., 2].sum(axis=-1), BRIEF * fps)
    error_changes, across = _changes(state, bends, fps)
    anchor = ERROR + ERROR_OF_BENDS * np.maximum(bends.mean(axis=1), 0.0)
    # From here on per frame and in parts of the distance.
    per_frame = 1.0 / (float(np.exp(np.median(y))) * fps)
    fastest, hardest = np.array(FASTEST) * per_frame / [1.0, fps]
    rest, bent = SPEED * per_frame / smoothing, ACCELERATION * per_frame / fps / smoothing
    speed, acceleration = np.full(len(y) - 1, rest), np.full(len(y) - 2, 5.0 * bent)
    features = OF_A_FINGER * bends
    sides = np.column_stack([y, features])
    trust = known / NOISE**2
    distance = y
    for _ in range(ROUNDS):
        band = np.zeros((5, 2 * len(y)))  # LAPACK's lower form; l and b of each frame in turn
        band[1, ::2] = trust
        for first, steps, weight in (
            (0, (1.0,), trust + certain / CERTAIN**2),
            (0, (-1.0, 1.0), speed**-2),
            (0, (1.0, -2.0, 1.0), acceleration**-2),
            (1, (1.0,), trust + anchor**-2),
            (1, (-1.0, 1.0), error_changes**-2),
        ):
            for i, ci in enumerate(steps):
                for j, cj in enumerate(steps[: i + 1]):
                    band[2 * (i - j), first + 2 * j :: 2][: len(weight)] += ci * cj * weight
        right = (trust[:, None] * sides).repeat(2, axis=0)
        right[::2, 0] += certain * y / CERTAIN**2
        try:
            found = solveh_banded(band, right, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            # Numbers that are no hand's: each frame is left where it is.
            return np.ones(len(known))
        # What the bends say of every frame alike is eliminated last: it couples all frames.
        both = found[::2] + found[1::2]
        square = np.eye(5) + features.T @ (trust[:, None] * (features - both[:, 1:]))
        w = np.linalg.solve(square, features.T @ (trust * (y - both[:, 0])))
        distance = found[::2, 0] - found[::2, 1:] @ w
        # Huber's kernel: frames that are far off count less.
        off = np.abs(y - both[:, 0] - (features - both[:, 1:]) @ w) / NOISE
        trust = known / (NOISE**2 * np.maximum(off, 1.0))
        velocity = np.diff(distance)
        around = _smooth(np.clip(velocity, -fastest, fastest) ** 2, AROUND * fps)
        speed = np.sqrt(rest**2 + across**2 + around)
        around = _smooth(np.clip(np.diff(velocity), -hardest, hardest) ** 2, AROUND * fps)
        acceleration = np.sqrt(bent**2 + around)
    return np.exp(distance - y)


def _changes(state: State, bends: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """(T - 1,) by how much the pose's error may change from frame to frame, and how far the wrist moves
    across the picture, in parts of its distance. `bends` (T, 5) radians."""
    from scipy.ndimage import maximum_filter1d

    def beyond(change: np.ndarray, still: float) -> np.ndarray:
        return change**2 / (change + still / fps)

    turned = rotmat_to_rotvec(np.swapaxes(state.root[:-1], -1, -2) @ state.root[1:])
    both = np.stack([np.abs(np.diff(bends, axis=0)).mean(axis=1), np.linalg.norm(turned, axis=1)], axis=1)
    # The error may change a little before and after.
    both = maximum_filter1d(both, 2 * round(2.0 * BRIEF * fps) + 1, axis=0, mode="nearest")
    of_bends, of_turns = beyond(_smooth(both, BRIEF * fps), STILL).T
    error = np.sqrt((BY_BENDS * of_bends) ** 2 + (BY_TURNS * of_turns) ** 2 + (WANDER / fps) ** 2)
    slope = _smooth(state.wrist[:, :2] / np.maximum(state.wrist[:, 2:], NEAREST), BRIEF * fps)
    return error, beyond(np.linalg.norm(np.diff(slope, axis=0), axis=1), STILL_WRIST)


def _smooth(values: np.ndarray, frames: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(values, frames, axis=0, mode="nearest")
