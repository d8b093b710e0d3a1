"""A hand model's mesh closed at the wrist: by a cap, or by a short piece of forearm.

Models in MANO's format end in an open edge. `with_wrist` appends vertices to the model's own, each a linear
function of the edge's, so that shape and pose directions carry over and the model's vertices keep their
numbers.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Final, Literal

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, NUM_JOINTS
from handfit_core.geometry.rotations import smoothstep
from handfit_core.hand_model.data import HandModel

Wrist = Literal["open", "cap", "forearm"]
"""The end of a mesh at the wrist: open, as the model has it, or closed by a cap or a piece of forearm, of as
many vertices"""

_RINGS: Final = (
    # Distance behind the edge, in parts of the length from the middle knuckle to it; breadth and thickness,
    # in parts of the edge's; share of an ellipse in the outline, beside the edge's own.
    (0.05, 0.985, 0.97, 0.15),
    (0.11, 0.965, 0.935, 0.4),
    (0.18, 0.955, 0.915, 0.7),
    (0.26, 0.965, 0.92, 0.9),
    (0.35, 0.99, 0.945, 1.0),
    (0.44, 1.02, 0.98, 1.0),
    (0.53, 1.05, 1.01, 1.0),
    (0.565, 1.03, 0.985, 1.0),
    (0.585, 0.94, 0.885, 1.0),
    (0.595, 0.6, 0.56, 1.0),
)
"""The forearm: narrowest and flattest a thumb's breadth behind the edge, rounded at its end"""
_END: Final = 0.6
"""Distance of the forearm's end behind the edge, in parts of the length from the middle knuckle to the
edge"""
_CAP: Final = 0.1
"""Height of the cap, in parts of the length from the middle knuckle to the edge"""

_BEND: Final = (-0.06, 0.26)
"""Distances behind the wrist joint between which the wrist's skin bends, in parts of the length from the
middle knuckle to the joint"""


def wrist_ring(polygons: np.ndarray) -> np.ndarray:
    """Return the vertices (R,) of a mesh's open edge, in the order in which its polygons (P, 3 or 4) walk it;
    empty where the mesh has no open edge, or more than one."""
    start, end = polygons.ravel(), np.roll(polygons, -1, axis=1).ravel()
    count = int(polygons.max()) + 1
    # An open edge is one that no neighbour walks the other way.
    is_open = ~np.isin(end * count + start, start * count + end)
    following = dict(zip(start[is_open].tolist(), end[is_open].tolist(), strict=True))
    if not following:
        return np.zeros(0, dtype=np.int64)
    ring = [min(following)]
    while len(ring) <= len(following) and (after := following.get(ring[-1], ring[0])) != ring[0]:
        ring.append(after)
    whole = len(ring) == len(following)
    return np.array(ring if whole else [], dtype=np.int64)


@lru_cache(maxsize=8)
def with_wrist(model: HandModel, wrist: Wrist) -> HandModel:
    """Return the model with that end; a cap and a forearm differ only in where their vertices are.

    The first V vertices and P polygons are the model's own; those that follow move with the wrist joint.
    Joints, fingertips and keypoints are the model's, the digest is not. Models without a single open edge,
    and those with quads around an odd number of vertices, come back as they are.
    """
    if wrist == "open":
        return model
    ring = wrist_ring(model.polygons)
    if len(ring) < 3 or (model.quads is not None and len(ring) % 2):
        return model
    knuckle = model.joint_regressor[FINGER_JOINTS["middle"][0]]

    def extended(values: np.ndarray) -> np.ndarray:
        """Extend values of the vertices, or of a direction in which they move, from (V, 3, ...) to
        (V + N, 3, ...)."""
        added = _behind(values[ring], np.tensordot(knuckle, values, 1), wrist)
        return np.concatenate([values, added])

    count, added = len(model.v_template), len(_RINGS) * len(ring) + 1
    weights = np.zeros((added, NUM_JOINTS))
    weights[:, 0] = 1.0
    sides, lid = _polygons(ring, count)
    changed = {
        "v_template": extended(model.v_template),
        "shapedirs": extended(model.shapedirs),
        "posedirs": extended(model.posedirs),
        "weights": np.concatenate([model.weights, weights]),
        "joint_regressor": np.pad(model.joint_regressor, ((0, 0), (0, added))),
        "faces": np.concatenate([model.faces, _triangles(sides, lid)]),
    }
    if model.quads is not None:
        changed["quads"] = np.concatenate([model.quads, _quads(sides, lid)])
    if model.uv is not None and model.uv_faces is not None:
        changed["uv"], changed["uv_faces"] = _texture(model, ring)
    for array in changed.values():
        array.setflags(write=False)
    return replace(model, **changed)


def forearm_share(model: HandModel) -> np.ndarray:
    """Return the part (V,) of the wrist's skin weight that a forearm bone takes over, 0..1: from 0 at the
    wrist to 1 beyond it."""
    joints = model.shaped().joints
    along = joints[0] - joints[FINGER_JOINTS["middle"][0]]
    behind = (model.v_template - joints[0]) @ along / (along @ along)
    return model.weights[:, 0] * smoothstep((behind - _BEND[0]) / (_BEND[1] - _BEND[0]))


