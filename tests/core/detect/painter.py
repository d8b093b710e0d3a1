"""A quick painter: a shot's picture in milliseconds, without Blender.

Polygons are filled from far to near (painter's algorithm), shaded by a lamp with cast shadows and by
the sky as far as each vertex sees it. Far from Cycles' looks, but a landmark detector errs alike on both.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from handfit_core.geometry.rotations import rotvec_to_rotmat
from scripts.benchmark.kinematics import model_of
from scripts.benchmark.meshes import Mesh, face_normals, vertex_normals
from scripts.benchmark.shots import Shot, ShotHand
from scripts.benchmark.tint import TONES, hand_tint, random_colour, skin_tone

_TONES: Final = np.delete(TONES, 4, axis=0)
_SHIFT: Final = 4
"""Fractional bits of a polygon's corners"""
_CELL: Final = 0.0025
"""metres, of the grid that shadows are found on"""
_BIAS: Final = 0.006
"""metres; what is so little behind another thing is not in its shadow"""
_COARSE: Final = 0.025
"""metres; polygons of props longer than this are divided, or the painter's order fails"""


def paint(shot: Shot, rng: np.random.Generator) -> np.ndarray:
    """(size, size, 3) uint8 RGB of a still."""
    tone = skin_tone(rng, _TONES)
    parts = []  # (vertices, quads, colours per vertex)
    for hand in shot.hands:
        model = model_of(hand.side)
        posed = model.posed(hand.betas, hand.global_orient[0], hand.hand_pose[0], hand.transl[0])
        parts.append((posed.vertices, model.polygons, tone * hand_tint(hand, tone)))
        colours = {"forearm": tone, "sleeve": random_colour(rng)}
        for name, mesh in hand.arm_parts.items():
            parts.append(_flat(Mesh(_with_wrist(hand, mesh.vertices), mesh.polygons), colours[name], rng))
    for prop in shot.props:
        parts.append(_flat(_divided(prop), random_colour(rng), rng))
    picture = _background(shot.size, rng)
    vertices, quads, colours = zip(*parts, strict=True)
    lit = _shaded(vertices, quads, colours, rng)
    exposure = rng.uniform(0.10, 0.27) / max(float(np.mean([c.mean() for c in lit[: len(shot.hands)]])), 1e-3)
    _fill(picture, vertices, quads, [c * exposure for c in lit], shot)
    return _through_lens(picture, rng)


def _with_wrist(hand: ShotHand, vertices: np.ndarray) -> np.ndarray:
    """Points of the model frame (N, 3) that move as the wrist does -> camera frame."""
    wrist = model_of(hand.side).shaped(hand.betas).joints[0]
    rotation = rotvec_to_rotmat(hand.global_orient[0])
    return (vertices - wrist) @ rotation.T + wrist + hand.transl[0]


def _flat(mesh: Mesh, colour: np.ndarray, rng: np.random.Generator):
    colours = np.repeat(colour[None], len(mesh.vertices), axis=0)
    colours = colours * (1 + rng.uniform(0, 0.2) * rng.normal(size=(len(colours), 1)))
    return mesh.vertices, _as_quads(mesh.polygons), np.clip(colours, 0.005, 1.0)


def _divided(mesh: Mesh) -> Mesh:
    """Long quads as grids of smaller ones."""
    vertices, polygons = list(mesh.vertices), []
    for polygon in mesh.polygons:
        corners = mesh.vertices[list(polygon)]
        longest = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1).max()
        n = int(np.ceil(longest / _COARSE))
        if len(polygon) != 4 or n == 1:
            polygons.append(polygon)
            continue
        u = np.linspace(0, 1, n + 1)
        a, b, c, d = corners
        along, across = u[:, None, None], u[:, None]
        grid = (1 - along) * ((1 - across) * a + across * b) + along * ((1 - across) * d + across * c)
        at = len(vertices) + np.add.outer(np.arange(n) * (n + 1), np.arange(n)).ravel()
        vertices.extend(grid.reshape(-1, 3))
        polygons.extend(np.stack([at, at + 1, at + n + 2, at + n + 1], axis=1).tolist())
    return Mesh(np.array(vertices), tuple(polygons), mesh.smooth)


def _as_quads(polygons) -> np.ndarray:
    """(Q, 4) of quads, triangles and lids; a lid becomes a fan, a triangle repeats its first corner."""
    if isinstance(polygons, np.ndarray):
        return polygons
    quads = []
    for p in polygons:
        if len(p) == 4:
            quads.append(p)
        else:
            quads.extend((p[0], p[i], p[i + 1], p[0]) for i in range(1, len(p) - 1))
    return np.array(quads)


def _winding(vertices: np.ndarray, quads: np.ndarray) -> float:
    """1 where corners go clockwise seen from outside in the picture's axes, else -1, by the volume's sign."""
    centred = vertices - vertices.mean(axis=0)
    volume = np.sum(centred[quads[:, 0]] * face_normals(vertices, quads))
    return -1.0 if volume > 0 else 1.0


