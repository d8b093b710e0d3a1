"""Random cameras: views from all directions, roll, focal lengths, and the hand's place in the picture.

Camera frame: OpenCV's, metres. Pictures are square, the principal point is their centre.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat

from .contact import segment_distance

FOCAL_MM: Final = (20.0, 85.0)
"""Full-frame equivalent: over a sensor 36 mm wide"""
COVERAGE: Final = (0.25, 0.80)
"""Longer side of the keypoints' box over the picture's side"""
CUT_OUTSIDE: Final = (3, 8)
"""Least and largest number of keypoints of a cut hand that are outside of the picture"""
LEAST_ANGLE_TO_ARM: Final = np.radians(35.0)
"""Between the directions to the camera and to the elbow, so that the camera is not in the sleeve"""
_MARGIN: Final = 0.03
_NEAREST: Final = 0.04
"""metres from the camera to the nearest keypoint, at least"""


def random_focal_mm(rng: np.random.Generator) -> float:
    """A focal length in mm; its logarithm is uniform, which gives as many wide-angle as long lenses."""
    return float(np.exp(rng.uniform(*np.log(FOCAL_MM))))


def lens_tags(focal_mm: float) -> dict[str, str]:
    """The tags of a picture that describe its lens."""
    lens = "wide" if focal_mm < 30 else "normal" if focal_mm < 55 else "long"
    return {"lens": lens, "focal_mm": f"{focal_mm:.0f}"}


def intrinsics_of(focal_mm: float, size: int) -> Intrinsics:
    """The camera of a picture `size` pixels square."""
    focal = focal_mm / 36.0 * size
    return Intrinsics(focal, focal, size / 2.0, size / 2.0)


def random_direction(rng: np.random.Generator) -> np.ndarray:
    """(3,) uniform on the sphere."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def random_view(arms: list[np.ndarray], rng: np.random.Generator, *, usual: bool = False) -> np.ndarray:
    """(3,) direction from the hand to the camera in the hand's frame, away from all `arms` (3,).

    usual: onto the first hand's palm or back, where people film hands from.
    """
    for _ in range(1000):
        view = np.array([0.0, rng.choice([-1.0, 1.0]), 0.0]) if usual else np.zeros(3)
        view += rng.normal(0.0, 0.45 if usual else 1.0, 3)
        view /= np.linalg.norm(view)
        if all(view @ arm < np.cos(LEAST_ANGLE_TO_ARM) for arm in arms):
            return view
    raise AssertionError("the arms leave no room for a camera")


def random_standpoint(arms: list[np.ndarray], rng: np.random.Generator) -> tuple[str, np.ndarray, float]:
    """A random camera: its kind, which is `sphere` (any view and roll) or as often `usual`; its view (3,) and
    its roll in radians."""
    if rng.random() < 0.5:
        return "sphere", random_view(arms, rng), float(rng.uniform(-np.pi, np.pi))
    view = random_view(arms, rng, usual=True)
    # The roll lets the arm come from below, more or less.
    x, y, _ = facing(view, np.array([0.0, 0.0, 1.0]), 0.0) @ arms[0]
    return "usual", view, float(np.arctan2(y, x) - np.pi / 2 + rng.normal(0.0, 0.6))


def facing(view: np.ndarray, ray: np.ndarray, roll: float) -> np.ndarray:
    """(3, 3) rotation from the hand's frame to the camera's that turns `view` (3,) against `ray` (3,)."""
    ahead = np.array([0.0, 0.0, 1.0])
    straight = _frame(-ahead) @ rotvec_to_rotmat(np.array([0.0, 0.0, roll])) @ _frame(view).T
    # The shortest turn from straight ahead, so that neighbouring rays see the hand upright alike.
    axis = np.cross(ahead, ray)
    sine = float(np.linalg.norm(axis))
    return rotvec_to_rotmat(axis * (np.arctan2(sine, ray[2]) / max(sine, 1e-12))) @ straight


def _frame(z: np.ndarray) -> np.ndarray:
    helper = np.eye(3)[int(np.abs(z).argmin())]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def stand_off(turned: np.ndarray, camera: Intrinsics, ray: np.ndarray, coverage: float) -> np.ndarray | None:
    """Translation (3,) that puts points (N, 3), turned already, along `ray` at the distance where their
    box covers `coverage` of the picture; None where the camera would have to stand among them."""
    size = 2 * camera.cx
    low_corner, high_corner = turned.min(axis=0), turned.max(axis=0)
    centre = 0.5 * (low_corner + high_corner)

    def extent(distance: float) -> float:
        pixels = camera.project(turned - centre + distance * ray)
        return float(np.ptp(pixels, axis=0).max() / size)

    nearest = (_NEAREST - (turned - centre)[:, 2].min()) / ray[2]
    low, high = max(nearest, 0.05), 6.0
    if extent(low) < coverage:
        return None
    for _ in range(45):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if extent(middle) > coverage else (low, middle)
    return high * ray - centre


