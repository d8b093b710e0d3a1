"""The surface of an object that a hand holds, as triangles: how far away it is, and which way is out of
it."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.geometry.rotations import units
from handfit_core.hand_model.surface import cross, dot

_SPACING: Final = 0.006
"""metres between marks on triangles, at most, so that the triangle nearest to a point is among those with the
nearest marks"""
_CANDIDATES: Final = 6
"""The triangles of how many nearest marks are searched for the one that is nearest to a point"""
_SEARCH_ERROR: Final = 0.1
"""Relative error of the distance up to which marks count as nearest: from the middle of a round prop,
thousands are equally near"""
_LEAST_AREA: Final = 1e-12
"""square metres: twice the area of a triangle, up to which it has none"""
_MOST_TWICE: Final = 0.01
"""Share of edges that two faces follow in one direction, beyond which the faces of a mesh do not agree on
which side is outside"""
_SAMPLED_FACES, _SAMPLED_FIELD = 32, 4000
"""How many faces of an open mesh are tested for which of their sides is inside, and of how many faces the
winding number is summed for that"""
_CERTAIN_WINDING, _CERTAIN_SHARE = 0.1, 0.9
"""Mean winding number of both sides of a face, 0.5 in closed meshes, from which the inside is certain, and
the share of faces where it must be"""


def outward(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the triangles (F, 3) of vertices (V, 3), in metres, counter-clockwise seen from outside, without
    those that have no area.

    Each part of a closed mesh has a volume. The inside of an open one is where the generalized winding number
    (Jacobson et al. 2013) is above one half, so that a cup without a bottom has one. Raises OptionError where
    it cannot be determined.
    """
    a, b, c = corners = [vertices.take(triangles[:, k], axis=0) for k in range(3)]
    turned = cross(b - a, c - a)
    areas = np.sqrt(dot(turned, turned))
    solid = areas > _LEAST_AREA
    if not solid.any():
        raise OptionError("the prop has no faces; choose an object with a surface")
    if _closed(triangles, len(vertices)):
        part = _parts(triangles, len(vertices))
        inwards = np.bincount(part, dot(a, turned))[part] < 0.0
    else:
        inwards = np.full(len(triangles), _inwards(triangles, len(vertices), corners, areas / areas.sum()))
    return np.where(inwards[:, None], triangles[:, ::-1], triangles)[solid]


def _inwards(triangles: np.ndarray, vertex_count: int, corners: list[np.ndarray], share: np.ndarray) -> bool:
    """Tell whether the triangles (F, 3) of an open mesh are counter-clockwise seen from inside. `corners`:
    three of (F, 3) metres; `share`: (F,) of the mesh's area. Raises OptionError where it has no inside."""
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64) @ [vertex_count, 1]
    if 1.0 - len(np.unique(edges)) / len(edges) > _MOST_TWICE:
        raise OptionError("the prop's faces point both ways; recalculate its normals, then grip again")
    rng = np.random.default_rng(0)
    asked = rng.choice(len(share), _SAMPLED_FACES, p=share)
    field, weight = np.arange(len(share)), np.ones(1)
    if len(share) > _SAMPLED_FIELD:
        field = rng.choice(len(share), _SAMPLED_FIELD, p=share)
        weight = 1.0 / (_SAMPLED_FIELD * share[field])
    middle = np.mean([each[asked] for each in corners], axis=0)[:, None]
    a, b, c = (each[field] - middle for each in corners)  # (asked, field, 3)
    far_a, far_b, far_c = (np.sqrt(dot(each, each)) for each in (a, b, c))
    bottom = far_a * far_b * far_c + dot(a, b) * far_c + dot(b, c) * far_a + dot(c, a) * far_b
    top = dot(a, cross(b, c))
    # The face itself, and what lies in its plane, is seen from the edge.
    top[np.abs(top) < 1e-9 * far_a * far_b * far_c] = 0.0
    winding = (np.where(top == 0.0, 0.0, np.arctan2(top, bottom)) * weight).sum(axis=1) / (2.0 * np.pi)
    for sign in (1.0, -1.0):
        if np.mean(sign * winding > _CERTAIN_WINDING) >= _CERTAIN_SHARE:
            return sign < 0.0
    raise OptionError(
        "the inside of the prop cannot be determined, as its mesh is open; close it or make it solid"
    )


