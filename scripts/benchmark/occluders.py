"""Props between the camera and the hand, camera frame, metres."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat

from .meshes import Mesh, ball, box, cylinder, mug, pen
from .views import covered_by, random_direction

COVERED: Final = (2, 9)
"""How many of the 21 keypoints a prop may hide"""

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
    """In three pictures of ten a prop in front of some of a hand's keypoints (21, 3), and its name; else, and
    where none fits, "none".

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