def _behind(edge: np.ndarray, knuckle: np.ndarray, wrist: Wrist) -> np.ndarray:
    """Return the added vertices (N, 3, ...) from the edge's (R, 3, ...) and the middle knuckle (3, ...), all
    in metres in the model frame: ring after ring, and the middle of the end."""
    around = np.arange(len(edge)) * 2.0 * np.pi / len(edge)
    waves = np.stack([np.cos(around), np.sin(around)], axis=1)
    centre = edge.mean(axis=0)
    own = edge - centre
    # The first harmonic of any closed outline is an ellipse.
    ellipse = np.tensordot(waves @ waves.T * (2.0 / len(edge)), own, 1)
    ellipse[:, 0] = 0.0  # its plane stands across the arm
    back = np.zeros_like(centre)
    back[0] = (centre - knuckle)[0]  # along the model frame's x, as the flat hand lies
    rings = []
    for step, (behind, breadth, thickness, roundness) in enumerate(_RINGS, start=1):
        depth = 1.0
        if wrist == "cap":
            angle = 0.5 * np.pi * step / (len(_RINGS) + 1)
            behind, breadth, roundness = _CAP * np.sin(angle), np.cos(angle), 0.0
            thickness = depth = breadth
        outline = (1.0 - roundness) * own + roundness * ellipse
        scale = np.array([depth, thickness, breadth]).reshape(3, *([1] * (edge.ndim - 2)))
        rings.append(centre + behind * back + outline * scale)
    end = centre + (_CAP if wrist == "cap" else _END) * back
    return np.concatenate([*rings, end[None]])


def _polygons(ring: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the polygons that close the mesh: quads (S, 4) of the sides and triangles (R, 3) of the end;
    `count` is the first added vertex's number."""
    size = len(ring)
    rings = np.concatenate([ring[None], count + np.arange(len(_RINGS) * size).reshape(-1, size)])
    ahead = np.roll(rings, -1, axis=1)
    sides = np.stack([ahead[:-1], rings[:-1], rings[1:], ahead[1:]], axis=-1).reshape(-1, 4)
    end = np.full(size, count + len(_RINGS) * size)
    return sides, np.stack([end, ahead[-1], rings[-1]], axis=1)


def _texture(model: HandModel, ring: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the texture coordinates (U, 2) of the closed mesh, and their indices per corner of its polygons:
    the picture goes on beyond the edge, as far as there is any."""
    uv, uv_faces = model.uv, model.uv_faces
    assert uv is not None
    assert uv_faces is not None
    ahead = np.roll(model.polygons, -1, axis=1)
    starts, ends, middles = [], [], []
    for here, after in zip(ring, np.roll(ring, -1), strict=True):
        polygon, corner = (int(found[0]) for found in np.nonzero((model.polygons == here) & (ahead == after)))
        corners = uv_faces[polygon]
        starts.append(uv[corners[corner]])
        ends.append(uv[corners[(corner + 1) % len(corners)]])
        middles.append(uv[corners].mean(axis=0))
    edge = np.array([starts, ends])  # (2, R, 2): an edge of the mesh may be a seam of the picture
    outward = (edge.mean(axis=0) - np.array(middles)).mean(axis=0)
    points = model.v_template[ring]
    length = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum()
    outward /= max(float(np.linalg.norm(outward)), 1e-12)
    outward *= np.linalg.norm(edge[1] - edge[0], axis=1).sum() / length  # parts of the picture per metre
    reach = np.linalg.norm(model.shaped().joints[FINGER_JOINTS["middle"][0]] - points.mean(axis=0))
    behind = reach * np.array([0.0, *(ring_[0] for ring_ in _RINGS), _END])
    grown = edge + behind[:, None, None, None] * outward  # (K + 2, 2, R, 2)
    numbers = len(uv) + np.arange(grown[..., 0].size).reshape(grown.shape[:-1])
    start, end = numbers[:, 0], numbers[:, 1]
    sides = np.stack([end[:-2], start[:-2], start[1:-1], end[1:-1]], axis=-1).reshape(-1, 4)
    lid = np.stack([start[-1], end[-2], start[-2]], axis=1)
    added = _triangles(sides, lid) if model.quads is None else _quads(sides, lid)
    return np.concatenate([uv, grown.reshape(-1, 2)]), np.concatenate([uv_faces, added])


def _triangles(sides: np.ndarray, lid: np.ndarray) -> np.ndarray:
    """Split the sides' quads and join them to the lid's triangles, as `_polygons` gives them:
    (2 S + R, 3)."""
    return np.concatenate([sides[:, [0, 1, 2]], sides[:, [0, 2, 3]], lid])


def _quads(sides: np.ndarray, lid: np.ndarray) -> np.ndarray:
    """Join two neighbours of the lid's triangles to a quad each, after the sides' quads: (S + R / 2, 4)."""
    return np.concatenate([sides, np.hstack([lid[1::2, :2], lid[::2, 1:]])])
