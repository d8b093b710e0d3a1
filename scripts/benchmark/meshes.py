"""Simple meshes as NumPy arrays, metres."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Mesh:
    """Polygons in some frame."""

    vertices: np.ndarray
    """(V, 3)"""
    polygons: tuple[tuple[int, ...], ...]
    smooth: bool = True

    def moved(self, rotation: np.ndarray, translation: np.ndarray) -> Mesh:
        """The mesh after p -> R p + t."""
        return replace(self, vertices=self.vertices @ rotation.T + translation)


def face_normals(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """(F, 3) normals of triangles or quads (F, 3 or 4), as long as twice the area:"""
    corners = vertices[polygons]
    return np.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1])


def vertex_normals(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """(V, 3) area-weighted unit normals of a mesh of triangles or quads."""
    normals, faces = np.zeros_like(vertices), face_normals(vertices, polygons)
    for corner in polygons.T:
        np.add.at(normals, corner, faces)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def tube(rings: np.ndarray, closed: bool = True) -> Mesh:
    """Join rings (R, N, 3) of points to a tube; `closed` puts a lid on both ends."""
    count, around = rings.shape[:2]
    number = np.arange(count * around).reshape(count, around)
    after = np.roll(number, -1, axis=1)
    quads = np.stack([number[:-1], after[:-1], after[1:], number[1:]], axis=-1).reshape(-1, 4)
    polygons = tuple(map(tuple, quads.tolist()))
    lids = (tuple(number[0, ::-1].tolist()), tuple(number[-1].tolist())) if closed else ()
    return Mesh(rings.reshape(-1, 3), polygons + lids)


def turned(profile: np.ndarray, around: int = 32, closed: bool = True) -> Mesh:
    """A profile (R, 2) of radius and height, turned about z."""
    angle = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(around)], axis=-1)
    return tube(profile[:, :1, None] * circle + profile[:, 1:, None] * np.array([0.0, 0.0, 1.0]), closed)


def cylinder(radius: float, length: float) -> Mesh:
    """About z, its middle at the origin, with a rounded edge."""
    edge, half = 0.12 * radius, length / 2
    profile = [(radius - edge, -half), (radius, -half + edge), (radius, half - edge), (radius - edge, half)]
    return turned(np.array(profile))


def pen(radius: float, length: float) -> Mesh:
    """A stick about z with a point."""
    half = length / 2
    point = [(0.15 * radius, -half), (radius, -half + 3 * radius)]
    return turned(np.array([*point, (radius, half - 0.3 * radius), (0.8 * radius, half)]), around=16)


def ball(radius: float) -> Mesh:
    """A sphere at the origin."""
    angle = np.linspace(-np.pi / 2 + 0.05, np.pi / 2 - 0.05, 18)
    return turned(radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def box(sides: np.ndarray) -> Mesh:
    """A box at the origin with these (3,) sides."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * sides / 2
    faces = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return Mesh(corners, faces, smooth=False)


def mug(radius: float, height: float) -> Mesh:
    """A mug about z with a handle towards +x."""
    half, wall = height / 2, 0.1 * radius
    outside = [(0.9 * radius, -half), (radius, -half + wall), (radius, half)]
    floor = -half + 2 * wall
    body = turned(np.array([*outside, (radius - wall, half), (radius - wall, floor), (0.1 * radius, floor)]))
    bow = np.linspace(-np.pi / 2, np.pi / 2, 13)
    around = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    thick = 0.13 * radius
    outward = np.stack([np.cos(bow), np.zeros_like(bow), np.sin(bow)], axis=-1)
    centres = np.array([0.95 * radius, 0, 0]) + 0.62 * radius * outward
    round_ = np.cos(around)[:, None] * outward[:, None] + np.sin(around)[:, None] * np.array([0.0, 1.0, 0.0])
    rings = centres[:, None] + thick * round_
    handle = tube(rings)
    offset = len(body.vertices)
    polygons = body.polygons + tuple(tuple(v + offset for v in p) for p in handle.polygons)
    return Mesh(np.concatenate([body.vertices, handle.vertices]), polygons)
