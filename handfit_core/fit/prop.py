"""The surface of an object that a hand holds, as triangles: how far away it is, and which way is out of
it."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.hand_model.surface import cross

_LONGEST_SIDE: Final = 0.006
"""metres: longer sides of triangles are halved, so that the triangle nearest to a point is among those with
the nearest centres"""
_CANDIDATES: Final = 6
"""How many triangles with the nearest centres are searched for the one that is nearest to a point"""
_MOST_TWICE: Final = 0.01
"""Share of edges that two faces follow in one direction, beyond which the faces of a mesh do not agree on
which side is outside"""
_SAMPLED_FACES, _SAMPLED_FIELD = 32, 4000
"""How many faces are tested for which of their sides is inside, and of how many faces the winding number is
summed for that"""
_CERTAIN_WINDING, _CERTAIN_SHARE = 0.1, 0.9
"""Mean winding number of both sides of a face, 0.5 in closed meshes, from which the inside is certain, and
the share of faces where it must be"""


def outward(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the corners (F, 3, 3) of the triangles (F, 3) of vertices (V, 3), in their unit,
    counter-clockwise seen from outside.

    The inside is where the generalized winding number (Jacobson et al. 2013) is above one half, so that a cup
    without a bottom has one. Raises OptionError where it cannot be determined.
    """
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64) @ [len(vertices), 1]
    corners = vertices[triangles]
    areas = np.linalg.norm(cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not areas.sum() > 0.0:
        raise OptionError("the prop has no faces; choose an object with a surface")
    if 1.0 - len(np.unique(edges)) / len(edges) > _MOST_TWICE:
        raise OptionError("the prop's faces point both ways; recalculate its normals, then grip again")
    rng = np.random.default_rng(0)
    asked = rng.choice(len(corners), _SAMPLED_FACES, p=areas / areas.sum())
    field = corners if len(corners) <= _SAMPLED_FIELD else corners[rng.choice(len(corners), _SAMPLED_FIELD)]
    off = field - corners[asked].mean(axis=1)[:, None, None]  # (asked, field, 3 corners, 3)
    a, b, c = (off[:, :, k] for k in range(3))
    far_a, far_b, far_c = (np.linalg.norm(each, axis=2) for each in (a, b, c))
    bottom = far_a * far_b * far_c + (a * b).sum(2) * far_c + (b * c).sum(2) * far_a + (c * a).sum(2) * far_b
    top = (a * cross(b, c)).sum(axis=2)
    # The face itself, and what lies in its plane, is seen from the edge.
    top[np.abs(top) < 1e-9 * far_a * far_b * far_c] = 0.0
    angles = np.where(top == 0.0, 0.0, np.arctan2(top, bottom))
    winding = angles.sum(axis=1) / (2.0 * np.pi) * (len(corners) / len(field))
    for certain, sides in ((winding, corners), (-winding, corners[:, ::-1])):
        if np.mean(certain > _CERTAIN_WINDING) >= _CERTAIN_SHARE:
            return sides
    raise OptionError(
        "the inside of the prop cannot be determined, as its mesh is open; close it or make it solid"
    )


class PropSurface:
    """The triangles of a prop that lie in the box between the corners `low` (3,) and `high` (3,), in
    metres."""

    def __init__(self, corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
        from scipy.spatial import KDTree

        corners = corners[_in_box(corners, low, high)]
        while True:
            sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
            long = sides.max(axis=1, initial=0.0) > _LONGEST_SIDE
            if not long.any():
                break
            turn = (sides[long].argmax(axis=1)[:, None] + np.arange(3)) % 3
            first = np.take_along_axis(corners[long], turn[..., None], axis=1)
            second, middle = first.copy(), first[:, :2].mean(axis=1)
            first[:, 1], second[:, 0] = middle, middle
            halves = np.concatenate([first, second])
            corners = np.concatenate([corners[~long], halves[_in_box(halves, low, high)]])
        normals = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sizes = np.linalg.norm(normals, axis=1)
        solid = sizes > 1e-14
        self._corners, self._normals = corners[solid], normals[solid] / sizes[solid, None]
        self._longest = sides.max(initial=0.0)
        self._tree = KDTree(self._corners.mean(axis=1), balanced_tree=False, compact_nodes=False)

    def __len__(self) -> int:
        return len(self._corners)

    def gaps(self, points: np.ndarray, within: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
        """Return signed distances (N,) in metres of points (N, 3) from the prop, negative inside it and
        infinite beyond `within`, and their gradients (N, 3), unit vectors."""
        near = self._tree.query(points, k=_CANDIDATES, distance_upper_bound=within + self._longest)[1]
        near = np.asarray(near)
        found = np.flatnonzero(near[:, 0] < len(self))
        near = np.minimum(near[found], len(self) - 1)
        corners, normals = self._corners[near], self._normals[near]
        off = points[found, None] - _nearest_in(corners, normals, points[found, None])
        distance = np.linalg.norm(off, axis=2)
        along = (off * normals).sum(axis=2)
        # At an edge, the face that is turned most to the point tells on which side it lies.
        nearest = distance <= distance.min(axis=1, keepdims=True) + 1e-9
        best = np.arange(len(found)), np.where(nearest, np.abs(along), -1.0).argmax(axis=1)
        signed = np.copysign(distance[best], along[best])
        gaps, gradients = np.full(len(points), np.inf), np.zeros_like(points)
        gaps[found] = np.where(signed <= within, signed, np.inf)
        with np.errstate(all="ignore"):
            away = off[best] / signed[:, None]
        gradients[found] = np.where(distance[best][:, None] > 1e-7, away, normals[best])
        return gaps, gradients


def _in_box(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)


def _nearest_in(corners: np.ndarray, normals: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the places (..., 3) in triangles (..., 3, 3) with unit normals (..., 3) that are nearest to
    `points` (..., 3)."""
    sides = np.roll(corners, -1, axis=-2) - corners
    off = points[..., None, :] - corners
    squared = np.maximum((sides * sides).sum(axis=-1), 1e-30)
    on_sides = corners + np.clip((off * sides).sum(axis=-1) / squared, 0.0, 1.0)[..., None] * sides
    inside = ((cross(normals[..., None, :], sides) * off).sum(axis=-1) >= 0.0).all(axis=-1)
    foot = points - (off[..., 0, :] * normals).sum(axis=-1, keepdims=True) * normals
    nearest = np.square(points[..., None, :] - on_sides).sum(axis=-1).argmin(axis=-1)
    beside = np.take_along_axis(on_sides, nearest[..., None, None], axis=-2)[..., 0, :]
    return np.where(inside[..., None], foot, beside)
