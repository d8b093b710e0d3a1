"""The forearm that a hand sits on, and a sleeve: tubes that start at the mesh's open wrist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import ShapedHand
from handfit_core.hand_model.forearm import wrist_ring

from .kinematics import model_of
from .meshes import Mesh, tube

LENGTH: Final = 0.6
"""metres; long enough to leave the picture"""
_BEND: Final = 0.06
"""metres behind the wrist over which the arm turns into its own direction"""


@dataclass(frozen=True, eq=False)
class Arm:
    """A forearm in the hand's model frame, metres; it moves with the wrist."""

    axis: np.ndarray
    """(N, 3) points along its middle"""
    radii: np.ndarray
    """(N,)"""
    skin: Mesh
    sleeve: Mesh | None


def forearm_direction(flexion: float, deviation: float, side: Side) -> np.ndarray:
    """(3,) unit vector from the wrist to the elbow, model frame; angles in radians, as a right hand's."""
    turn = rotvec_to_rotmat(np.array([0.0, deviation, 0.0])) @ rotvec_to_rotmat(np.array([0.0, 0.0, flexion]))
    direction = turn @ np.array([1.0, 0.0, 0.0])
    return direction if side == "right" else direction * np.array([-1.0, 1.0, 1.0])


def build_arm(
    shaped: ShapedHand, side: Side, direction: np.ndarray, sleeve: tuple[float, float] | None
) -> Arm:
    """The arm of a hand whose forearm points along `direction` (3,).

    sleeve: where it starts behind the wrist and how wide it stands off, metres; None is a bare arm.
    """
    edge = shaped.vertices[wrist_ring(model_of(side).polygons)]
    centre = edge.mean(axis=0)
    back = np.array([1.0 if side == "right" else -1.0, 0.0, 0.0])
    s = np.concatenate([np.linspace(0.0, _BEND, 9), np.linspace(_BEND, LENGTH, 12)[1:]])
    axis, frames = _course(centre, back, direction, s)

    offsets = edge - centre
    depth = offsets @ back
    flat = offsets - np.outer(depth, back)
    angle = np.arctan2(flat @ frames[0, :, 1], flat @ frames[0, :, 2])
    size = float(np.linalg.norm(flat, axis=1).mean())
    blend = np.clip(s / 0.05, 0.0, 1.0)
    blend = blend**2 * (3 - 2 * blend)
    # Flat at the wrist, round and thick towards the elbow.
    grown = size + (1.35 * size - size) * np.clip(s / 0.22, 0.0, 1.0) ** 1.2
    squash = 1 - 0.22 * (1 - np.clip(s / 0.2, 0.0, 1.0))

    def ring(i: int, wider: float) -> np.ndarray:
        up, across = frames[i, :, 1], frames[i, :, 2]
        circle = squash[i] * np.outer(np.sin(angle), up) + np.outer(np.cos(angle), across)
        own = flat @ frames[0] @ frames[i].T * (1 + wider / size) + np.outer(depth, frames[i, :, 0])
        return axis[i] + (1 - blend[i]) * own + blend[i] * ((grown[i] + wider) * circle)

    def rings(wider: np.ndarray) -> np.ndarray:
        return np.array([ring(i, wider[i]) for i in range(len(s))])

    skin_rings = rings(np.zeros(len(s)))
    cover = None
    if sleeve is not None:
        start, wide = sleeve
        outside = rings(wide + 0.04 * np.maximum(s - start, 0.0))
        keep = s >= start
        # The hem is turned in, so that the sleeve has a thickness.
        first = int(keep.argmax())
        hem = skin_rings[first] + 0.35 * (outside[first] - skin_rings[first])
        cover = tube(np.concatenate([hem[None], outside[keep]]), closed=False)
    return Arm(axis, grown, tube(skin_rings, closed=False), cover)


def _course(
    start: np.ndarray, back: np.ndarray, direction: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) and frames (N, 3, 3; columns along, up, across) of a bend from `back` to `direction`."""
    turn = np.cross(back, direction)
    sine = float(np.linalg.norm(turn))
    angle = float(np.arctan2(sine, back @ direction))
    turn = turn / sine if sine > 1e-9 else np.array([0.0, 0.0, 1.0])
    up = np.array([0.0, 1.0, 0.0])
    first = np.stack([back, up, np.cross(back, up)], axis=-1)
    parts = np.clip(s / _BEND, 0.0, 1.0)
    frames = rotvec_to_rotmat(parts[:, None] * angle * turn) @ first
    steps = np.diff(s)[:, None] * 0.5 * (frames[1:, :, 0] + frames[:-1, :, 0])
    return start + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), frames
