"""Single pictures: one or two hands, whole or cut by the frame, with or without things before them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Final

import numpy as np

from handfit_core.common.skeleton import SIDES, other_side
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat

from .contact import Capsules, capsules
from .meshes import Mesh, ball, box, cylinder, mug, pen
from .people import Placed, arm_capsules, beside, random_betas, random_hand
from .poses import POSES
from .shots import Shot, ShotHand
from .views import (
    COVERAGE,
    Placement,
    covered_by,
    hidden_by,
    intrinsics_of,
    lens_tags,
    random_direction,
    random_focal_mm,
    random_standpoint,
    view_name,
)

STILLS: Final = 0
"""The kind in a still's seed; `clips.CLIPS` is the other"""
_MOST_HIDDEN: Final = 9
"""Number of a hand's 21 keypoints that may be behind an arm or the other hand"""
KINDS: Final = tuple(POSES)
"""Kinds of poses; with another kind, the same seeds would give other pictures"""


def still_shot(seed: int, number: int, size: int) -> Shot:
    """The still of that number, always the same: it depends on nothing but these three.

    Focal length, distance and place are scaled with `size` (pixels a side), so that the labels in
    millimetres are the same in every size.
    """
    rng = np.random.default_rng([seed, STILLS, number])
    return next(filter(None, (_draw(rng, seed, number, size) for _ in count())))


def _draw(rng: np.random.Generator, seed: int, number: int, size: int) -> Shot | None:
    hands = _hands(rng)
    if hands is None:
        return None
    cut = len(hands) == 1 and rng.random() < 0.18
    focal_mm = random_focal_mm(rng)
    camera = intrinsics_of(focal_mm, size)
    points = np.concatenate([hand.points for hand in hands])
    coverage = rng.uniform(max(COVERAGE[0], 0.45 if cut else 0.6 if len(hands) > 1 else 0.0), COVERAGE[1])
    for _ in range(30):
        standpoint, view, roll = random_standpoint([hand.rotation @ hand.elbow for hand in hands], rng)
        wanted = Placement(points, view, roll, camera, coverage)
        placed = wanted.cut(rng) if cut else wanted.whole(rng)
        if placed is not None and not _hides_too_much(hands, *placed):
            break
    else:
        return None
    rotation, translation = placed

    seen = [hand.points @ rotation.T + translation for hand in hands]
    if hands[0].held is not None:
        occluder, props = f"held {hands[0].held.kind}", (hands[0].held.mesh.moved(rotation, translation),)
        if props[0].vertices[:, 2].min() < 0.03:
            return None
    else:
        nearest = float(min(p[:, 2].min() for p in seen))
        occluder, props = random_occluder(seen[0], camera, nearest, rng)
    # `view` is in the first hand's frame, where both stand.
    tags = {
        "pose": hands[0].kind,
        "hands": "one" if len(hands) == 1 else "two",
        "occluder": occluder,
        "framing": "cut" if cut else "whole",
        "view": view_name(view, hands[0].side),
        "camera": standpoint,
        **lens_tags(focal_mm),
    }
    return Shot(
        files=(f"stills/{number:05d}.jpg",),
        clip=None,
        size=size,
        camera=camera,
        hands=tuple(shot_hand(h, rotation[None], translation[None]) for h in hands),
        props=props,
        surroundings=np.eye(4)[None],
        tags=(tags,),
        look_seed=(seed, STILLS, number, 1),
    )


def _hands(rng: np.random.Generator) -> list[Placed] | None:
    side = SIDES[rng.integers(2)]
    betas = random_betas(rng)
    if rng.random() >= 0.2:
        return [random_hand(side, betas, rng, kinds=(*KINDS, "grasp"))]
    first = random_hand(side, betas, rng, kinds=KINDS)
    other = random_hand(other_side(side), betas, rng, kinds=KINDS)
    second = beside(first, other, rng.uniform(0.003, 0.05), rng)
    return None if second is None else [first, second]


def shot_hand(hand: Placed, rotations: np.ndarray, translations: np.ndarray) -> ShotHand:
    """A hand seen by a camera that is p -> R p + t, for F rows (F, 3, 3) and (F, 3)."""
    wrist = hand.shaped.joints[0]
    at = (wrist + hand.translation) @ np.swapaxes(rotations, -1, -2) + translations
    return ShotHand(
        side=hand.side,
        betas=hand.betas,
        global_orient=rotmat_to_rotvec(rotations @ hand.rotation),
        hand_pose=np.repeat(hand.pose[None], len(rotations), axis=0),
        transl=at - wrist,
        arm=hand.arm,
    )


COVERED: Final = (2, 9)
"""Least and largest number of the 21 keypoints that a prop may hide"""

OCCLUDERS: Final[dict[str, Callable[[np.random.Generator], Mesh]]] = {
    "pen": lambda rng: pen(rng.uniform(0.004, 0.009), rng.uniform(0.12, 0.18)),
    "ball": lambda rng: ball(rng.uniform(0.015, 0.035)),
    "box": lambda rng: box(rng.uniform(0.02, 0.08, 3)),
    "mug": lambda rng: mug(rng.uniform(0.034, 0.043), rng.uniform(0.08, 0.10)),
    "can": lambda rng: cylinder(rng.uniform(0.025, 0.035), rng.uniform(0.09, 0.14)),
}
"""Name -> a prop of random size, at the origin"""


def random_occluder(
    points: np.ndarray, camera: Intrinsics, nearest: float, rng: np.random.Generator
) -> tuple[str, tuple[Mesh, ...]]:
    """The name of a prop and the prop, in front of some of a hand's keypoints (21, 3); "none" in seven of ten
    pictures, and where none fits.

    nearest: depth in metres that the hands do not come below; the prop stays before it.
    """
    pixels = camera.project(points)
    for _ in range(40 if rng.random() < 0.3 else 0):
        name = list(OCCLUDERS)[rng.integers(len(OCCLUDERS))]
        turn = rotvec_to_rotmat(rng.uniform(0, np.pi) * random_direction(rng))
        prop = OCCLUDERS[name](rng).moved(turn, np.zeros(3))
        behind = float(prop.vertices[:, 2].max())
        depth = nearest - 0.012 - behind - rng.uniform(0.0, 0.03)
        towards = points[rng.integers(len(points))] + rng.normal(0, 0.015, 3)
        if depth + float(prop.vertices[:, 2].min()) < max(0.03, 0.3 * towards[2]):
            continue
        prop = prop.moved(np.eye(3), towards * depth / towards[2])
        if COVERED[0] <= covered_by(pixels, camera.project(prop.vertices)) <= COVERED[1]:
            return name, (prop,)
    return "none", ()


def _hides_too_much(hands: list[Placed], rotation: np.ndarray, translation: np.ndarray) -> bool:
    """True if arms or the other hand hide most of a hand, or an arm comes up to the lens."""

    def seen(parts: Capsules) -> Capsules:
        return parts[0] @ rotation.T + translation, parts[1] @ rotation.T + translation, parts[2]

    for hand in hands:
        points = hand.points @ rotation.T + translation
        for other in hands:
            arm = seen(arm_capsules(other))
            close = np.linalg.norm(arm[0], axis=1).min() < 0.07
            parts = [arm] if other is hand else [arm, seen(capsules(other.points, other.scale))]
            if close or any(hidden_by(points, *part) > _MOST_HIDDEN for part in parts):
                return True
    return False
