"""A person who gestures: anny's body (code Apache-2.0, data CC0) over a clip, with where its arms are.

Blender's axes, metres: the person stands at the origin, looks along -Y, and has its left at +X.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from handfit_core.common.skeleton import SIDES
from handfit_core.geometry.rotations import rotvec_to_rotmat

SKIN, CLOTH, EYE = 0, 1, 2
CLOTHED: Final = ("spine", "clavicle", "shoulder", "upperarm", "breast", "pelvis", "leg", "root")
"""Parts of the names of bones that are under clothes"""
CURLED: Final = {
    1: (0.25, 0.35, 0.6),
    2: (1.3, 1.5, 0.9),
    3: (1.3, 1.5, 0.9),
    4: (1.3, 1.5, 0.9),
    5: (1.3, 1.5, 0.9),
}
"""radians by which the joints of anny's fingers, the first the thumb, bend in a fist"""
NEAREST, FARTHEST = 0.45, 0.93
"""Distance of a wrist from the shoulder, in lengths of the arm"""


@dataclass(frozen=True, eq=False)
class Body:
    """A person over T frames."""

    vertices: np.ndarray
    """(T, V, 3)"""
    faces: np.ndarray
    """(F, 3)"""
    material: np.ndarray
    """(V,) SKIN, CLOTH or EYE"""
    arms: dict[str, np.ndarray]
    """side -> (T, 3, 3) shoulder, elbow and wrist"""


