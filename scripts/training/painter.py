"""A quick painter: a shot's picture in milliseconds, for training in bulk. It needs no Blender.

Polygons are filled from far to near (painter's algorithm), shaded by a lamp with cast shadows and by
the sky as far as each vertex sees it. Far from Cycles' looks, but a landmark detector errs alike on both.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from scripts.benchmark.kinematics import model_of
from scripts.benchmark.meshes import Mesh
from scripts.benchmark.shots import Shot, ShotHand
from scripts.benchmark.tint import hand_tint

_TONES: Final = np.array(
    [(0.045, 0.022, 0.013), (0.11, 0.05, 0.028), (0.24, 0.115, 0.062), (0.42, 0.22, 0.13), (0.74, 0.49, 0.37)]
)
"""Skin from dark to light, linear RGB"""
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
    tone = _skin_tone(rng)
    parts = []  # (vertices, polygons, colours per vertex, how much the sky shows)
    for hand in shot.hands:
        model = model_of(hand.side)
        posed = model.posed(hand.betas, hand.global_orient[0], hand.hand_pose[0], hand.transl[0])
        parts.append((posed.vertices, model.polygons, tone * hand_tint(hand, tone)))
        sleeve = _random_colour(rng)
        for mesh, colour in ((hand.arm.skin, tone), (hand.arm.sleeve, sleeve)):
            if mesh is not None:
                parts.append(_flat(Mesh(_with_wrist(hand, mesh.vertices), mesh.polygons), colour, rng))
    for prop in shot.props:
        parts.append(_flat(_divided(prop), _random_colour(rng), rng))
    picture = _background(shot.size, rng)
    lit = _shaded([p[0] for p in parts], [p[1] for p in parts], [p[2] for p in parts], rng)
    exposure = rng.uniform(0.10, 0.27) / max(float(np.mean([c.mean() for c in lit[: len(shot.hands)]])), 1e-3)
    _fill(picture, [p[0] for p in parts], [p[1] for p in parts], [c * exposure for c in lit], shot)
    return _through_lens(picture, rng)


def _with_wrist(hand: ShotHand, vertices: np.ndarray) -> np.ndarray:
    """Points of the model frame (N, 3) that move as the wrist does -> camera frame."""
    from handfit_core.geometry.rotations import rotvec_to_rotmat

    wrist = model_of(hand.side).shaped(hand.betas).joints[0]
    rotation = rotvec_to_rotmat(hand.global_orient[0])
    return (vertices - wrist) @ rotation.T + wrist + hand.transl[0]


def _skin_tone(rng: np.random.Generator) -> np.ndarray:
    place = rng.uniform(0, len(_TONES) - 1)
    below = min(int(place), len(_TONES) - 2)
    tone = _TONES[below] + (place - below) * (_TONES[below + 1] - _TONES[below])
    return np.clip(tone * rng.normal(1.0, [0.04, 0.06, 0.08]), 0.01, 0.9)


def _random_colour(rng: np.random.Generator) -> np.ndarray:
    return np.clip(rng.uniform(0.02, 0.75) * (1 + rng.uniform(0.0, 0.9) * rng.uniform(-1, 1, 3)), 0.01, 0.85)


def _flat(mesh: Mesh, colour: np.ndarray, rng: np.random.Generator):
    colours = np.repeat(colour[None], len(mesh.vertices), axis=0)
    colours = colours * (1 + rng.uniform(0, 0.2) * rng.normal(size=(len(colours), 1)))
    return mesh.vertices, mesh.polygons, np.clip(colours, 0.005, 1.0)


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
        grid = (1 - u)[:, None, None] * ((1 - u)[None, :, None] * a + u[None, :, None] * b) + u[
            :, None, None
        ] * ((1 - u)[None, :, None] * d + u[None, :, None] * c)
        first = len(vertices)
        vertices.extend(grid.reshape(-1, 3))
        for i in range(n):
            for j in range(n):
                at = first + i * (n + 1) + j
                polygons.append((at, at + 1, at + n + 2, at + n + 1))
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
    corners = vertices[quads] - vertices.mean(axis=0)
    volume = np.einsum(
        "qc,qc->q", corners[:, 0], np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    )
    return -1.0 if volume.sum() > 0 else 1.0


def _normals(vertices: np.ndarray, polygons) -> np.ndarray:
    quads = _as_quads(polygons)
    corners = vertices[quads]
    facing = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    facing *= -_winding(vertices, quads)
    normals = np.zeros_like(vertices)
    for k in range(4):
        np.add.at(normals, quads[:, k], facing)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


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


def _shaded(vertices, polygons, colours, rng: np.random.Generator) -> list[np.ndarray]:
    """Linear RGB per vertex of every part."""
    points = np.concatenate(vertices)
    normals = np.concatenate([_normals(v, p) for v, p in zip(vertices, polygons, strict=True)])
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


def _fill(picture: np.ndarray, vertices, polygons, colours, shot: Shot) -> None:
    faces = []
    for points, polys, colour in zip(vertices, polygons, colours, strict=True):
        if points[:, 2].min() < 0.02:
            points = points.copy()
            points[:, 2] = np.maximum(points[:, 2], 0.02)
        corners = shot.camera.project(points) - 0.5
        pixels = np.round(np.clip(corners, -2000, 4000) * 2**_SHIFT).astype(np.int32)
        srgb = np.clip(colour, 0, 1) ** (1 / 2.2) * 255
        quads = _as_quads(polys)
        seen = corners[quads]
        following = np.roll(seen, -1, axis=1)
        # Shoelace: what turns away is behind something else of its own mesh.
        area = np.sum(seen[..., 0] * following[..., 1] - following[..., 0] * seen[..., 1], axis=1)
        quads = quads[area * _winding(points, quads) > 0]
        faces.extend(
            zip(
                points[quads, 2].mean(axis=1).tolist(),
                pixels[quads],
                srgb[quads].mean(axis=1).tolist(),
                strict=True,
            )
        )
    for _, corners, colour in sorted(faces, key=lambda f: -f[0]):
        cv2.fillConvexPoly(picture, corners, colour, cv2.LINE_AA, _SHIFT)


def _background(size: int, rng: np.random.Generator) -> np.ndarray:
    def colour() -> np.ndarray:
        return _random_colour(rng) ** (1 / 2.2) * 255

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
