"""A hand as a small picture, without a graphics card: what a pose looks like in a list."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.hand_model.data import HandModel

_SUPERSAMPLING: Final = 2
"""Number of samples per pixel along either axis"""
_SKIN: Final = np.linspace([52, 26, 22], [255, 222, 196], 256).round().astype(np.uint8)
"""(256, 3) uint8 RGB: the colors of the skin from the dark to full light"""


def drawn_pose(model: HandModel, hand_pose: np.ndarray, size: int) -> np.ndarray:
    """Draw a right hand in the pose (45,), radians: (size, size, 2) uint8 light and alpha, top row first.

    Its fingers point up and its palm faces the viewer, who has walked 25 degrees around it, towards its
    thumb, and looks down by 8 degrees.
    """
    still = np.zeros(3)
    points = model.posed(None, still, hand_pose, still).vertices
    # Right, up, to the viewer
    points = points @ np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    a, b = np.radians([25.0, 8.0])
    around = np.array([[np.cos(a), 0.0, -np.sin(a)], [0.0, 1.0, 0.0], [np.sin(a), 0.0, np.cos(a)]])
    down = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(b), -np.sin(b)], [0.0, np.sin(b), np.cos(b)]])
    points = points @ (down @ around).T
    fine = size * _SUPERSAMPLING
    low, high = points.min(axis=0), points.max(axis=0)
    # Free margin on every side, in parts of the picture
    scale = (1.0 - 2.0 * 0.04) * fine / max(high[:2] - low[:2])
    at = (points - (low + high) / 2.0) * scale + [fine / 2.0, fine / 2.0, 0.0]
    depth, light = _lit(at, model.faces, fine)
    # Metres around a place in which nearer surfaces darken it (ambient occlusion)
    light *= 1.0 - 0.75 * _hidden(depth, 0.008 * scale)
    there = np.isfinite(depth)
    picture = np.stack([np.where(there, np.clip(light, 0.0, 1.0), 0.0), there], axis=-1)
    picture = picture.reshape(size, _SUPERSAMPLING, size, _SUPERSAMPLING, 2).mean(axis=(1, 3))
    picture[..., 0] /= np.maximum(picture[..., 1], 1.0 / _SUPERSAMPLING**2)
    return (255.0 * picture[::-1]).round().astype(np.uint8)


def colored(drawn: np.ndarray) -> np.ndarray:
    """Color a drawing of light and alpha (..., 2) as skin: (..., 4) RGBA, both uint8."""
    return np.concatenate([_SKIN[drawn[..., 0]], drawn[..., 1:]], axis=-1)


def _lit(points: np.ndarray, faces: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth, -inf where nothing is, and the light, 0..1, both (size, size), of the triangles that
    face the viewer."""
    sides = points[faces[:, 1:]] - points[faces[:, :1]]
    flat = np.cross(sides[:, 0], sides[:, 1])
    normals = np.zeros_like(points)
    for corner in faces.T:
        np.add.at(normals, corner, flat)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    seen = flat[:, 2] > 0.0
    faces, sides, area = faces[seen], sides[seen], flat[seen, 2]
    corners = points[faces]
    low = np.floor(corners[..., :2].min(axis=1)).astype(int)
    wide, tall = (np.ceil(corners[..., :2].max(axis=1)).astype(int) - low + 1).T
    count = wide * tall
    of = np.repeat(np.arange(len(faces)), count)
    nth = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
    pixel = low[of] + np.stack([nth % wide[of], nth // wide[of]], axis=-1)
    off = pixel + 0.5 - corners[of, 0, :2]
    first, second = sides[of, 0], sides[of, 1]
    b = (off[:, 0] * second[:, 1] - off[:, 1] * second[:, 0]) / area[of]
    c = (first[:, 0] * off[:, 1] - first[:, 1] * off[:, 0]) / area[of]
    inside = (b >= 0.0) & (c >= 0.0) & (b + c <= 1.0) & (pixel >= 0).all(axis=1) & (pixel < size).all(axis=1)
    of, b, c, (x, y) = of[inside], b[inside], c[inside], pixel[inside].T
    parts = np.stack([1.0 - b - c, b, c], axis=-1)
    z = (parts * corners[of, :, 2]).sum(axis=1)
    normal = np.einsum("kc,kcd->kd", parts, normals[faces[of]])
    # Unit vectors to the lights: from the left above, and from the right
    key, fill = np.array([-0.45, 0.65, 0.62]), np.array([0.8, 0.1, 0.59])
    light = 0.18 + 0.72 * np.maximum(normal @ key, 0.0) + 0.24 * np.maximum(normal @ fill, 0.0)
    order = np.argsort(z)  # the nearest is written last
    depth, picture = np.full((size, size), -np.inf), np.zeros((size, size))
    depth[y[order], x[order]] = z[order]
    picture[y[order], x[order]] = light[order]
    return depth, picture


def _hidden(depth: np.ndarray, reach: float) -> np.ndarray:
    """Return the ambient occlusion, 0..1, of the shape of `depth`: the share of each place's light that
    nearer surfaces within `reach` pixels take."""
    taken, steps = np.zeros_like(depth), 0
    for part in (0.35, 0.7, 1.0):
        for angle in np.arange(8) * np.pi / 4.0 + part:
            dy, dx = np.round(part * reach * np.array([np.sin(angle), np.cos(angle)])).astype(int)
            beside = np.roll(depth, (dy, dx), axis=(0, 1))
            with np.errstate(invalid="ignore"):
                rise = np.nan_to_num((beside - depth) / (part * reach), nan=0.0, posinf=0.0, neginf=0.0)
            taken += np.clip(rise, 0.0, 2.0) / 2.0
            steps += 1
    return taken / steps
