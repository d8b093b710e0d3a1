"""A moving hand on its forearm, seen by two still cameras of other lenses that started at different times.

Written as `handfit_core.evaluate.views` reads it. Each camera has a background and lamps of its own, motion
blur, and a sensor that is read line by line.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from typing import Any, Final

import numpy as np

from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat

from .clips import clip_shot
from .kinematics import model_of
from .shots import FPS, Shot, ShotHand, matrix_of, rounded
from .views import intrinsics_of, stand_off

FOLDER: Final = "pairs"
TRUTH: Final = "gt.json"
PAIRS: Final = 2
"""The kind in a pair's seed, beside `stills.STILLS` and `clips.CLIPS`"""
FOCAL_MM: Final = (18.0, 34.0)
"""Full-frame equivalent: webcams and telephones"""
APART: Final = (30.0, 90.0)
"""degrees between the lines of sight to the hand"""
READOUT: Final = 0.5
"""Share of a frame's time between the first and the last line of a picture"""
_LATEST: Final = 12.0
"""frames from one camera's start to the other's, at most"""
_LEAD: Final = 14
_NEAREST: Final = 0.12
"""metres from a camera to the axis of the forearm, at least"""
_AHEAD: Final = np.array([0.0, 0.0, 1.0])


def pair_shots(seed: int, number: int, frames: int, size: int) -> tuple[Shot, Shot, dict[str, Any]]:
    """Both cameras' clips of that number, always the same, and their entry in `gt.json`."""
    rng = np.random.default_rng([seed, PAIRS, number])
    drawn = (_draw(rng, number, frames, size) for _ in count())
    return next(filter(None, drawn))


def _draw(
    rng: np.random.Generator, number: int, frames: int, size: int
) -> tuple[Shot, Shot, dict[str, Any]] | None:
    shot = clip_shot(int(rng.integers(2**31)), 0, frames + 2 * _LEAD, size)
    if len(shot.hands) != 1 or shot.tags[0]["camera"] != "usual":
        return None
    hand = shot.hands[0]
    offset = float(rng.uniform(-_LATEST, _LATEST))
    apart = float(rng.uniform(*APART))
    # Mostly beside the first camera, at its height, and as level.
    axis = np.array([*rng.normal(0.0, 0.25, 1), rng.choice([-1.0, 1.0]), 0.0])
    turn = rotvec_to_rotmat(np.radians(apart) * axis / np.linalg.norm(axis))
    rotation = rotvec_to_rotmat(rng.normal(0.0, 0.1) * _AHEAD) @ turn
    seen: list[Shot] = []
    places = []
    rows = np.arange(frames + 2) + _LEAD
    for view, turned, late in (("a", np.eye(3), 0.0), ("b", rotation, offset)):
        camera = intrinsics_of(float(rng.uniform(*FOCAL_MM)), size)
        points = hand.keypoints().reshape(-1, 3) @ turned.T
        place = stand_off(points, camera, _AHEAD, float(rng.uniform(0.6, 0.9)))
        if place is None:
            return None
        moved = _seen_from(hand, rows + late, turned, place)
        if _nearest_to_arm(moved) < _NEAREST:
            return None
        name = f"{FOLDER}/clip{number}_{view}"
        seen.append(
            replace(
                shot,
                files=tuple(f"{name}/{t:04d}.jpg" for t in range(1, frames + 1)),
                clip=name,
                camera=camera,
                hands=(moved,),
                props=(),
                surroundings=np.tile(np.eye(4), (len(rows), 1, 1)),
                tags=shot.tags[:frames],
                readout=READOUT,
            )
        )
        places.append(place)
    truth = {
        "clip": f"clip{number}",
        "side": hand.side,
        "fps": FPS,
        "offset": offset / FPS,
        "apart_degrees": apart,
        "K_a": matrix_of(seen[0].camera),
        "K_b": matrix_of(seen[1].camera),
        "R": rotation.tolist(),
        "t": (places[1] - rotation @ places[0]).tolist(),
        "joints3d": rounded(seen[0].hands[0].keypoints()[1:-1], 8),
    }
    return seen[0], seen[1], truth


def _seen_from(hand: ShotHand, rows: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> ShotHand:
    """The hand at fractional rows (F,) of its motion, after p -> rotation p + translation."""
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    times = np.arange(len(hand.transl))
    wrist = model_of(hand.side).shaped(hand.betas).joints[0]
    orient = RotationSpline(times, Rotation.from_rotvec(hand.global_orient))(rows).as_matrix()
    at = CubicSpline(times, hand.transl + wrist)(rows)
    return replace(
        hand,
        global_orient=rotmat_to_rotvec(rotation @ orient),
        hand_pose=CubicSpline(times, hand.hand_pose)(rows),
        transl=at @ rotation.T + translation - wrist,
    )


def _nearest_to_arm(hand: ShotHand) -> float:
    """metres from the camera to the axis of the forearm, over all rows."""
    assert hand.arm is not None
    wrist = model_of(hand.side).shaped(hand.betas).joints[0]
    turned = (hand.arm.axis - wrist) @ rotvec_to_rotmat(hand.global_orient).swapaxes(1, 2)
    return float(np.linalg.norm(turned + (hand.transl + wrist)[:, None], axis=2).min())
