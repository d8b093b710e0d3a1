"""Who and what is in a picture before the camera is there: shapes, poses, arms, and two hands together.

They stand in the first hand's model frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from handfit_core.common.skeleton import Side, other_side
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import ShapedHand

from .arm import Arm, build_arm, forearm_direction
from .contact import Capsules, capsules, clearance, gap
from .grasp import Held, random_grasp
from .kinematics import RightHand, hand_pose_from_angles, model_of
from .poses import POSES, random_pose
from .views import random_direction

_MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Placed:
    """One hand, turned about its wrist and then moved."""

    side: Side
    kind: str
    """A key of `POSES`, or `grasp`"""
    betas: np.ndarray
    """(10,)"""
    shaped: ShapedHand
    pose: np.ndarray
    """(45,)"""
    own_points: np.ndarray
    """(21, 3) keypoints in its own model frame"""
    scale: float
    arm: Arm
    elbow: np.ndarray
    """(3,) direction from wrist to elbow, its own model frame"""
    rotation: np.ndarray
    """(3, 3) from its model frame"""
    translation: np.ndarray
    """(3,): p -> rotation (p - wrist) + wrist + translation"""
    held: Held | None = None

    def carried(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) from its model frame to where it stands."""
        wrist = self.shaped.joints[0]
        return (points - wrist) @ self.rotation.T + wrist + self.translation

    @property
    def points(self) -> np.ndarray:
        """(21, 3) keypoints where it stands."""
        return self.carried(self.own_points)


def random_betas(rng: np.random.Generator) -> np.ndarray:
    """(10,) shape: the open hand's betas have unit variance; nobody beyond two."""
    return np.clip(rng.normal(size=10), -2.0, 2.0)


def random_hand(
    side: Side, betas: np.ndarray, rng: np.random.Generator, *, kinds: tuple[str, ...] = tuple(POSES)
) -> Placed:
    """A hand at rest in its own model frame, in a pose of one of the `kinds` (also "grasp")."""
    right = RightHand(betas)
    kind = kinds[rng.integers(len(kinds))]
    held = None
    if kind == "grasp":
        angles, held = random_grasp(right, rng)
        if side == "left":
            held = _mirrored(held)
    else:
        angles = random_pose(kind, right, rng)
    model = model_of(side)
    shaped = model.shaped(betas)
    pose = hand_pose_from_angles(angles, side)
    flexion = float(np.clip(rng.normal(0, np.radians(20)), -0.8, 0.8))
    deviation = float(np.clip(rng.normal(0, np.radians(8)), -0.3, 0.3))
    elbow = forearm_direction(flexion, deviation, side)
    sleeve = (rng.uniform(-0.004, 0.10), rng.uniform(0.004, 0.012)) if rng.random() < 0.6 else None
    return Placed(
        side=side,
        kind=kind,
        betas=betas,
        shaped=shaped,
        pose=pose,
        own_points=model.keypoints(betas, np.zeros(3), pose, np.zeros(3)),
        scale=right.scale,
        arm=build_arm(shaped, side, elbow, sleeve),
        elbow=elbow,
        rotation=np.eye(3),
        translation=np.zeros(3),
        held=held,
    )


def _mirrored(held: Held) -> Held:
    polygons = tuple(tuple(reversed(p)) for p in held.mesh.polygons)
    mesh = replace(held.mesh, vertices=held.mesh.vertices * _MIRROR, polygons=polygons)
    return replace(held, start=held.start * _MIRROR, end=held.end * _MIRROR, mesh=mesh)


def beside(first: Placed, second: Placed, apart: float, rng: np.random.Generator) -> Placed | None:
    """The second hand (of the other side) near the first, `apart` metres away; None where arms collide."""
    assert second.side == other_side(first.side)
    # Turned half about the back's direction both hands' fingers point the same way.
    both_ahead = np.diag([-1.0, 1.0, -1.0])
    if rng.random() < 0.3:
        angle = rng.uniform(0, np.pi)
        turn = rotvec_to_rotmat(angle * random_direction(rng))
    else:
        turn = rotvec_to_rotmat(rng.normal(0, 0.45, 3))
    rotation = turn @ both_ahead
    direction = random_direction(rng)
    if rng.random() < 0.7:
        direction = direction * 0.4 + np.array([0.0, 0.0, 1.0])
    direction /= np.linalg.norm(direction)
    turned = replace(second, rotation=rotation, translation=np.zeros(3))
    start = first.points.mean(axis=0) - turned.points.mean(axis=0)
    for distance in np.arange(0.03, 0.40, 0.008):
        placed = replace(turned, translation=start + distance * direction)
        if clearance(first.points, placed.points, first.scale) >= apart:
            return None if _arms_collide(first, placed) else placed
    return None


def arm_capsules(hand: Placed) -> Capsules:
    """Its forearm as capsules where it stands."""
    axis = hand.carried(hand.arm.axis[8:])
    return axis[:-1], axis[1:], hand.arm.radii[9:]


def _arms_collide(first: Placed, second: Placed) -> bool:
    a, b = arm_capsules(first), arm_capsules(second)
    hands = [capsules(hand.points, hand.scale) for hand in (first, second)]
    return any(gap(*pair) < 0.0 for pair in ((a, hands[1]), (b, hands[0]), (a, b)))
