"""Close a hand around a thing: a cylinder or a ball in the palm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS

from .contact import PALM_RADIUS, capsules, penetration, segment_distance
from .kinematics import RightHand, within_limits
from .meshes import Mesh, ball, cylinder

_GIVE = 0.0015
"""metres by which a fingertip gives way to what it holds"""
_STEPS = 45


@dataclass(frozen=True, eq=False)
class Held:
    """A thing in the right hand, model frame, metres."""

    kind: Literal["cylinder", "ball"]
    start: np.ndarray
    """(3,) one end of its axis; for a ball both ends are its centre"""
    end: np.ndarray
    radius: float
    mesh: Mesh

    def gap(self, starts: np.ndarray, ends: np.ndarray, radii: np.ndarray) -> np.ndarray:
        """Distance from its surface to capsules (..., N, 3), (..., N, 3), (N,): (..., N)."""
        start = np.broadcast_to(self.start, starts.shape)
        end = np.broadcast_to(self.end, starts.shape)
        return segment_distance(starts, ends, start, end) - radii - self.radius


def random_grasp(hand: RightHand, rng: np.random.Generator) -> tuple[np.ndarray, Held]:
    """(15, 3) angles of a hand that holds a random thing, and the thing."""
    held = _thing(hand, rng)
    angles = np.zeros((15, 3))
    angles[:, 0] = np.radians(rng.normal(0, 1, 15))
    for finger in FINGERS[1:]:
        _close(hand, angles, finger, held, rng)
    _oppose(hand, angles, held, rng)
    return within_limits(angles), held


def _thing(hand: RightHand, rng: np.random.Generator) -> Held:
    kind: Literal["cylinder", "ball"] = "ball" if rng.random() < 0.35 else "cylinder"
    radius = hand.scale * (rng.uniform(0.024, 0.038) if kind == "ball" else rng.uniform(0.014, 0.033))
    knuckle = hand.keypoints(np.zeros((15, 3)))[9]
    centre = knuckle + np.array(
        [rng.uniform(-0.004, 0.012), -(PALM_RADIUS + 0.004) * hand.scale - radius, 0.0]
    )
    if kind == "ball":
        return Held(kind, centre, centre, radius, ball(radius).moved(np.eye(3), centre))
    tilt = np.radians(rng.uniform(-12, 18))
    axis = np.array([-np.sin(tilt), 0.0, np.cos(tilt)])
    length = rng.uniform(0.12, 0.24)
    centre = centre + axis * rng.uniform(-0.02, 0.03)
    turn = np.stack([np.cross([0.0, 1.0, 0.0], axis), [0.0, 1.0, 0.0], axis], axis=-1)
    reach_ = 0.5 * length * axis
    return Held(kind, centre - reach_, centre + reach_, radius, cylinder(radius, length).moved(turn, centre))


def _close(hand: RightHand, angles: np.ndarray, finger: str, held: Held, rng: np.random.Generator) -> None:
    """Bend one finger from straight until it touches."""
    rows = [j - 1 for j in FINGER_JOINTS[finger]]
    first = 3 * FINGERS.index(finger)
    mine = [first, first + 1, first + 2]
    t = np.linspace(0.0, 1.0, _STEPS)
    full = np.radians([84.0, 98.0, 60.0]) * rng.uniform(0.9, 1.0, 3)
    trials = np.repeat(angles[None], len(t), axis=0)
    trials[:, rows, 2] = t[:, None] * full
    starts, ends, radii = capsules(hand.keypoints(trials), hand.scale)
    touching = (held.gap(starts[:, mine], ends[:, mine], radii[mine]) < -_GIVE).any(axis=1)
    stop = int(touching.argmax()) if touching.any() else len(t)
    angles[rows, 2] = trials[max(stop - 1, 0)][rows, 2]


def _oppose(hand: RightHand, angles: np.ndarray, held: Held, rng: np.random.Generator) -> None:
    """Pose the thumb: of many random poses that whose tip is closest to the thing, outside of it and of the
    fingers."""
    rows = [j - 1 for j in FINGER_JOINTS["thumb"]]
    count = 400
    trials = np.repeat(angles[None], count, axis=0)
    trials[:, rows[0], 0] = np.radians(rng.uniform(-8, 8, count))
    trials[:, rows[0], 1] = np.radians(rng.uniform(-12, 20, count))
    trials[:, rows, 2] = np.radians(rng.uniform([-15, -5, 0], [32, 50, 60], (count, 3)))
    points = hand.keypoints(trials)
    starts, ends, radii = capsules(points, hand.scale)
    gaps = held.gap(starts[:, :3], ends[:, :3], radii[:3])
    cuts = np.maximum(-gaps.min(axis=1) - _GIVE, 0.0) + np.maximum(
        penetration(points, hand.scale) - 0.002, 0.0
    )
    best = int((np.abs(gaps[:, 2]) + 5.0 * cuts).argmin())
    angles[rows] = trials[best][rows]
