"""A measured lens: a pinhole camera with distortion, for pictures of one size.

Distortion is OpenCV's (k1, k2, p1, p2, k3). A point (x, y) of the plane z = 1 is seen, with r2 = x x + y y,
at x (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 x y + p2 (r2 + 2 x x), and likewise in y with p1 and p2 swapped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.geometry.camera import Intrinsics

SAME_ASPECT: Final = 0.01
"""Share by which the aspect ratio of pictures may differ from that of the measured ones, since sides are
rounded"""
_LEAST_SLOPE: Final = 0.3
"""Slope of the seen radius over the true one, below which the polynomial is about to fold over and means
nothing"""
_NEWTON_STEPS: Final = 12
"""Number of Newton's steps by which distortion is taken out: exact to 1e-9 px in the corners of wide
webcams"""


@dataclass(frozen=True)
class Lens:
    """A measured camera and its distortion, in pictures of `width` x `height` pixels. Raises OptionError for
    numbers that no lens has."""

    intrinsics: Intrinsics
    distortion: tuple[float, float, float, float, float]
    """The coefficients k1, k2, p1, p2 and k3 of OpenCV's distortion, without a unit"""
    width: int
    height: int

    def __post_init__(self) -> None:
        if len(self.distortion) != 5 or not all(map(math.isfinite, self.distortion)):
            raise OptionError(f"a lens has five finite numbers of distortion; got {self.distortion}")
        if not (0 < self.width < 1 << 24 and 0 < self.height < 1 << 24):
            raise OptionError(f"a lens needs the size of its pictures; got {self.width}x{self.height}")

    def scaled(self, width: int, height: int) -> Lens:
        """Return the lens in pictures of another size. In pictures with width and height exchanged it is the
        lens of the turned camera: to which side is unknown, so the principal point is the centre and the
        tangential terms are 0.

        Raises OptionError where the pictures have another aspect ratio, as they are cut from the sensor
        elsewhere.
        """
        k, aspect = self.intrinsics, width / height
        if abs(aspect * self.height / self.width - 1.0) <= SAME_ASPECT:
            x, y = width / self.width, height / self.height
            return Lens(Intrinsics(k.fx * x, k.fy * y, k.cx * x, k.cy * y), self.distortion, width, height)
        if abs(aspect * self.width / self.height - 1.0) <= SAME_ASPECT:
            x, y = width / self.height, height / self.width
            k1, k2, _, _, k3 = self.distortion
            turned = Intrinsics(k.fy * x, k.fx * y, width / 2.0, height / 2.0)
            return Lens(turned, (k1, k2, 0.0, 0.0, k3), width, height)
        raise OptionError(
            f"the lens was measured in pictures of {self.width}x{self.height}, and these have another shape, "
            f"{width}x{height}: measure it once more with the camera's present setting"
        )

    def undistorted(self, points: np.ndarray) -> np.ndarray:
        """Take the distortion out of points: return for pixels (..., 2), as they are seen, the pixels
        (..., 2) at which `intrinsics` sees the same rays.

        A point beyond the picture's corners, or where the polynomial folds over, is moved as far as the last
        point before it on its radius.
        """
        k = self.intrinsics
        focal, centre = np.array([k.fx, k.fy]), np.array([k.cx, k.cy])
        seen = (np.asarray(points, dtype=np.float64) - centre) / focal
        radius = np.linalg.norm(seen, axis=-1, keepdims=True)
        within = seen * np.minimum(1.0, self._reach() / np.maximum(radius, 1e-12))
        found = within
        for _ in range(_NEWTON_STEPS):
            found = found - self._step(found, within)
        return (found + seen - within) * focal + centre

    def _reach(self) -> float:
        """The radius as it is seen, in the plane z = 1, up to which distortion is taken out."""
        k1, k2, _, _, k3 = self.distortion
        k = self.intrinsics
        corner = math.hypot(
            max(k.cx, self.width - k.cx, 1.0) / k.fx, max(k.cy, self.height - k.cy, 1.0) / k.fy
        )
        # Wide lenses see a corner at up to about half of its true radius.
        true = np.linspace(0.0, 2.0 * corner, 400)
        square = np.square(true)
        slope = 1.0 + square * (3.0 * k1 + square * (5.0 * k2 + square * 7.0 * k3))
        folded = np.flatnonzero(slope < _LEAST_SLOPE)
        last = max(0, folded[0] - 1) if len(folded) else -1
        seen = true * (1.0 + square * (k1 + square * (k2 + square * k3)))
        return min(corner, float(seen[last]))

    def _step(self, at: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return Newton's step (..., 2) from points `at` in the plane z = 1, whose end is to be seen at
        `target` (..., 2)."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = at[..., 0], at[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        growth = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        off_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - target[..., 0]
        off_y = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y) - target[..., 1]
        xx = radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        yy = radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        xy = growth * x * y + 2.0 * p1 * x + 2.0 * p2 * y
        determinant = xx * yy - xy * xy
        return np.stack([yy * off_x - xy * off_y, xx * off_y - xy * off_x], axis=-1) / determinant[..., None]