def moving_body(seed: int, frames: int, fps: float, *, still: bool = False) -> Body:
    """A random person, who moves both arms, hands and the head, or holds `still` in one pose."""
    import torch
    from anny import Anny

    rng = np.random.default_rng(seed)
    model = Anny()
    at = {name: number for number, name in enumerate(model.bone_labels)}
    looks = rng.uniform(0.3, 0.7, len(model.phenotype_labels))
    person = {
        name: torch.tensor([value], dtype=model.dtype)
        for name, value in zip(model.phenotype_labels, looks, strict=True)
    }
    unmoved = torch.eye(4, dtype=model.dtype).expand(1, len(at), 4, 4)
    with torch.no_grad():
        rest = model(unmoved, phenotype_kwargs=person, pose_parameterization="local-bone-world")
    poses = rest["rest_bone_poses"][0].numpy().astype(np.float64)
    turned = _turns(rng, {name: poses[number, :3, 3] for name, number in at.items()}, frames, fps)
    posed = np.tile(np.eye(4), (frames, len(at), 1, 1))
    for name, number in at.items():
        posed[:, number, :3, :3] = turned[name] @ poses[number, :3, :3]
    posed[:, 0, :3, 3] = poses[0, :3, 3]
    if still:
        posed[:] = posed[frames // 2]
    with torch.no_grad():
        made = model(
            torch.tensor(posed, dtype=model.dtype),
            phenotype_kwargs=person,
            pose_parameterization="world-orient",
        )
    strongest = model.vertex_bone_weights.argmax(dim=1, keepdim=True)
    owner = model.vertex_bone_indices.gather(1, strongest)[:, 0].tolist()
    names = [model.bone_labels[number] for number in owner]
    bones = made["bone_poses"].numpy().astype(np.float64)[..., :3, 3]
    return Body(
        vertices=made["vertices"].numpy(),
        faces=model.faces.numpy(),
        material=np.array([_material(name) for name in names]),
        arms={
            side: bones[
                :, [at[f"{bone}.{side[0].upper()}"] for bone in ("upperarm01", "lowerarm01", "wrist")]
            ]
            for side in SIDES
        },
    )


def _material(bone: str) -> int:
    return EYE if bone.startswith("eye") else CLOTH if any(part in bone for part in CLOTHED) else SKIN


def _turns(
    rng: np.random.Generator, head: dict[str, np.ndarray], frames: int, fps: float
) -> dict[str, np.ndarray]:
    """How far each bone is turned from rest, (T, 3, 3) about the world's axes. `head`: where bones begin."""

    def course(least: ArrayLike, most: ArrayLike, seconds: float) -> np.ndarray:
        """(T, n) smooth random values between two ends (n,); `seconds` from one turning point to the next."""
        from scipy.interpolate import CubicSpline

        least, most = np.atleast_1d(least), np.atleast_1d(most)
        knots = np.arange(0.0, frames / fps + 2.0 * seconds, seconds)
        values = rng.uniform(least, most, (len(knots), len(least)))
        return np.clip(CubicSpline(knots, values)(np.arange(frames) / fps), least, most)

    def both_ways(degrees: ArrayLike, seconds: float) -> np.ndarray:
        most = np.radians(degrees)
        return course(-most, most, seconds)

    sway = rotvec_to_rotmat(both_ways([4.0, 4.0, 6.0], 1.2))
    turns = dict.fromkeys(head, sway)
    nod = sway @ rotvec_to_rotmat(both_ways([10.0, 8.0, 20.0], 0.9))
    turns |= dict.fromkeys(("neck02", "neck03", "head", "eye.L", "eye.R"), nod)
    for side, left in (("L", 1.0), ("R", -1.0)):
        shoulder, elbow, wrist = (head[f"{bone}.{side}"] for bone in ("upperarm01", "lowerarm01", "wrist"))
        upper, lower = elbow - shoulder, wrist - elbow
        # The wrist goes before the chest and the face, the elbow hangs out and down.
        goal = course([-0.75, -0.85, -0.75], [0.25, -0.35, 0.35], 0.6) * [left, 1.0, 1.0]
        hanging = course([-0.35, -0.1, -1.35], [0.35, 0.6, -0.65], 0.9) + np.array([0.8 * left, 0.0, 0.0])
        to_elbow, to_wrist = _two_bones(goal, hanging, *(float(np.linalg.norm(b)) for b in (upper, lower)))
        to_elbow, to_wrist = ((sway @ each[..., None])[..., 0] for each in (to_elbow, to_wrist))
        of_upper = _frame(to_elbow, to_wrist) @ _frame(upper, lower).T
        of_lower = _frame(to_wrist, -to_elbow) @ _frame(lower, -upper).T
        knuckles = [head[f"finger{finger}-1.{side}"] - wrist for finger in (2, 3, 5)]
        back = left * _unit(np.cross(knuckles[0], knuckles[2]))
        twist, bend = both_ways(60.0, 0.7) * _unit(lower), both_ways([35.0, 13.0], 0.7)
        across = np.cross(back, _unit(knuckles[1]))
        of_hand = of_lower @ rotvec_to_rotmat(twist)
        of_hand = of_hand @ rotvec_to_rotmat(bend[:, :1] * across + bend[:, 1:] * back)
        bones = {f"upperarm0{n}": of_upper for n in (1, 2)} | {"lowerarm01": of_lower}
        bones |= {"lowerarm02": of_lower @ rotvec_to_rotmat(0.5 * twist), "wrist": of_hand}
        bones |= {f"metacarpal{n}": of_hand for n in (1, 2, 3, 4)}
        closed = course(0.0, 1.0, 0.6)
        for finger, most in CURLED.items():
            own, turn = np.clip(closed + course(-0.35, 0.35, 0.5), 0.0, 1.0), of_hand
            for joint in (1, 2, 3):
                first, last = (f"finger{finger}-{n}.{side}" for n in (min(joint, 2), min(joint, 2) + 1))
                axis = _unit(np.cross(back, head[last] - head[first]))
                turn = turn @ rotvec_to_rotmat(own * most[joint - 1] * axis)
                bones[f"finger{finger}-{joint}"] = turn
        turns |= {f"{bone}.{side}": turn for bone, turn in bones.items()}
    return turns


def _two_bones(
    goal: np.ndarray, hanging: np.ndarray, upper: float, lower: float
) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3) unit directions of both bones of an arm that reaches to `goal` (T, 3), in its lengths, with the
    elbow towards `hanging` (T, 3)."""
    reach = (upper + lower) * np.clip(np.linalg.norm(goal, axis=1), NEAREST, FARTHEST)
    ahead = _unit(goal)
    aside = _unit(hanging - (hanging * ahead).sum(axis=1, keepdims=True) * ahead)
    along = (upper**2 - lower**2 + reach**2) / (2.0 * reach)
    elbow = along[:, None] * ahead + np.sqrt(upper**2 - along**2)[:, None] * aside
    return elbow / upper, (reach[:, None] * ahead - elbow) / lower


def _frame(along: np.ndarray, aside: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotation whose first column points along one direction, the second to the other's side."""
    first, third = _unit(along), _unit(np.cross(along, aside))
    return np.stack([first, np.cross(third, first), third], axis=-1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
