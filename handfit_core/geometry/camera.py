"""The pinhole camera: intrinsics and projection.

Camera frame everywhere in the core: OpenCV's (x right, y down, z forward), metres. Pixels: the
centre of the top-left pixel is (0.5, 0.5), so a picture spans (0, 0) to (width, height).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.errors import OptionError

SMALLEST_FOCAL: Final = 1e-3
LARGEST_FOCAL: Final = 1e9
"""pixels: a focal length beyond which there is no camera, and no numbers are left to compute with"""


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera without distortion; all values in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        values = (self.fx, self.fy, self.cx, self.cy)
        # NaN and whole numbers that no float holds fail these, too.
        if not all(abs(v) <= LARGEST_FOCAL for v in values) or not min(self.fx, self.fy) >= SMALLEST_FOCAL:
            raise OptionError(
                f"camera intrinsics need positive, finite focal lengths in pixels, {SMALLEST_FOCAL:g} to "
                f"{LARGEST_FOCAL:g}; got fx={self.fx}, fy={self.fy}, cx={self.cx}, cy={self.cy}"
            )

    @classmethod
    def assumed(cls, width: int, height: int, hand_extent: float = 0.0) -> Intrinsics:
        """A camera for pictures of which nothing is known: the longer side spans 53 degrees, or less, where a
        hand of `hand_extent` pixels would then be nearer than 0.4 m, as in crops; an adult's is 0.17 m long.

        That is a 36 mm lens on full frame, between a phone's main camera (26 mm) and a portrait
        lens (50 mm).
        """
        focal = max(float(max(width, height)), hand_extent * 0.4 / 0.17)
        return cls(focal, focal, width / 2.0, height / 2.0)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project points (..., 3), metres in the camera frame with z > 0, to pixels (..., 2)."""
        points = np.asarray(points, dtype=np.float64)
        focal = np.array([self.fx, self.fy])
        return points[..., :2] / points[..., 2:3] * focal + np.array([self.cx, self.cy])

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Return the rays through pixels (..., 2) as directions (..., 3) in the camera frame, scaled to z =
        1."""
        pixels = np.asarray(pixels, dtype=np.float64)
        xy = (pixels - np.array([self.cx, self.cy])) / np.array([self.fx, self.fy])
        return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)


@dataclass(frozen=True, eq=False)
class PlacedCamera:
    """A further camera beside the first one, whose frame all points are in: x_v = rotation x +
    translation."""

    intrinsics: Intrinsics
    rotation: np.ndarray
    """(3, 3) rotation from the first camera's frame to this one's"""
    translation: np.ndarray
    """(3,) metres: translation from the first camera's frame to this one's"""

    def seen_from(self, points: np.ndarray) -> np.ndarray:
        """Return points (..., 3), metres in the first camera's frame, in this camera's frame, also in
        metres."""
        return np.asarray(points @ self.rotation.T + self.translation)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project points (..., 3), metres in the first camera's frame, to pixels (..., 2) of this camera.
        Points must lie before it."""
        return self.intrinsics.project(self.seen_from(points))
