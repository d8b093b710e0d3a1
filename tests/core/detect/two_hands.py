"""Painted clips of two hands of one person that meet; the same numbers paint the same clip."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.skeleton import SIDES, Side
from scripts.benchmark.arm import build_arm, forearm_direction
from scripts.benchmark.kinematics import RightHand, hand_pose_from_angles, model_of, within_limits
from scripts.benchmark.people import random_betas
from scripts.benchmark.poses import random_pose
from scripts.benchmark.shots import FPS, Shot, ShotHand
from tests.core.detect.painter import paint

SIZE: Final = 512
"""pixels a side"""
FRAMES: Final = 75
PERIOD: Final = 50
"""Frames from one crossing to the second next"""
AWAY: Final = 0.6
"""metres from the camera to the middle between the hands"""

INWARDS: Final = {"right": np.array([1.0, 0.0, 0.0]), "left": np.array([-1.0, 0.0, 0.0])}
"""Of a person who faces the camera; x to the picture's right, y down, z away"""

UP, AHEAD = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class Way:
    """How one hand moves, over T frames."""

    fingers: np.ndarray
    """(T, 3) where they point"""
    back: np.ndarray
    """(T, 3) where the hand's back looks"""
    palm: np.ndarray
    """(T, 3) metres, where its middle is"""
    pose: str = "relaxed"
    bend: np.ndarray | float = 0.0
    """(T,) radians that all knuckles are bent more"""


def _cross(side: Side, t: np.ndarray, rng: np.random.Generator) -> Way:
    """Each goes to the other's place, and back."""
    depth = 0.035 * (1 if side == "left" else -1)
    palm = -0.14 * np.cos(2 * np.pi * t / PERIOD)[:, None] * INWARDS[side] + [0.0, rng.normal(0, 0.01), depth]
    return Way(UP + rng.normal(0, 0.25, 3), rng.choice([-1, 1]) * AHEAD, palm)


def _roam(side: Side, t: np.ndarray, rng: np.random.Generator) -> Way:
    """Both move about widely, each on its own way, which often cross."""
    depth = 0.06 * (1 if side == "left" else -1)
    turns, phases = PERIOD * rng.uniform(0.6, 1.4, (3, 2)), rng.uniform(0, 2 * np.pi, (3, 2))
    waves = np.sin(2 * np.pi * t[:, None, None] / turns + phases).mean(axis=1)
    palm = np.column_stack([0.35 * waves, np.full(len(t), depth)]) - 0.06 * INWARDS[side]
    return Way(UP + rng.normal(0, 0.3, 3), rng.choice([-1, 1]) * AHEAD, palm)


KINDS: Final[dict[str, tuple[Callable[[Side, np.ndarray, np.random.Generator], Way], int]]] = {
    "cross": (_cross, 0),
    "roam": (_roam, 7),
}
"""How the hands move, and what each clip's seed begins with"""


def clip(
    kind: str, seed: int, frames: int = FRAMES, size: int = SIZE, fps: float = FPS, away: float = AWAY
) -> Shot:
    """Two hands over `frames` key frames, which are its pictures, so many metres from the camera."""
    rng = np.random.default_rng([seed, KINDS[kind][1]])
    betas = random_betas(rng)
    # From the front, or over the person's own shoulder; a little from the side.
    turn = np.pi * (rng.random() < 0.4) + rng.normal(0, 0.35)
    camera_turn = rotvec_to_rotmat(np.array([rng.normal(0, 0.2), 0.0, 0.0])) @ rotvec_to_rotmat(
        np.array([0.0, turn, 0.0])
    )
    t = np.arange(frames) * FPS / fps
    hands = []
    for side in SIDES:
        way = KINDS[kind][0](side, t, rng)
        fingers, back, palm = (
            np.broadcast_to(v, (frames, 3)) @ camera_turn.T for v in (way.fingers, way.back, way.palm)
        )
        hands.append(_hand(side, betas, replace(way, fingers=fingers, back=back, palm=palm), t, away, rng))
    return Shot(
        files=tuple(f"{kind}/{seed}/{n:04d}" for n in range(frames)),
        clip=None,
        size=size,
        camera=Intrinsics(1.1 * size, 1.1 * size, size / 2, size / 2),
        hands=tuple(hands),
        props=(),
        surroundings=np.tile(np.eye(4), (frames, 1, 1)),
        tags=({},) * frames,
        look_seed=(seed, 99),
    )


def _hand(
    side: Side, betas: np.ndarray, way: Way, t: np.ndarray, away: float, rng: np.random.Generator
) -> ShotHand:
    model = model_of(side)
    shaped = model.shaped(betas)
    along = way.fingers / np.linalg.norm(way.fingers, axis=1, keepdims=True)
    up = way.back - (way.back * along).sum(axis=1, keepdims=True) * along
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    # The model's fingers point to -x (right) or x (left), its back to y.
    x = along if side == "left" else -along
    trembling = rotvec_to_rotmat(0.04 * np.sin(t[:, None] / 6.0 + rng.uniform(0, 6, 3)))
    rotation = trembling @ np.stack([x, up, np.cross(x, up)], axis=-1)
    angles = np.repeat(random_pose(way.pose, RightHand(betas), rng)[None], len(x), axis=0)
    angles[:, [0, 3, 6, 9], 2] += np.broadcast_to(way.bend, len(x))[:, None]
    angles[:, :, 2] += 0.08 * np.sin(t[:, None] / 8.0 + rng.uniform(0, 6, 15))
    middle = (shaped.joints[4] - shaped.joints[0]) / 2.0
    centre = np.array([0.0, 0.0, away]) + way.palm
    flexion, deviation = np.clip(rng.normal(0, [0.3, 0.12]), -0.6, 0.6)
    direction = forearm_direction(flexion, deviation, side)
    sleeve = (rng.uniform(0.0, 0.1), rng.uniform(0.004, 0.012)) if rng.random() < 0.6 else None
    return ShotHand(
        side,
        betas,
        rotmat_to_rotvec(rotation),
        hand_pose_from_angles(within_limits(angles), side),
        centre - rotation @ middle - shaped.joints[0],
        build_arm(shaped, side, direction, sleeve),
    )


def pictures(shot: Shot) -> Iterator[np.ndarray]:
    """(size, size, 3) uint8 RGB, one after the other; light, colours and background stay."""
    for t in range(len(shot.files)):
        now = [
            replace(h, **{k: getattr(h, k)[t : t + 1] for k in ("global_orient", "hand_pose", "transl")})
            for h in shot.hands
        ]
        yield paint(replace(shot, hands=tuple(now)), np.random.default_rng(shot.look_seed))