Placing = tuple[np.ndarray, np.ndarray]
"""Rotation (3, 3) and translation (3,) into the camera's frame"""


@dataclass(frozen=True, eq=False)
class Placement:
    """Points (N, 3) that are to be seen from `view` (3,), their box over `coverage` of the picture."""

    points: np.ndarray
    view: np.ndarray
    roll: float
    camera: Intrinsics
    coverage: float

    def about(self, pixel: np.ndarray) -> Placing | None:
        """The points about `pixel` (2,); None where the camera would have to stand among them."""
        ray = self.camera.rays(pixel)
        ray = ray / np.linalg.norm(ray)
        rotation = facing(self.view, ray, self.roll)
        translation = stand_off(self.points @ rotation.T, self.camera, ray, self.coverage)
        return None if translation is None else (rotation, translation)

    def pixels(self, placed: Placing) -> np.ndarray:
        """(N, 2) where the points are seen."""
        return self.camera.project(self.points @ placed[0].T + placed[1])

    def whole(self, rng: np.random.Generator) -> Placing | None:
        """Somewhere in the picture with all points inside; None where that fails."""
        size = 2 * self.camera.cx
        pixel = np.array([self.camera.cx, self.camera.cy])
        margin = _MARGIN * size
        for _ in range(12):
            placed = self.about(pixel)
            if placed is None:
                return None
            pixels = self.pixels(placed)
            low, high = pixels.min(axis=0), pixels.max(axis=0)
            inside = np.all(low >= margin) and np.all(high <= size - margin)
            if inside and not np.allclose(pixel, self.camera.cx):
                return placed
            slack = np.maximum(size - 2 * margin - (high - low), 0.0)
            corner = margin + slack * rng.uniform(0.0, 1.0, 2)
            pixel = np.clip(pixel + 0.95 * (corner - low), 0.0, size)
        return None

    def cut(self, rng: np.random.Generator) -> Placing | None:
        """With 3 to 8 of the points outside of the picture; None where that fails."""
        size = 2 * self.camera.cx
        angle = rng.uniform(0, 2 * np.pi)
        towards = np.array([np.cos(angle), np.sin(angle)])
        tried = [self.about(self.camera.cx + away * size * towards) for away in np.linspace(0.05, 0.6, 24)]
        least, most = CUT_OUTSIDE
        found = [p for p in tried if p is not None and least <= outside(self.pixels(p), size) <= most]
        return found[rng.integers(len(found))] if found else None


def outside(pixels: np.ndarray, size: float) -> np.ndarray:
    """(..., N, 2) pixels -> (...) how many lie outside of the picture."""
    return np.any((pixels < 0) | (pixels > size), axis=-1).sum(axis=-1)


def hidden_by(points: np.ndarray, starts: np.ndarray, ends: np.ndarray, radii: np.ndarray) -> int:
    """Number of points (N, 3) behind capsules (M, 3), (M, 3), (M,), all in the camera frame."""
    eye = np.zeros_like(points)[:, None]
    distance = segment_distance(eye, 0.96 * points[:, None], starts[None], ends[None])
    return int(np.any(distance < radii, axis=1).sum())


def covered_by(pixels: np.ndarray, outline: np.ndarray) -> int:
    """Number of pixels (N, 2) within the convex hull of `outline` (M, 2)."""
    # From within, the outline is seen all around: no two neighbouring directions are half a turn apart.
    towards = outline - pixels[:, None]
    seen = np.sort(np.arctan2(towards[..., 1], towards[..., 0]), axis=1)
    gaps = np.diff(seen, axis=1, append=seen[:, :1] + 2 * np.pi)
    return int(np.sum(gaps.max(axis=1) <= np.pi))


_SIDES: Final = (("palm", (0, -1, 0)), ("back", (0, 1, 0)), ("tips", (-1, 0, 0)), ("wrist", (1, 0, 0)))


def view_name(view: np.ndarray, side: Side) -> str:
    """The face of the hand that the camera sees most of: palm, back, tips, wrist, or edge."""
    as_right = view if side == "right" else view * np.array([-1.0, 1.0, 1.0])
    name, cosine = max(((n, float(as_right @ np.array(d))) for n, d in _SIDES), key=lambda pair: pair[1])
    return name if cosine >= abs(as_right[2]) else "edge"