def _lit_from(points: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(N,) bool: whether light from `direction` (3,) reaches the points (N, 3), by a grid of depths."""
    side = np.cross(direction, [0.3, 0.9, 0.1])
    side /= np.linalg.norm(side)
    up = np.cross(direction, side)
    grid = np.floor(points @ np.stack([side, up], axis=1) / _CELL).astype(np.int64)
    grid -= grid.min(axis=0)
    cells = grid[:, 0] * (grid[:, 1].max() + 1) + grid[:, 1]
    height = points @ direction
    top = np.full(cells.max() + 1, -np.inf)
    np.maximum.at(top, cells, height)
    return height > top[cells] - _BIAS


def _shaded(vertices, quads, colours, rng: np.random.Generator) -> list[np.ndarray]:
    """Linear RGB per vertex of every part."""
    points = np.concatenate(vertices)
    parts = zip(vertices, quads, strict=True)
    normals = np.concatenate([-_winding(v, q) * vertex_normals(v, q) for v, q in parts])
    colour = np.concatenate(colours)
    light = np.zeros_like(points)
    for i in range(int(rng.integers(1, 3))):
        direction = rng.normal(size=3)
        direction[2] = -abs(direction[2]) if i == 0 or rng.random() < 0.6 else direction[2]
        direction /= np.linalg.norm(direction)
        strength = rng.uniform(0.5, 1.2) if i == 0 else rng.uniform(0.1, 0.5)
        warm = 1 + rng.uniform(-0.2, 0.2) * np.array([1.0, 0.0, -1.0])
        shade = np.clip(normals @ direction, 0, None) * np.where(
            _lit_from(points, direction), 1.0, rng.uniform(0.0, 0.4)
        )
        light += strength * shade[:, None] * warm
    sky = np.zeros(len(points))
    directions = rng.normal(size=(10, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for direction in directions:
        sky += np.clip(0.3 + normals @ direction, 0, None) * _lit_from(points, direction)
    light += rng.uniform(0.2, 0.7) * (sky / len(directions))[:, None]
    shaded = colour * light
    return np.split(shaded, np.cumsum([len(v) for v in vertices])[:-1])


def _fill(picture: np.ndarray, vertices, of_parts, colours, shot: Shot) -> None:
    faces = []
    for points, quads, colour in zip(vertices, of_parts, colours, strict=True):
        if points[:, 2].min() < 0.02:
            points = points.copy()
            points[:, 2] = np.maximum(points[:, 2], 0.02)
        corners = shot.camera.project(points) - 0.5
        pixels = np.round(np.clip(corners, -2000, 4000) * 2**_SHIFT).astype(np.int32)
        srgb = np.clip(colour, 0, 1) ** (1 / 2.2) * 255
        seen = corners[quads]
        following = np.roll(seen, -1, axis=1)
        # Shoelace: what turns away is behind something else of its own mesh.
        area = np.sum(seen[..., 0] * following[..., 1] - following[..., 0] * seen[..., 1], axis=1)
        quads = quads[area * _winding(points, quads) > 0]
        depth, shade = points[quads, 2].mean(axis=1).tolist(), srgb[quads].mean(axis=1).tolist()
        faces.extend(zip(depth, pixels[quads], shade, strict=True))
    for _, corners, colour in sorted(faces, key=lambda f: -f[0]):
        cv2.fillConvexPoly(picture, corners, colour, cv2.LINE_AA, _SHIFT)


def _background(size: int, rng: np.random.Generator) -> np.ndarray:
    def colour() -> np.ndarray:
        return random_colour(rng) ** (1 / 2.2) * 255

    picture = np.empty((size, size, 3), dtype=np.float32)
    picture[:] = colour()
    for _ in range(int(rng.integers(1, 4))):
        cells = int(np.exp(rng.uniform(np.log(2), np.log(60))))
        noise = cv2.resize(
            rng.random((cells, cells), dtype=np.float32), (size, size), interpolation=cv2.INTER_CUBIC
        )
        mask = np.clip(noise, 0, 1)[..., None] * rng.uniform(0.2, 1.0)
        picture = picture * (1 - mask) + mask * colour().astype(np.float32)
    picture = np.ascontiguousarray(picture, dtype=np.uint8)
    for _ in range(int(rng.integers(0, 8))):
        at, c = rng.integers(0, size, 4).tolist(), colour().tolist()
        kind = rng.integers(3)
        if kind == 0:
            cv2.rectangle(picture, at[:2], at[2:], c, -1, cv2.LINE_AA)
        elif kind == 1:
            cv2.circle(picture, at[:2], int(rng.uniform(0.03, 0.25) * size), c, -1, cv2.LINE_AA)
        else:
            cv2.line(picture, at[:2], at[2:], c, int(rng.integers(1, size // 20)), cv2.LINE_AA)
    return cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.3, 5.0))


def _through_lens(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Blur, grain and JPEG."""
    picture = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.4, 1.1))
    grain = rng.normal(0, rng.uniform(0.5, 6.0), picture.shape)
    picture = np.clip(picture + grain, 0, 255).astype(np.uint8)
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 98))]
    decoded = cv2.imdecode(cv2.imencode(".jpg", picture, quality)[1], cv2.IMREAD_COLOR)
    assert decoded is not None, "OpenCV reads what it wrote"
    return decoded