def _closed(triangles: np.ndarray, vertex_count: int) -> bool:
    """Tell whether faces follow each edge as often in one direction as in the other. Then their signed areas
    add up to zero wherever on a plane their vertices lie, here at random."""
    places = np.random.default_rng(0).integers(0, 2**20, (2, vertex_count))
    (x, u, w), (y, v, z) = ([each.take(triangles[:, k]) for k in range(3)] for each in places)
    return bool(((u - x) * (z - y) - (w - x) * (v - y)).sum() == 0)


def _parts(triangles: np.ndarray, vertex_count: int) -> np.ndarray:
    """Return the number (F,) of the part to which each triangle belongs; parts have no vertex in common."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    ends = triangles[:, :2].reshape(-1), triangles[:, 1:].reshape(-1)
    edges = csr_array((np.ones(len(ends[0]), dtype=np.int8), ends), shape=(vertex_count, vertex_count))
    return connected_components(edges, directed=False)[1][triangles[:, 0]]


class PropSurface:
    """The triangles (F, 3) of a prop's `vertices` (V, 3), as `outward` returns them, that lie in the box
    between the corners `low` (3,) and `high` (3,), in metres."""

    def __init__(
        self, vertices: np.ndarray, triangles: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> None:
        from scipy.spatial import KDTree

        beyond = np.packbits(np.concatenate([vertices < low, vertices > high], axis=1), axis=1)[:, 0]
        a, b, c = (beyond.take(triangles[:, k]) for k in range(3))
        triangles = triangles[a & b & c == 0]
        corners = np.stack([vertices.take(triangles[:, k], axis=0) for k in range(3)])
        sides = corners[[1, 2, 0]] - corners
        squared = dot(sides, sides)
        large = (squared > _SPACING**2).any(axis=0)
        small, of = np.flatnonzero(~large), np.flatnonzero(large)
        # Their longest side becomes the first one.
        corners[:, of] = corners[(squared[:, of].argmax(axis=0) + np.arange(3)[:, None]) % 3, of]
        self._corners = corners
        """(3, F, 3) metres: first, second and third corners of all triangles"""
        self._axes = np.empty((len(triangles), 3, 3))
        """(F, 3, 3) in rows the axes of each triangle: along its first side, across it, and out of it"""
        self._flat = np.empty((len(triangles), 3, 2))
        """(F, 3, 2) metres: the corners of each triangle, along and across its first side"""
        self._measured = np.zeros(len(triangles), dtype=bool)
        """(F,) bool: true for triangles whose axes and flat corners are known: few of many are ever needed"""
        marks, owner = self._rows(of, (low + high) / 2.0, (high - low) / 2.0)
        self._owner = np.concatenate([owner, small])
        marks = np.concatenate([marks, (corners[0] + corners[1] + corners[2])[small] / 3.0])
        self._tree = KDTree(marks, balanced_tree=False, compact_nodes=False)

    def _measure(self, wanted: np.ndarray) -> None:
        """Find axes and flat corners of the triangles `wanted` (...)."""
        new = np.zeros_like(self._measured)
        new[wanted] = True
        new = np.flatnonzero(new & ~self._measured)
        a, b, c = self._corners[:, new]
        along = b - a
        length = np.sqrt(dot(along, along))
        along /= length[:, None]
        normals = units(cross(along, c - a))
        self._axes[new] = np.stack([along, cross(normals, along), normals], axis=1)
        self._flat[new, :2], self._flat[new, 1, 0] = 0.0, length
        self._flat[new, 2] = (self._axes[new, :2] @ (c - a)[..., None])[..., 0]
        self._measured[new] = True

    def _rows(self, of: np.ndarray, middle: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return marks (N, 3) on the triangles `of` (M,), in rows along their first sides, where these are in
        the box around `middle` (3,) of `half` (3,) its size, and the triangle (N,) of each."""
        self._measure(of)
        axes, origins = self._axes[of, :2], self._corners[0, of]
        box, reach = (axes @ (middle - origins)[..., None])[..., 0], np.abs(axes) @ half
        (low, lowest), (high, highest) = (box - reach).T, (box + reach).T
        length, (third, height) = self._flat[of, 1, 0], self._flat[of, 2].T
        row, lower, width = _parted(np.maximum(lowest, 0.0), np.minimum(highest, height))
        # A row reaches as far as the triangle does at the row's lower edge, and its marks are within both.
        first, last = lower * (third / height)[row], length[row] - lower * ((length - third) / height)[row]
        mark, along, size = _parted(np.maximum(first, low[row]), np.minimum(last, high[row]))
        row, along, lower = row[mark], along + size / 2.0, lower[mark]
        with np.errstate(divide="ignore"):
            top = np.minimum(along / third[row], (length[row] - along) / (length - third)[row]) * height[row]
        flat = np.stack([along, (lower + np.minimum(lower + width[mark], top)) / 2.0], axis=1)
        return origins[row] + (flat[:, None] @ axes[row])[:, 0], of[row]

    def __len__(self) -> int:
        return len(self._owner)

    def gaps(self, points: np.ndarray, within: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
        """Return signed distances (N,) in metres of points (N, 3) from the prop, negative inside it and
        infinite beyond `within`, and their gradients (N, 3), unit vectors."""
        farthest = within + _SPACING
        eps: Any = _SEARCH_ERROR  # which SciPy's annotations have as a whole number
        near = self._tree.query(points, _CANDIDATES, eps, distance_upper_bound=farthest)[1]
        near = np.asarray(near)
        found = np.flatnonzero(near[:, 0] < len(self._owner))
        near = self._owner[np.minimum(near[found], len(self._owner) - 1)]
        self._measure(near)
        off = self._axes[near] @ (points[found, None] - self._corners[0][near])[..., None]
        off[..., :2, 0] = _beside(self._flat[near], off[..., :2, 0])
        off = off[..., 0]
        distance = np.sqrt(dot(off, off))
        # At an edge, the face that is turned most to the point tells on which side it lies.
        nearest = distance <= distance.min(axis=1, keepdims=True) + 1e-9
        best = np.arange(len(found)), np.where(nearest, np.abs(off[..., 2]), -1.0).argmax(axis=1)
        axes, off = self._axes[near[best]], off[best]
        signed = np.copysign(distance[best], off[:, 2])
        with np.errstate(all="ignore"):
            away = np.where(np.abs(signed)[:, None] > 1e-7, off / signed[:, None], [0.0, 0.0, 1.0])
        gaps, gradients = np.full(len(points), np.inf), np.zeros_like(points)
        gaps[found] = np.where(signed <= within, signed, np.inf)
        gradients[found] = (away[:, None] @ axes)[:, 0]
        return gaps, gradients


def _parted(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Part N intervals from `first` (N,) to `last` (N,) into ones no longer than `_SPACING`; returns of which
    interval each is a part, and where they begin and how long they are. Those that end before they begin have
    no parts."""
    count = np.ceil(np.maximum(last - first, 0.0) / _SPACING).astype(np.int64)
    of = np.arange(len(count)).repeat(count)
    width = (last - first)[of] / count[of]
    number = np.arange(len(of)) - (count.cumsum() - count)[of]
    return of, first[of] + number * width, width


def _beside(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the ways (..., 2) to `points` (..., 2) of a plane from where they are nearest in triangles
    (..., 3, 2), which run counter-clockwise: zero for points within."""
    least, within, found = np.full(points.shape[:-1], np.inf), True, np.zeros_like(points)
    for k in range(3):
        side, off = corners[..., k - 2, :] - corners[..., k, :], points - corners[..., k, :]
        sx, sy, x, y = side[..., 0], side[..., 1], off[..., 0], off[..., 1]
        along = np.minimum(np.maximum((x * sx + y * sy) / np.maximum(sx * sx + sy * sy, 1e-30), 0.0), 1.0)
        turned = sx * y - sy * x
        off -= along[..., None] * side
        squared = x * x + y * y
        found = np.where((squared < least)[..., None], off, found)
        within = within & (turned >= 0.0)
        least = np.minimum(least, squared)
    return np.where(np.asarray(within)[..., None], 0.0, found)
